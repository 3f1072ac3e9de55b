"""Base of the result documents: known keys only, JSON numbers, null for numbers that are not finite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, StrictBool, StrictFloat, StrictInt, StrictStr


def _convert_number(value: object) -> object:
    """numpy's numbers as Python's, what is not finite as None."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _convert_row(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _convert_flag(value: object) -> object:
    return bool(value) if isinstance(value, np.bool_) else value


def check_literal_integer(value: object) -> object:
    """Return the value if it is an integer, not true and not 1.0.

    Args:
        value: Value of the key.

    Raises:
        ValueError: the value is no integer.
    """
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("a whole number was expected")
    return value


def _convert_options(value: object) -> object:
    """What options hold, in JSON's own types."""
    if isinstance(value, Mapping):
        return {key: _convert_options(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _convert_options(value.tolist())
    if isinstance(value, list | tuple):
        return [_convert_options(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


Text = StrictStr
Flag = Annotated[StrictBool, BeforeValidator(_convert_flag)]
First = Annotated[Literal[1], BeforeValidator(check_literal_integer)]
"""The version of a document's form."""
Count = Annotated[StrictInt, BeforeValidator(_convert_number)]
Number = Annotated[StrictInt | StrictFloat, BeforeValidator(_convert_number)]
Known = Annotated[StrictInt | StrictFloat | None, BeforeValidator(_convert_number)]
"""A number, or null where there is none: nothing to measure, or not finite."""
Numbers = Annotated[tuple[Number, ...], BeforeValidator(_convert_row)]
Knowns = Annotated[tuple[Known, ...], BeforeValidator(_convert_row)]
Hashes = dict[Text, Text]
"""Name of a file → SHA-256, lower-case hexadecimal."""
Settings = Annotated[dict[Text, Any], BeforeValidator(_convert_options)]
"""Options by the names that the user gives them, in any form that JSON has."""


class DocumentModel(BaseModel):
    """A mapping with exactly the keys named here; a key with a default may be left out of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @classmethod
    def from_fields(cls, found: object) -> Self:
        """Build the document from an object with its fields as attributes.

        Args:
            found: The object.
        """
        return cls(**vars(found))

    def __repr__(self) -> str:
        """A whole document by its verdict: written out it fills many pages of a notebook."""
        verdict = getattr(self, "verdict", None)
        whole = isinstance(verdict, str) and "version" in type(self).model_fields
        return f"<{type(self).__name__}: {verdict}>" if whole else super().__repr__()

    def __str__(self) -> str:
        return repr(self)

    def to_json_types(self) -> dict[str, Any]:
        """As the file has it, in JSON's own types and in the order of the fields; what was not given is left out."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)

"""What result documents share: no key but the known ones, numbers as JSON has them, null for what is not finite."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, StrictBool, StrictFloat, StrictInt, StrictStr


def _number(value: object) -> object:
    """numpy's numbers as Python's, what is not finite as None."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _row(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


Text = StrictStr
Flag = StrictBool
Count = Annotated[StrictInt, BeforeValidator(_number)]
Number = Annotated[StrictInt | StrictFloat, BeforeValidator(_number)]
Known = Annotated[StrictInt | StrictFloat | None, BeforeValidator(_number)]
"""A number, or null where there is none: nothing to measure, or not finite."""
Numbers = Annotated[tuple[Number, ...], BeforeValidator(_row)]
Knowns = Annotated[tuple[Known, ...], BeforeValidator(_row)]
Hashes = dict[Text, Text]
"""Name of a file → SHA-256, lower-case hexadecimal."""
Settings = dict[Text, Any]
"""Options by the names that the user gives them, in any form that JSON has."""


class Part(BaseModel):
    """A mapping with exactly the keys named here; a key with a default may be left out of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @classmethod
    def from_fields(cls, found: object) -> Self:
        """From anything with the fields as attributes."""
        return cls(**vars(found))

    def plain(self) -> dict[str, Any]:
        """As the file has it, in JSON's own types and in the order of the fields; what was not given is left out."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)

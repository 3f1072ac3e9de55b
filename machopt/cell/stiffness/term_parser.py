"""Parser of a term to be fitted: ``EFFECT@LOCATION{key: value}``."""

from __future__ import annotations

from collections.abc import Mapping

from machopt.data_types.stiffness import StiffnessTerm
from machopt.errors import OptionError
from machopt.file_formats.strict_yaml import parse_yaml


def parse_term(text: str) -> StiffnessTerm:
    """Parse a term to be fitted: ``link_compliance@link:4`` or ``tool_compliance@tool{length_mm: 400}``.

    Args:
        text: Text of the term.

    Returns:
        The term.

    Raises:
        OptionError: the text does not have that form.
    """
    head, brace, rest = text.partition("{")
    effect, at, location = head.strip().partition("@")
    if not at or not effect or not location:
        raise OptionError(f"found {text!r}; EFFECT@LOCATION, e.g. link_compliance@link:4, would work", where="--fit")
    parameters: object = {}
    if brace:
        parameters = parse_yaml("{" + rest, "--fit").value
        if not isinstance(parameters, Mapping):
            raise OptionError(f"found {text!r}; {{key: value, …}} would work after the location", where="--fit")
    return StiffnessTerm(effect, location, dict(parameters))  # type: ignore[call-overload]

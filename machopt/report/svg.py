"""Pictures as lists of shapes; the template ``svg.html`` writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from machopt.report.template import fragment

if TYPE_CHECKING:
    from markupsafe import Markup


Style = dict[str, Any]  # attributes that several shapes share, named as `shape` takes them


@dataclass(frozen=True)
class Shape:
    """One element of a picture."""

    tag: str
    attributes: Mapping[str, str]
    words: str = ""
    title: str = ""  # shown where the pointer rests
    inside: Sequence[Shape] = ()


def shape(tag: str, /, words: str = "", *, title: str = "", inside: Sequence[Shape] = (), **given: Any) -> Shape:
    """A shape of attributes written as in ``stroke_width=2, class_="line"``; lengths to a tenth, empty ones left out.

    Args:
        tag: circle, path, rect, text …
        words: of a text.
        title: shown where the pointer rests.
        inside: of an svg or a group.
        given: attributes.
    """
    attributes = {
        name if name == "viewBox" else name.rstrip("_").replace("_", "-"): _written(value)
        for name, value in given.items()
        if value != ""
    }
    return Shape(tag, attributes, words, title, inside)


def drawn(*shapes: Shape) -> Markup:
    """The shapes as markup."""
    return fragment("svg.html", "shapes", shapes)


def _written(value: object) -> str:
    return f"{value:.1f}".removesuffix(".0") if isinstance(value, float) else str(value)

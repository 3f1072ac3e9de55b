"""SVG pictures as lists of shapes; the template ``svg.html`` renders them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from machopt.report.template_rendering import render_macro

if TYPE_CHECKING:
    from markupsafe import Markup


Style = dict[str, Any]  # attributes that several shapes share, named as `shape` takes them


@dataclass(frozen=True)
class SvgShape:
    """One element of a picture."""

    tag: str
    attributes: Mapping[str, str]
    words: str = ""
    title: str = ""  # shown where the pointer rests
    inside: Sequence[SvgShape] = ()


def build_shape(
    tag: str, /, words: str = "", *, title: str = "", inside: Sequence[SvgShape] = (), **given: object
) -> SvgShape:
    """A shape of attributes written as in ``stroke_width=2, class_="line"``; lengths to a tenth, empty ones left out.

    Args:
        tag: circle, path, rect, text …
        words: of a text.
        title: shown where the pointer rests.
        inside: of an svg or a group.
        given: attributes.
    """
    attributes = {
        name if name == "viewBox" else name.rstrip("_").replace("_", "-"): _format_attribute(value)
        for name, value in given.items()
        if value != ""
    }
    return SvgShape(tag, attributes, words, title, inside)


def render_svg(*shapes: SvgShape) -> Markup:
    """Return the shapes as markup.

    Args:
        shapes: The shapes.
    """
    return render_macro("svg.html", "shapes", shapes)


def _format_attribute(value: object) -> str:
    return f"{value:.1f}".removesuffix(".0") if isinstance(value, float) else str(value)

"""Rendering of the templates in ``report/templates``, the only source of markup; they escape everything else.

A macro returns a part of a page as :class:`markupsafe.Markup`, which other macros take unchanged. Text is never
joined with markup by hand. A value that a template needs and does not get is an error.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

TEMPLATE_CACHE_FOLDER = Path(__file__).with_name("templates") / "__pycache__"


@cache
def _build_environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # late: commands without a page do without

    from machopt.report.template_cache import TemplateCache

    made = Environment(
        loader=PackageLoader("machopt.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        cache_size=-1,
        auto_reload=False,
        bytecode_cache=TemplateCache(TEMPLATE_CACHE_FOLDER, "autoescape, trim_blocks, lstrip_blocks"),
    )
    made.filters["bound"] = bind_units
    return made


def bind_units(sentence: str) -> str:
    """Return a sentence with no-break spaces, so that no line ends between a number and its unit.

    Args:
        sentence: The sentence.
    """
    bound = sentence.replace(" %", "\N{NO-BREAK SPACE}%").replace("± ", "±\N{NO-BREAK SPACE}")
    return bound.replace("N/µm", "N/\N{WORD JOINER}µm").replace("mm/min", "mm/\N{WORD JOINER}min")


def render_file(template: str, /, **values: object) -> str:
    """Return a whole file of ``report/templates``, filled in.

    Args:
        template: Name of the template.
        values: Values of the template's variables.
    """
    return _build_environment().get_template(template).render(**values)


def render_macro(template: str, macro: str, /, *given: object, **values: object) -> Markup:
    """Return one macro of a file of ``report/templates``, filled in: text is escaped, markup is not.

    Args:
        template: Name of the template.
        macro: Name of the macro.
        given: Positional arguments of the macro.
        values: Keyword arguments of the macro.
    """
    piece: Markup = getattr(_build_environment().get_template(template).module, macro)(*given, **values)
    return piece


def render_part(macro: str, /, *given: object, **values: object) -> Markup:
    """Return one macro of ``parts.html``, the common parts of all pages.

    Args:
        macro: Name of the macro.
        given: Positional arguments of the macro.
        values: Keyword arguments of the macro.
    """
    return render_macro("parts.html", macro, *given, **values)


def join_markup(pieces: Iterable[Markup | str]) -> Markup:
    """Return the concatenated pieces; text that is no markup is escaped.

    Args:
        pieces: Markup and text.
    """
    from markupsafe import Markup

    return Markup().join(pieces)

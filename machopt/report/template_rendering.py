"""Markup is written by the templates of ``report/templates`` and nowhere else; they escape all that is not markup.

A macro gives a piece of a page that other macros take as it is (:class:`markupsafe.Markup`); text is never joined with
markup by hand. What a template asks for and is not given is an error, not a gap on the page.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    """The same with its units whole on the line of their numbers: no line ends before a %, behind a ±, in N/µm."""
    kept = sentence.replace(" %", "\N{NO-BREAK SPACE}%").replace("± ", "±\N{NO-BREAK SPACE}")
    return kept.replace("N/µm", "N/\N{WORD JOINER}µm").replace("mm/min", "mm/\N{WORD JOINER}min")


def render_file(template: str, /, **values: Any) -> str:
    """A whole file of ``report/templates``, filled in."""
    return _build_environment().get_template(template).render(**values)


def render_macro(template: str, macro: str, /, *given: Any, **values: Any) -> Markup:
    """One macro of a file of ``report/templates``, filled in: text is escaped, markup stays."""
    piece: Markup = getattr(_build_environment().get_template(template).module, macro)(*given, **values)
    return piece


def render_part(macro: str, /, *given: Any, **values: Any) -> Markup:
    """One macro of ``parts.html``: what all pages are made of."""
    return render_macro("parts.html", macro, *given, **values)


def join_markup(pieces: Iterable[Markup | str]) -> Markup:
    """Pieces one after another; what is no markup is escaped."""
    from markupsafe import Markup

    return Markup().join(pieces)

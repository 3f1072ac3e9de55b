"""HTML shell of every page: one self-contained file with style, data and scripts."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from machopt.report.template_rendering import render_file, render_part

if TYPE_CHECKING:
    from markupsafe import Markup

UPLOT_FOLDER = "uplot"  # the folder of assets that holds the chart library as it is published, with its licence
THREE_FOLDER = "three"  # the same of the 3-D library, as far as it is used


STILL_SCENE_SCRIPTS = ("heatmap.js", "fk.js", "stage.js", "posture.js")  # scripts of a picture without a motion
POSTURE_SCRIPTS = (*STILL_SCENE_SCRIPTS, "start_posture.js")  # and what begins it


def build_page_html(
    title: str,
    head: Sequence[tuple[str, str]],
    sections: Sequence[tuple[str, str, Markup | str]],
    specs: dict[str, Any],
    *,
    scripts: Sequence[str],
    footer: Markup | str,
    brief: bool = False,
) -> str:
    """The page as text; the same data give the same bytes.

    Args:
        title: heading and window title.
        head: (name, value) pairs beside the heading.
        sections: (anchor, title, markup); empty ones are left out, menu entry included.
        specs: what the scripts draw; they find it as JSON in ``#data``.
        scripts: files of ``report/assets``, in order.
        footer: below the last section.
        brief: printed on few sheets: small pictures, the first rows of tables, nothing that is folded.
    """
    from markupsafe import Markup

    charts, scene = "chart.js" in scripts, "stage.js" in scripts
    styles = [*([f"{UPLOT_FOLDER}/uPlot.min.css"] if charts else []), "page.css"]
    return (
        render_file(
            "page.html",
            title=title,
            head=head,
            sections=[s for s in sections if s[2]],
            footer=footer,
            kind="brief" if brief else "full",
            style=Markup("".join(_read_asset(name) for name in styles)),
            code=Markup("".join(_read_asset(name) for name in scripts)),
            library=Markup((_read_chart_library() if charts else "") + (_read_three_library() if scene else "")),
            specs=Markup(_embed_json(specs)),
        )
        + "\n"
    )


def build_section(anchor: str, title: str, lead: Markup | str, body: Markup | str) -> Markup | str:
    """Return a section of the page with heading; nothing where the body is empty.

    Args:
        anchor: Anchor of the section in the page's links.
        title: The heading.
        lead: Introductory sentence.
        body: Content of the section, markup or text.
    """
    return render_part("section", anchor, title, lead, body) if body else ""


def _read_asset(name: str) -> str:
    return (files("machopt.report") / "assets" / name).read_text(encoding="utf-8")


def _read_chart_library() -> str:
    """The chart library with its licence; its banner names a place, and a page must not look as if it went there."""
    code = _read_asset(f"{UPLOT_FOLDER}/uPlot.iife.min.js")
    banner = re.match(r"/\*!\s*\S+ \(v([0-9.]+)\)\s*\*/\s*", code)
    assert banner is not None
    return f"/* uPlot {banner[1]}\n{_read_asset(f'{UPLOT_FOLDER}/LICENSE')}*/\n{code[banner.end() :]}\n"


def _read_three_library() -> str:
    """What the pages use of three.js, with its licence; ``assets/three/entry.js`` says how it is made."""
    return f"/* three.js\n{_read_asset(f'{THREE_FOLDER}/LICENSE')}*/\n{_read_asset(f'{THREE_FOLDER}/three.min.js')}\n"


def _embed_json(specs: dict[str, Any]) -> str:
    """JSON that no text inside it can end early."""
    text = json.dumps(specs, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return re.sub(r"[<>&]", lambda m: f"\\u{ord(m[0]):04x}", text)

"""The frame every page stands in: one self-contained HTML file, its style, its data and its scripts inside."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any


def page_html(
    title: str, head: Sequence[tuple[str, str]], sections: Sequence[tuple[str, str, str]], specs: dict[str, Any],
    *, scripts: Sequence[str], footer: str,
) -> str:  # fmt: skip
    """The page as text; the same data give the same bytes.

    Args:
        title: heading and window title, plain text.
        head: (name, value) pairs beside the heading, plain text.
        sections: (anchor, title, HTML); empty ones are left out, menu entry included.
        specs: what the scripts draw; they find it as JSON in ``#data``.
        scripts: files of ``report/assets``, in order.
        footer: HTML.
    """
    shown = [(anchor, name, body) for anchor, name, body in sections if body]
    menu = "".join(f'<a href="#{anchor}">{name}</a>' for anchor, name, _ in shown)
    pairs = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in head)
    code = "".join(_asset(name) for name in scripts)
    parts = [
        "<!doctype html>\n<html lang=en>\n<head>\n<meta charset=utf-8>\n",
        '<meta name=viewport content="width=device-width, initial-scale=1">\n',
        f"<title>{escape(title)}</title>\n<style>\n{_asset('page.css')}</style>\n</head>\n<body>\n<main>\n",
        f"<header class=top><h1>{escape(title)}</h1><dl>{pairs}</dl></header>\n", f"<nav>{menu}</nav>\n",
        *(body for _, _, body in shown),
        f"<footer>{footer}</footer>\n",
        f'</main>\n<script id=data type="application/json">{_embedded(specs)}</script>\n',
        f'<script>\n"use strict";\n{code}</script>\n',
        "</body>\n</html>\n",
    ]  # fmt: skip
    return "".join(parts)


def section(anchor: str, title: str, lead: str, body: str) -> str:
    """A headed part of the page; nothing where there is nothing to show."""
    return f"<section id={anchor}><h2>{title}</h2><p class=lead>{lead}</p>{body}</section>\n" if body else ""


def _asset(name: str) -> str:
    return (files("machopt.report") / "assets" / name).read_text(encoding="utf-8")


def _embedded(specs: dict[str, Any]) -> str:
    """JSON that no text inside it can end early."""
    text = json.dumps(specs, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return re.sub(r"[<>&]", lambda m: f"\\u{ord(m[0]):04x}", text)

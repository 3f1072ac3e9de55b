"""Pages of the documentation: ``make docs`` builds them with Sphinx and MyST from the Markdown files as they are.

The source folder is the repository, so links between any two Markdown files become links between pages and are checked;
files that are no pages (scripts, schemas) are copied beside the page that names them. Nothing comes from a network.
"""

from __future__ import annotations

import re
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]

project = "machopt"
author = "the machopt authors"
said = re.search(r'__version__ = "(.+)"', (ROOT / "machopt" / "version.py").read_text(encoding="utf-8"))
release = version = said[1] if said else ""

extensions = ["myst_parser"]
root_doc = "docs/site/index"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "docs/**.md",
    "cells/**.md",
    "toolpaths/README.md",
    "benchmarks/**.md",
    "machopt/programs/README.md",
    "tests/vendored_files/SOURCES.md",
]
exclude_patterns = [".*", "out", "**/__pycache__"]
myst_heading_anchors = 4  # the anchors that GitHub makes
myst_links_external_new_tab = False
suppress_warnings = ["myst.header"]  # a changelog's entries begin one level deeper

html_theme = "furo"
html_title = f"machopt {version}"
html_static_path: list[str] = []
html_show_sourcelink = False
html_copy_source = False


def folders(app: Sphinx, doctree: nodes.document) -> None:
    """A link to a folder of the repository leads to its README's page; without one it is its name, and no link."""
    for node in list(doctree.findall(addnodes.pending_xref)):
        place = Path(app.env.doc2path(node["refdoc"])).parent / node["reftarget"]
        if not place.is_dir():
            continue  # what is neither file nor folder Sphinx warns of, and `make docs` fails
        readme = (place.resolve() / "README").relative_to(ROOT).as_posix()
        if readme in app.env.found_docs:
            node.update_all_atts({"refdomain": "std", "reftype": "doc", "reftarget": f"/{readme}", "refexplicit": True})
        else:
            node.replace_self(node.children)


def front(app: Sphinx, problem: Exception | None) -> None:
    """What opens at the top of the pages' folder leads to the first page, which lies as deep as its source."""
    if problem is None:
        to = f'<meta http-equiv="refresh" content="0; url={root_doc}.html"><a href="{root_doc}.html">machopt</a>\n'
        (Path(app.outdir) / "index.html").write_text(to, encoding="utf-8")


def setup(app: Sphinx) -> None:
    app.connect("doctree-read", folders)
    app.connect("build-finished", front)

"""All markup comes from templates, escaped and complete."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import sample_diagnoses
from jinja2 import UndefinedError
from sample_report_data import full_result
from test_diagnosis_page import page as diagnosis_of
from test_map_page import build_sample_map

from machopt.data_types.toolpath import IgnoredWord, MoveKind, Toolpath, ToolpathEvent, ToolpathOperation
from machopt.report.page_types.identification_page_data import IdentificationPageData, IdentifiedCoefficient
from machopt.report.page_types.pose_plan_page_data import PosePlanPageData
from machopt.report.pages.batch_page import BatchPageData, build_batch_html
from machopt.report.pages.diagnosis.diagnosis_page import build_diagnosis_html
from machopt.report.pages.identification_page import build_identification_html
from machopt.report.pages.map_page import build_map_html
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.report.pages.pose_plan_page import build_pose_plan_html
from machopt.report.pages.toolpath_page import build_toolpath_html
from machopt.report.template_rendering import join_markup, render_file, render_macro, render_part
from machopt.toolpath.toolpath_summary import summarise_toolpath

PACKAGE = Path(__file__).resolve().parents[1] / "machopt"
TAGS = (
    "a|article|aside|b|body|br|button|canvas|caption|circle|code|dd|details|div|dl|dt|em|figure|footer|g|h[1-6]|head|"
    "header|hr|html|i|image|img|input|label|li|line|main|meta|nav|ol|option|p|path|polyline|pre|rect|script|section|"
    "select|small|span|strong|style|sub|summary|sup|svg|table|tbody|td|text|th|thead|title|tr|u|ul"
)
MARKUP = re.compile(
    rf"</?(?:{TAGS})(?:\s[^<>]*)?/?>|<(?:{TAGS})\s+[\w-]+=|</(?:{TAGS})\b|<!doctype html|&(?:amp|lt|gt);"
)
NO_MARKUP = {
    ("toolpath/readers/gcode/syntax/blocks.py", "<text>"),  # placeholder for a file name
    ("cell/mesh/collada_counts.py", "<p>"),  # elements of the file that is read
    ("cell/mesh/collada_counts.py", "<input>"),
}
EVIL = "<script>alert(1)</script><b>&\"'"


def strings(file: Path) -> Iterator[tuple[int, str]]:
    """Return every string of a file that is not a docstring, including parts of f-strings."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    values = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in values:
            yield node.lineno, node.value


def test_python_strings_contain_no_markup() -> None:
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        if not MARKUP.search(file.read_text(encoding="utf-8")):
            continue  # most files need not be parsed
        name = str(file.relative_to(PACKAGE))
        for line, text in strings(file):
            found += [f"{name}:{line} {m[0]}" for m in MARKUP.finditer(text) if (name, m[0]) not in NO_MARKUP]
    assert found == []


def test_markup_search_detects_markup(tmp_path: Path) -> None:
    file = tmp_path / "a.py"
    file.write_text(
        '"""<b>told</b>"""\na = f"<td class={1}>{2}</td>"\nb = "1 < 2"\nc = "(?P<name>x)"\n', encoding="utf-8"
    )
    assert {line for line, text in strings(file) if MARKUP.search(text)} == {2}


def test_text_is_escaped_and_markup_remains() -> None:
    assert render_part("paragraph", EVIL) == "<p>&lt;script&gt;alert(1)&lt;/script&gt;&lt;b&gt;&amp;&#34;&#39;</p>"
    assert render_part("paragraph", render_part("strong", "a<b")) == "<p><b>a&lt;b</b></p>"
    assert join_markup([render_part("strong", "a"), "<i>"]) == "<b>a</b>&lt;i&gt;"


def test_missing_template_value_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="lead"):
        render_part("section", "a", "b", body="c")
    with pytest.raises(UndefinedError, match="title"):
        render_file("page.html")


def test_every_macro_is_used() -> None:
    code = "".join(f.read_text(encoding="utf-8") for f in sorted((PACKAGE / "report").rglob("*.py")))
    texts = {f: f.read_text(encoding="utf-8") for f in sorted((PACKAGE / "report" / "templates").glob("*.html"))}
    for file, text in texts.items():
        for name in re.findall(r"{% macro (\w+)\(", text):
            calls = text.count(f"{name}(") - 1 + sum(t.count(f"{file.stem}.{name}(") for t in texts.values())
            assert f'"{name}"' in code or calls, f"{file.name}: {name}"


class Seen(HTMLParser):
    """Collect elements that are executed, and the visible text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.scripts = 0
        self.inside: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self.inside.append(tag)
        assert all(not name.startswith("on") for name, _ in attrs)

    def handle_endtag(self, tag: str) -> None:
        while self.inside and self.inside.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if not self.inside or self.inside[-1] not in ("script", "style"):
            self.text += data


def evil_report() -> str:
    data = full_result(points=40, samples=200)
    operations = tuple(replace(o, label=EVIL) for o in data.operations)
    programs = tuple(replace(p, files=(EVIL,), differences=(EVIL,), unstarted=(EVIL,)) for p in data.programs)
    return build_report_html(
        replace(
            data,
            cell=EVIL,
            toolpath=EVIL,
            operations=operations,
            programs=programs,
            notes=(EVIL,),
            ignored=(IgnoredWord(EVIL, 1, 1, False),),
        )
    )


def evil_toolpath() -> str:
    xyz = np.array([[0.0, 0, 0.01], [0.01, 0, 0], [0.02, 0.01, 0]])
    t = Toolpath(
        position=xyz,
        axis=np.tile([0.0, 0, 1], (3, 1)),
        move=np.array([MoveKind.RAPID, MoveKind.CUT, MoveKind.CUT], np.int8),
        feed=np.full(3, 0.01),
        operation=np.zeros(3, np.int32),
        operations=(ToolpathOperation(EVIL, "trajectory", EVIL),),
        reference=np.full((3, 3), np.nan),
        tolerance=np.full(3, np.nan),
        line=np.arange(3, dtype=np.int32),
        source=EVIL,
        format="csv",
        sha256="0",
        events=(ToolpathEvent(1, "comment", EVIL),),
        ignored=(IgnoredWord(EVIL, 1, 1, False),),
        warnings=(EVIL,),
        meta={EVIL: EVIL},
    )
    return build_toolpath_html(t, summarise_toolpath(t))


def evil_map() -> str:
    return build_map_html(replace(build_sample_map(), cell=EVIL, title=EVIL, verdict=EVIL, warnings=(EVIL,)))


def evil_diagnosis() -> str:
    d = sample_diagnoses.explained()
    return build_diagnosis_html(diagnosis_of(replace(d, warnings=(EVIL,), notes=(EVIL,)), recording=EVIL, cell=EVIL))


def evil_identification() -> str:
    joints = tuple(
        IdentifiedCoefficient(
            name=EVIL, unit=EVIL, value=1e6, low=9e5, high=1.1e6, prior=1e6, identified=n > 0, reason=EVIL
        )
        for n in range(6)
    )
    shift = np.full((4, 3), 1e-3)
    return build_identification_html(
        IdentificationPageData(
            title=EVIL,
            cell=EVIL,
            recording=EVIL,
            version="0",
            tone="",
            badge=EVIL,
            sentence=EVIL,
            cautions=(EVIL,),
            joints=joints,
            terms=joints[:1],
            measured=shift,
            predicted=0.9 * shift,
            heldout=0.8 * shift,
            sigma=0.01 * shift,
            pose=np.arange(4),
            line=np.arange(4),
            load=np.full(4, 100.0),
            outlier=np.zeros(4, bool),
            leverage=np.zeros(4),
            compliances=np.full(6, 1e-6),
            covariance=1e-16 * np.eye(6),
            rmse=1e-5,
            explained=0.99,
            heldout_rmse=1e-5,
            displacement=1e-3,
            condition_number=3.0,
            facts=((EVIL, EVIL),),
        )
    )


def evil_poses() -> str:
    return build_pose_plan_html(
        PosePlanPageData(
            title=EVIL,
            cell=EVIL,
            version="0",
            tried=9,
            passed=0,
            cases=0,
            rejected_poses=((EVIL, 9),),
            rejected_loads=(),
            warnings=(EVIL,),
            options=((EVIL, EVIL),),
            hashes=(),
            reason=EVIL,
        )
    )


def evil_batch() -> str:
    job = {
        "job": EVIL,
        "toolpath": EVIL,
        "cell": EVIL,
        "variant": EVIL,
        "state": "done",
        "verdict": EVIL,
        "report": EVIL,
        "folder": EVIL,
        "gain_percent": None,
        "warnings": (EVIL,),
    }
    return build_batch_html(
        BatchPageData(
            version="0", complete=True, jobs=(job,), ignored_files=(EVIL,), compared_with=EVIL, only_here=(EVIL,)
        )
    )


@pytest.mark.parametrize(
    ("page", "scripts"),
    [
        (evil_report, 2),
        (evil_toolpath, 2),
        (evil_map, 2),
        (evil_diagnosis, 2),
        (evil_identification, 2),
        (evil_poses, 2),
        (evil_batch, 3),
    ],
)
def test_hostile_names_are_escaped(page: Callable[[], str], scripts: int) -> None:
    """In the toolpath, the cell, the recording and their contents; only the page's own scripts run."""
    html = page()
    observed = Seen(html)
    assert observed.scripts == scripts
    assert "alert(1)</script>" not in html
    assert EVIL in observed.text


def test_missing_macro_is_an_error() -> None:
    with pytest.raises(AttributeError):
        render_macro("parts.html", "sectoin")

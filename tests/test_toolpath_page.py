"""The page of ``inspect --html``: self-contained, complete, and small for long paths."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from toolpath_file_samples import FANUC, HEIDENHAIN, TABLE, Sample

from machopt.data_types.toolpath import Toolpath
from machopt.report.pages.toolpath_page import build_toolpath_html, write_toolpath_page
from machopt.report.svg.toolpath_picture import VIEWS, build_view_svg
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.toolpath_summary import summarise_toolpath


def read(tmp_path: Path, sample: Sample, text: str | None = None) -> Toolpath:
    file = tmp_path / sample.name
    file.write_text(sample.text if text is None else text, encoding="utf-8")
    return read_toolpath(file, **sample.options)  # type: ignore[arg-type]


class _Balanced(HTMLParser):
    """Count tags that must be closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in ("meta", "line", "circle", "path", "br", "img", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("line", "circle", "path"):
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.parametrize("sample", [FANUC, HEIDENHAIN, TABLE], ids=lambda s: s.name)
def test_page_is_complete_and_self_contained(sample: Sample, tmp_path: Path) -> None:
    t = read(tmp_path, sample)
    html = build_toolpath_html(t, summarise_toolpath(t))
    parser = _Balanced()
    parser.feed(html)
    assert parser.open == []
    assert html.count('<svg class="plot"') == len(VIEWS)
    assert not re.search(r"(?:src|href)=[\"']?(?:http|//)", html)
    for o in t.operations:
        assert o.label in parser.text
    assert f"{len(t)} points" in parser.text
    assert html == build_toolpath_html(t, summarise_toolpath(t))


def test_problems_are_at_the_top(tmp_path: Path) -> None:
    cut = FANUC.text[: FANUC.text.index("M98")]
    t = read(tmp_path, FANUC, cut + "FOO<b>\n")
    html = build_toolpath_html(t, summarise_toolpath(t))
    assert "INCOMPLETE FILE?" in html
    assert 'class="verdict bad"' in html
    assert html.index("no program end") < html.index("Pictures</h2>")
    assert "FOO&lt;B&gt;" in html or "FOO" in html
    assert "FOO<b>" not in html
    file = tmp_path / "page.html"
    write_toolpath_page(file, t, summarise_toolpath(t))
    assert file.read_text(encoding="utf-8").startswith(html)


def test_views_have_the_named_direction(tmp_path: Path) -> None:
    t = read(tmp_path, TABLE)  # from (0, 0, 10) to (60, 0, 0)
    top, front, _, slanted = (build_view_svg(t, v) for v in VIEWS)
    assert "tool axis" in top  # the tool is tilted at the last point

    def cut(svg: str) -> list[list[float]]:
        d = re.search(r'd="M([^"]*)"[^>]*><title>cut<', svg)
        assert d
        return [[float(v) for v in p.split()] for p in re.split("[ML]", d.group(1)) if p]

    first, second = cut(front)[:2]  # the plunge
    assert first[0] == second[0]
    assert second[1] > first[1]  # downwards on the screen
    assert len({round(p[1], 1) for p in cut(top)}) == 1  # y is zero at all points
    assert slanted.count("<path") >= 2
    for view in VIEWS:
        right, up = np.array(view.right), np.array(view.up)
        assert right @ up == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(right) == pytest.approx(1.0)
        assert np.linalg.norm(up) == pytest.approx(1.0)
        assert np.cross(right, up)[2] >= -1e-12  # no view is from below


def test_long_path_makes_a_small_page(tmp_path: Path) -> None:
    angle = np.arange(60_000) * 0.05
    rows = np.column_stack([80 * np.cos(angle), 60 * np.sin(1.7 * angle), angle * 1e-3])
    body = "\n".join(f"{x:.4f},{y:.4f},{z:.4f},600" for x, y, z in rows.tolist())
    t = read(tmp_path, TABLE, "x_mm,y_mm,z_mm,feed_mm_min\n" + body + "\n")
    html = build_toolpath_html(t, summarise_toolpath(t))
    assert len(html) < 2_000_000  # 60,000 points in four views would be 5 MB
    top = build_view_svg(t, VIEWS[0])
    xs = [float(v) for v in re.findall(r"[ML]([\d.]+) ", top)]
    assert max(xs) - min(xs) > 400.0  # pixels: the whole width is drawn


def test_numbers_of_a_flat_view_do_not_overlap(tmp_path: Path) -> None:
    t = read(tmp_path, TABLE, "x_mm,y_mm,z_mm,feed_mm_min,kind\n0,0,0,600,path\n400,0,10,600,\n400,300,10,600,\n")
    front = build_view_svg(t, VIEWS[1])
    heights = [float(v) for v in re.findall(r'<text class="tick" x="35" y="([\d.]+)"', front)]
    assert heights
    assert min(np.abs(np.diff(sorted(heights))), default=99.0) > 15  # pixels; the letters are 11 high

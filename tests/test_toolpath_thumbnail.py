"""Thumbnail of a toolpath on the page of a batch."""

from __future__ import annotations

import re
from pathlib import Path

from machopt.batch.toolpath_picture import build_path_picture
from machopt.report.pages.batch_page import BatchPageData, build_batch_html
from machopt.report.svg.toolpath_thumbnail import HEIGHT, WIDTH, build_thumbnail

POINTS = """\
point,move,x_mm,y_mm,z_mm,k_axial_N_mm,deflection_mm
0,rapid,0,0,50,,
1,cut,0,0,0,300,0.10
2,cut,100,0,0,310,0.20
3,cut,100,80,0,,
4,retract,100,80,50,,
"""


def test_cuts_are_coloured_missing_points_red_and_all_inside_the_frame(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(POINTS)
    path = build_path_picture(tmp_path / "points.csv", "a <b>")
    assert path is not None
    assert path.cutting.tolist() == [False, True, True, True, False]
    assert not path.large_is_good
    svg = str(build_thumbnail(path))
    strokes = re.findall(r'stroke="([^"]+)"', svg)
    assert strokes == ["currentColor", "#d93636", "rgb(68,1,84)", "rgb(253,231,37)"]
    for x, y in re.findall(r"[ML](-?[\d.]+) (-?[\d.]+)", svg):
        assert 0.0 <= float(x) <= WIDTH
        assert 0.0 <= float(y) <= HEIGHT
    assert "a &lt;b&gt;: toolpath coloured by predicted deflection" in svg


def test_colours_without_a_force_and_no_picture_without_points(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(re.sub(r"0\.[12]0$", "", POINTS, flags=re.M))
    path = build_path_picture(tmp_path / "points.csv", "a")
    assert path is not None
    assert path.large_is_good
    assert build_path_picture(tmp_path / "nothing.csv", "a") is None
    job = {"job": "j", "toolpath": "a.csv", "cell": "c", "variant": "", "state": "done", "verdict": "done"}
    job |= {"folder": "jobs/j", "report": "jobs/j/report.html"}
    with_it = build_batch_html(BatchPageData(version="0", complete=True, jobs=(job,), pictures={"j": path}))
    assert '<a href="jobs/j/report.html#scene"><svg' in with_it
    assert "#scene" not in build_batch_html(BatchPageData(version="0", complete=True, jobs=(job,)))

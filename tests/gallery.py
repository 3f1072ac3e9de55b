"""One page of each kind, made up, as the tests of looks and of accessibility open them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import made_up_diagnosis
import numpy as np
from made_up_place import placed
from made_up_report import infeasible_result
from made_up_view import with_view
from small_cell import small_cell
from test_diagnosis_page import page as diagnosis_of
from test_map_page import made_up as made_up_map
from test_templates import evil_batch, evil_identification, evil_toolpath

from machopt.cli import main
from machopt.report.cell_page import cell_html
from machopt.report.diagnosis_page import diagnosis_html
from machopt.report.gather.cell import cell_scene
from machopt.report.map_data import MapScene
from machopt.report.map_page import map_page_html
from machopt.report.page import report_html
from machopt.report.place_page import place_html
from machopt.report.poses_data import PosesPage
from machopt.report.poses_page import poses_html
from machopt.report.steering import Axis, Compared, Steering

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
STEERING = Steering(
    operations=(("rim", ((0, 20),)), ("holes", ((25, 50),))),
    points=60,
    branches=8,
    axes=(Axis("rail", "mm", -1000.0, 1000.0),),
    wishes={"fixed": [{"point": 3, "gamma_deg": 20.0}], "steer": [{"operation": "rim", "branch": 2}], "external": {}},
    compared=(Compared(name="Objective", unit="", before=1.0, now=0.9, decimals=3),),
    told="Planned in 2.0 s.",
    good=True,
    file="plan.yaml",
    command="machopt optimize cell part.cls --plan plan.yaml",
)


def pages(folder: Path) -> Iterator[tuple[str, str]]:
    """Name and page, one after the other."""
    cell = small_cell(folder)
    report, _ = with_view(cell)
    yield "report", report_html(report)
    yield "view", report_html(report, STEERING)
    yield "infeasible", report_html(infeasible_result())
    yield "toolpath", evil_toolpath()
    scene, _ = cell_scene(cell)
    yield "cell", cell_html(cell)
    space = MapScene(scene, np.eye(4), cell.external_home)
    for kind in ("slice", "volume", "line"):
        yield f"map of a {kind}", map_page_html(made_up_map(kind, space=space))
    found = diagnosis_of("explained")
    q = made_up_diagnosis.recording().q
    yield "diagnosis", diagnosis_html(replace(found, scene=scene, q=q))
    yield "diagnosis of a motion", diagnosis_html(diagnosis_of("torque"))
    yield "identification", evil_identification()
    yield "batch", evil_batch()
    yield "place", place_html(placed())
    yield "poses", planned_poses(folder)
    yield (
        "no poses",
        poses_html(
            PosesPage(
                title="p",
                cell="c",
                version="0",
                tried=9,
                passed=0,
                cases=0,
                rejected_poses=(("x", 9),),
                rejected_loads=(),
                warnings=(),
                options=(),
                hashes=(),
                reason="none",
            )
        ),
    )


def planned_poses(folder: Path) -> str:
    """The page of a plan of few poses, of the command itself: it has a scene, curves and an order of work."""
    words = ["--poses", "3", "--candidates", "60", "--starts", "1", "--weights-kg", "50", "--no-collision", "--quiet"]
    assert main(["plan-poses", str(CELL), "-o", str(folder / "poses"), *words]) == 0
    return (folder / "poses" / "report.html").read_text(encoding="utf-8")

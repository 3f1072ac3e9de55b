"""One sample page of each type, for tests of appearance and accessibility."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import sample_diagnoses
from sample_motion_scene import build_report_with_motion_scene
from sample_placement import build_sample_placement
from sample_report_data import infeasible_result
from small_cell import small_cell
from test_diagnosis_page import page as diagnosis_of
from test_map_page import build_sample_map
from test_page_templates import evil_batch, evil_identification, evil_toolpath

from machopt.cli import main
from machopt.report.page_data.cell_scene import build_cell_scene
from machopt.report.page_types.pose_plan_page_data import PosePlanPageData
from machopt.report.page_types.steering_panel_data import PlanComparison, SteeringAxis, SteeringData
from machopt.report.page_types.workspace_map_page_data import MapScene
from machopt.report.pages.diagnosis.diagnosis_page import build_diagnosis_html
from machopt.report.pages.map_page import build_map_html
from machopt.report.pages.optimize.optimize_page import build_report_html
from machopt.report.pages.placement_page import build_placement_html
from machopt.report.pages.pose_plan_page import build_pose_plan_html
from machopt.view.cell_page import build_cell_html

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
STEERING = SteeringData(
    operations=(("rim", ((0, 20),)), ("holes", ((25, 50),))),
    points=60,
    branches=8,
    axes=(SteeringAxis("rail", "mm", -1000.0, 1000.0),),
    wishes={"fixed": [{"point": 3, "gamma_deg": 20.0}], "steer": [{"operation": "rim", "branch": 2}], "external": {}},
    compared=(PlanComparison(name="Objective", unit="", before=1.0, now=0.9, decimals=3),),
    message="Planned in 2.0 s.",
    has_motion=True,
    file="plan.yaml",
    command="machopt optimize cell part.cls --plan plan.yaml",
)


def pages(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and the page of each type."""
    cell = small_cell(folder)
    report, _ = build_report_with_motion_scene(cell)
    yield "report", build_report_html(report)
    yield "view", build_report_html(report, STEERING)
    yield "infeasible", build_report_html(infeasible_result())
    yield "toolpath", evil_toolpath()
    scene, _ = build_cell_scene(cell)
    yield "cell", build_cell_html(cell)
    space = MapScene(scene, np.eye(4), cell.external_home)
    for kind in ("slice", "volume", "line"):
        yield f"map of a {kind}", build_map_html(build_sample_map(kind, space=space))
    found = diagnosis_of("explained")
    q = sample_diagnoses.recording().q
    yield "diagnosis", build_diagnosis_html(replace(found, scene=scene, q=q))
    yield "diagnosis of a motion", build_diagnosis_html(diagnosis_of("torque"))
    yield "identification", evil_identification()
    yield "batch", evil_batch()
    yield "place", build_placement_html(build_sample_placement())
    yield "poses", planned_poses(folder)
    yield (
        "no poses",
        build_pose_plan_html(
            PosePlanPageData(
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
    """Return the page of a plan of few poses, written by the command: it has a scene, curves and a sequence of
    measurements."""
    words = ["--poses", "3", "--candidates", "60", "--starts", "1", "--weights-kg", "50", "--no-collision", "--quiet"]
    assert main(["plan-poses", str(CELL), "-o", str(folder / "poses"), *words]) == 0
    return (folder / "poses" / "report.html").read_text(encoding="utf-8")

"""Feed advice: the largest feeds within tolerance at their own load."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_outcome_at_other_rotation import CELLS, HOLES, WALL, start

from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.data_types.toolpath import MoveKind
from machopt.planning.error_probability.random_draws import HOLE_DRAWS
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.tolerance.cutting_dynamics import compute_cutting_dynamics
from machopt.planning.tolerance.feed_advice import WIDEST
from machopt.planning.tolerance.point_errors import compute_point_errors
from machopt.planning.tolerance.process_results import find_driven_feed
from machopt.process.binding.job_binding import compute_loads

DRILLING = """machopt_process: 1
materials:
  al: {{drilling: {{kc1: 800, mc: 0.25, chisel_N_mm2: {chisel}, thrust_spread_percent: {spread},
    torque_spread_percent: 25, source: t}}}}
operations:
  default: {{kind: drilling, spindle_rpm: 4000, layers: [{{material: al, thickness_mm: 12}}], depth_mm: 12, {foot}
    tolerance: {tolerance}}}
"""


def find_advice(folder: Path, cell: Path, rows: str, process: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the advised points, the probabilities at the advised feed and 3 % above it, and the quantile."""
    (folder / "job.csv").write_text(rows)
    (folder / "mine.yaml").write_text(process)
    request = OptimizeRequest(
        cell=cell,
        toolpath=folder / "job.csv",
        out=folder / "out",
        process=folder / "mine.yaml",
        direct={"rotation_step_deg": 30},
    )
    given = load_optimize_inputs(request)
    segment = given.segments[0]
    toolpath = segment.toolpath
    plan = find_best_plan(segment.cell, toolpath, segment.restrict_options(given.options))
    loads = compute_loads(segment.cell, toolpath, toolpath.feed)
    assert loads is not None
    wall = compute_cutting_dynamics(plan, toolpath, loads).wall_force
    found = compute_point_errors(plan, toolpath, loads, wall_force=wall, is_full=True)
    points = np.flatnonzero(found.feed_max > 0.0)

    def compute_again(factor: float) -> np.ndarray:
        feed = np.where(found.feed_max > 0.0, factor * found.feed_max, toolpath.feed)
        again = compute_loads(segment.cell, toolpath, feed)
        assert again is not None
        force = compute_cutting_dynamics(plan, toolpath, again).wall_force
        return compute_point_errors(plan, toolpath, again, wall_force=force, hole_draws=HOLE_DRAWS).p_in[points]

    assert segment.cell.process is not None
    inner = found.feed_max[points] < (WIDEST - 1e-6) * toolpath.feed[points]
    above = np.where(inner, compute_again(1.03), np.nan)
    return points, compute_again(1.0), above, segment.cell.process.quantile


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chisel", "spread", "foot", "tolerance"),
    [
        (0, 30, "", "{position_mm: 0.3, reference: relative}"),
        (1500, 30, "", "{position_mm: 0.3, axis_deg: 0.05, reference: relative}"),
        (1500, 60, "", "{position_mm: 0.45, axis_deg: 0.03, depth_mm: 1.0, reference: absolute}"),
        (300, 30, "clamp_N: 200, foot_friction: 0.2,", "{position_mm: 0.4, reference: relative}"),
    ],
)
def test_hole_passes_at_its_advised_feed(tmp_path: Path, chisel: int, spread: int, foot: str, tolerance: str) -> None:
    text = DRILLING.format(chisel=chisel, spread=spread, foot=foot, tolerance=tolerance)
    points, at, above, quantile = find_advice(tmp_path, CELLS / "kr240_drilling", HOLES, text)
    assert len(points)
    assert (at >= quantile).all()
    assert (above[np.isfinite(above)] < quantile).all()


@pytest.mark.slow
@pytest.mark.parametrize("side_stiffness", [None, 2500.0])
def test_milled_point_passes_at_its_advised_feed(tmp_path: Path, side_stiffness: float | None) -> None:
    cell = tmp_path / "cell"
    shutil.copytree(CELLS / "kr500_milling", cell)
    text = (cell / "cell.yaml").read_text()
    if side_stiffness is not None:
        text = text.replace("helix_deg: 30}", f"helix_deg: 30, side_stiffness_N_mm: {side_stiffness}}}")
        assert "side_stiffness" in text
    (cell / "cell.yaml").write_text(text)
    process = (cell / "process.yaml").read_text()
    process = process.replace("surface_mm: 0.1", f"surface_mm: {0.085 if side_stiffness is None else 0.2}")
    process = process.replace("h_mm: [0.02, 0.12]", "h_mm: [0.005, 0.9]")
    points, at, above, quantile = find_advice(tmp_path, cell, WALL, process)
    assert len(points)
    assert (at >= quantile - 2e-4).all()  # the deflection is linear between the smallest and the largest feed
    assert (above[np.isfinite(above)] < quantile).all()


@pytest.mark.slow
def test_samples_of_a_retract_move_are_no_cutting_feed(tmp_path: Path) -> None:
    own = (CELLS / "kr500_milling" / "process.yaml").read_text()
    one = start(tmp_path, "kr500_milling", WALL, own).current.job_result.segments[0]
    timeline: MotionTimeline | None = one.timeline
    assert timeline is not None
    assert timeline.trajectory is not None
    t = timeline.trajectory
    last = int(np.flatnonzero(one.segment.toolpath.cutting)[-1])
    feed = t.feed.copy()
    feed[(t.move != MoveKind.CUT) & np.isfinite(feed)] = 1.0  # m/s, far above the feed of the cut
    faster = replace(timeline, trajectory=replace(t, feed=feed))
    path = replace(one.segment.toolpath, feed=np.where(np.isnan(one.segment.toolpath.feed), np.nan, 2.0))
    assert find_driven_feed(path, faster)[last] == pytest.approx(find_driven_feed(path, timeline)[last])
    assert find_driven_feed(path, faster)[last] < 0.03

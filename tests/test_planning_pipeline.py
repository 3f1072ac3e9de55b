"""Planning pipeline on the shipped cells: never worse than the baselines, deterministic, clear failures."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from small_cell import pose, small_cell
from test_planning_path import Rows, length_weight, toolpath

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.data_types.cell import CollisionShape, Workpiece
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import FixedRotation, PlanOptions, ProcessForce
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.planning.cost.stiffness_index import resolve_index
from machopt.planning.motion.rapid_moves import retime_straight_segments
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings, prepare_planning
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma, compute_reach_shortfall, explain_points
from machopt.planning.plan_output.plan_remarks import list_hints
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.stations.planning_path import compute_tcp_poses
from machopt.stiffness.joint_compliance import compute_deflection, compute_directional_compliance, compute_jiao_index
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = FilePath(__file__).resolve().parent.parent
C, R = MoveKind.CUT, MoveKind.RAPID
UP = (0.0, 0.0, 1.0)
K = np.array([1.4e6, 4.0e5, 9.4e5, 3.6e5, 3.7e5, 3.8e5])  # N·m/rad
FORCE = ProcessForce(travel=150.0, normal=400.0, axial=200.0)
EXACT = 1e-9  # m and rad
FREE = PlanOptions(collision=False)
CASES = {
    "kr500 plain": ("kr500_milling", "plain.csv", FREE),
    "kr500 head": ("kr500_milling", "cylinder_head_face.cls", FREE),
    "kr500 force": ("kr500_milling", "plain.csv", PlanOptions(collision=False, force=FORCE)),
    "kr500 jiao index": ("kr500_milling", "plain.csv", PlanOptions(collision=False, index="jiao2022")),
    "kr240 holes": ("kr240_drilling", "panel_holes.csv", FREE),
    "irb6700 holes": ("irb6700_drilling", "plate_holes.csv", FREE),
    "s420f": ("s420f_handling", "castings.csv", FREE),
    "cobot": ("cutting_cobot", "bone_tracks.csv", FREE),
    "irb6700 checked": ("irb6700_drilling", "plate_holes.csv", PlanOptions()),
}


@cache
def plan_case(case: str) -> Plan:
    cell, tp, options = CASES[case]
    return plan_path(load_cell(ROOT / "cells" / cell), read_toolpath(ROOT / "toolpaths" / tp), options)


def small_job(folder: FilePath, rows: Rows, options: PlanOptions = FREE, **changes: object) -> Plan:
    cell = small_cell(folder, **{"stiffness": ArmStiffness(joints=K), **changes})
    return plan_path(cell, toolpath(rows), options)


def pass_over_block(n: int = 9, z: float = 0.01) -> Rows:
    rows: Rows = [((-0.1, -0.1, 0.08), UP, R)]
    return rows + [((-0.1 + 0.2 * k / (n - 1), -0.1, z), UP, C) for k in range(n)]


# --- never worse -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_chosen_plan_is_never_worse_than_jiao2022_or_the_cam_default(case: str) -> None:
    p = plan_case(case)
    total = p.chosen.objective.total
    assert np.isfinite(total)
    assert len(p.missing) == 0
    for other in (p.jiao2022, p.cam_default):
        # a baseline that collides or is incomplete cannot do the job; its objective is infinite or not comparable
        if (other.assignment.reason == InfeasibilityReason.OK).all() and not p.options.collision:
            assert total <= other.objective.total
    assert total <= p.grid.total * (1 + 1e-9)  # smoothing does not increase J


@pytest.mark.parametrize("case", CASES)
def test_objective_equals_its_definition(case: str) -> None:
    """Recompute J from the joints alone: mean and worst index, travel and rotation by run, time lost to slow axes."""
    p = plan_case(case)
    a, w, path, d = p.chosen.assignment, p.options.weights, p.path, p.directions
    counted = path.counted
    T, J = p.setup.robot.compute_fk_jacobian(a.q, p.setup.arm.T_flange_tcp)
    cost = np.empty(len(a.q))
    for i in range(len(a.q)):
        if p.scores.index == "deflection":
            cost[i] = np.linalg.norm(compute_deflection(J[i], d.k[i], d.force[i]))
        elif p.scores.index == "jiao2022":
            cost[i] = 1 / compute_jiao_index(J[i], d.k[i], -T[i, :3, 2])
        else:
            axial = compute_directional_compliance(J[i], d.k[i], -T[i, :3, 2])
            cost[i] = (
                axial
                if path.is_drilling[i]
                else (axial + compute_directional_compliance(J[i], d.k[i], d.normal[i])) / 2
            )
    c = cost[counted] / p.scores.scale
    o = p.chosen.objective
    assert o.mean == pytest.approx(length_weight(path)[counted] @ c, rel=1e-8)
    assert o.worst == pytest.approx(c.max(), rel=1e-8)
    share = path.motion_share
    rapids = [i for i in range(1, len(a.q)) if path.run[i] != path.run[i - 1]]

    def swing(i: int) -> float:
        d = np.linalg.norm(path.position[i] - path.position[i - 1])
        return 1.0 if path.run[i] == path.run[i - 1] else float(1 + 0.5 / (d + 0.05))  # a move of 0.5 m is short

    assert o.travel == pytest.approx(
        sum(share[i] * swing(i) * np.abs(a.q[i] - a.q[i - 1]).sum() for i in range(1, len(a.q))) / np.pi, rel=1e-9
    )
    turned = sum(share[i] * abs(a.phi[i] - a.phi[i - 1]) for i in range(1, len(a.q)) if path.run[i] == path.run[i - 1])
    assert o.rotation == pytest.approx(turned / np.pi, rel=1e-9, abs=1e-15)
    limits = p.setup.cell.limits
    home = p.setup.cell.home + 2 * np.pi * np.round((a.q[[0, -1]] - p.setup.cell.home) / (2 * np.pi))
    ends = [(home[0], a.q[0]), *((a.q[i - 1], a.q[i]) for i in rapids), (a.q[-1], home[1])]
    rides = [retime_straight_segments(np.array(pair), limits, p.options.rapid_scale, 1e-3) for pair in ends]
    seconds = 1e-3 * sum(len(ride) - 1 for ride in rides)
    assert o.rapid == pytest.approx(seconds / (path.time[-1] + len(rapids)), abs=1e-3 * len(rides) / path.time[-1])
    flips = sum(a.branch[i] != a.branch[i - 1] for i in rapids) if p.candidates.stable else 0
    turns = sum(int(np.round(np.abs(a.q[i] - a.q[i - 1]) / (2 * np.pi)).sum()) for i in rapids)
    assert p.scores.rapid is not None
    assert o.reorientation == pytest.approx((flips + turns) * p.scores.rapid.unit)
    parts = (
        w.rapid * o.rapid
        + w.reorientation * o.reorientation
        + w.clearance * o.clearance
        + w.mean * o.mean
        + w.worst * o.worst
        + w.travel * o.travel
        + w.rotation * o.rotation
        + w.feed * o.feed
        + o.preferred
    )
    assert o.total == pytest.approx(parts, rel=1e-12)


@pytest.mark.parametrize("case", CASES)
def test_configurations_are_exact_within_limits_and_away_from_singularities(case: str) -> None:
    p = plan_case(case)
    a, arm = p.chosen.assignment, p.setup.arm
    every = np.arange(len(p.path.index), dtype=np.int32)
    wanted = arm.machine.T_base_workpiece_zero @ compute_tcp_poses(p.path, every, a.phi)
    assert np.abs(p.setup.robot.compute_fk(a.q, arm.T_flange_tcp) - wanted).max() < EXACT
    assert (a.q >= arm.lower).all()
    assert (a.q <= arm.upper).all()
    assert (a.wrist >= arm.margins.wrist).all()
    assert (a.elbow >= arm.margins.elbow).all()
    assert (a.shoulder >= arm.margins.shoulder).all()
    for first, last in p.path.runs:  # one continuous motion from the end of one rapid move to the start of the next
        step = np.abs(np.diff(a.q[first : last + 1], axis=0))
        assert np.degrees(step.max(initial=0.0)) < 40
        assert len(set(a.branch[first : last + 1].tolist())) == 1 or not p.candidates.stable
        assert (np.abs(np.diff(a.phi[first : last + 1]))[p.path.plunge[first + 1 : last + 1]] < 1e-9).all()


def test_index_follows_the_force_and_the_option() -> None:
    assert resolve_index(PlanOptions()) == "stiffness"
    assert resolve_index(PlanOptions(force=FORCE)) == "deflection"
    assert resolve_index(PlanOptions(force=FORCE, index="jiao2022")) == "jiao2022"
    assert plan_case("kr500 force").scores.index == "deflection"


# --- determinism --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["kr500 plain", "irb6700 checked", "cobot"])
def test_two_runs_give_the_same_numbers(case: str) -> None:
    first = plan_case(case)
    cell, tp, options = CASES[case]
    second = plan_path(
        load_cell(ROOT / "cells" / cell), read_toolpath(ROOT / "toolpaths" / tp), options, StageTimings()
    )
    for field in fields(JointAssignment):
        np.testing.assert_array_equal(
            getattr(first.chosen.assignment, field.name), getattr(second.chosen.assignment, field.name)
        )
    assert first.chosen.objective == second.chosen.objective
    assert first.chosen_from == second.chosen_from


# --- requirements of the user -------------------------------------------------------------------------------


def test_fixed_rotation_holds_at_its_point_and_bounds_everywhere(tmp_path: FilePath) -> None:
    low, high = np.radians([-60.0, 60.0])
    want = np.radians(17.0)
    options = replace(FREE, rotation_range=(low, high), fixed=(FixedRotation(5, want),))
    p = small_job(tmp_path, pass_over_block(), options)
    g = compute_gamma(p)
    at = int(np.flatnonzero(p.path.index == 5)[0])
    assert len(p.missing) == 0
    assert g[at] == pytest.approx(want, abs=1e-5)  # rad; tolerance of the solver
    assert (g >= low - np.radians(0.3)).all()
    assert (g <= high + np.radians(0.3)).all()


def test_methods_plan_as_named() -> None:
    cell, tp = load_cell(ROOT / "cells" / "kr240_drilling"), read_toolpath(ROOT / "toolpaths" / "panel_holes.csv")
    for method, source in (("jiao2022", "jiao2022"), ("default", "cam default")):
        p = plan_path(cell, tp, PlanOptions(collision=False, method=method))  # type: ignore[arg-type]
        assert p.chosen_from == source
        yardstick = p.jiao2022 if method == "jiao2022" else p.cam_default
        np.testing.assert_array_equal(p.chosen.assignment.q, yardstick.assignment.q)
    np.testing.assert_allclose(compute_gamma(p)[p.path.counted], 0.0, atol=1e-9)


# --- infeasible jobs and their messages ---------------------------------------------------------------------


def test_unreachable_points_are_named_with_the_missing_length(tmp_path: FilePath) -> None:
    rows = [*pass_over_block(), ((3.0, 0.0, 0.01), UP, R), ((3.0, 0.1, 0.01), UP, C)]
    p = small_job(tmp_path, rows)
    missing = {float(p.path.index[i]) for i in p.missing}
    assert {10.0, 11.0} <= missing
    assert all(m >= 10.0 for m in missing)
    sentences = explain_points(p)
    assert set(sentences) == {int(i) for i in p.missing}
    for i in p.missing:
        assert p.chosen.assignment.reason[i] == InfeasibilityReason.UNREACHABLE
        short = compute_reach_shortfall(p, int(i))
        assert 1.0 < short < 3.5  # the wrist must reach about 4.6 m from axis 2; its reach is 2.15 m
        assert "out of reach at every rotation" in sentences[int(i)]
        assert f"{1e3 * short:.0f} mm" in sentences[int(i)]
    assert not np.isfinite(p.chosen.objective.total)
    assert (p.chosen.assignment.reason[p.path.index < 10] == InfeasibilityReason.OK).all()


def test_points_outside_user_range_or_margins_are_reported(tmp_path: FilePath) -> None:
    p = small_job(tmp_path, pass_over_block(), replace(FREE, singularity_wrist=np.radians(89.0)))
    assert len(p.missing) == len(p.path.index)  # a plan without any configuration is still a valid plan
    assert (p.chosen.assignment.reason == InfeasibilityReason.SINGULAR_WRIST).all()
    assert all("wrist singularity" in s for s in explain_points(p).values())
    narrow = small_job(tmp_path, pass_over_block(), replace(FREE, rotation_range=tuple(np.radians([1.0, 3.0]))))
    assert all("outside the given rotation range" in s for s in explain_points(narrow).values())


def test_wall_around_the_work_is_a_named_collision(tmp_path: FilePath) -> None:
    lid = CollisionShape(name="lid", kind="box", size=(0.6, 0.6, 0.02), mesh=None, T_parent_shape=pose(1.5, 0.0, 0.7))
    p = small_job(tmp_path, pass_over_block(), PlanOptions(), obstacles=(lid,))
    assert len(p.missing) > 0
    assert p.check is not None
    texts = set(explain_points(p).values())
    assert any("lid" in t or "collide" in t for t in texts), texts


def test_tool_parallel_to_axis_6_is_reported(tmp_path: FilePath) -> None:
    p = small_job(tmp_path, pass_over_block())
    assert any(
        "from axis 6" in h and "joint 6" in h for h in list_hints(p)
    )  # the tool of the small cell is in line with axis 6
    turned = np.ptp(p.candidates.q[3, :, 0, :5], axis=0)
    assert turned.max() < 1e-9  # the other joints do not move
    for case in ("kr500 plain", "irb6700 holes"):
        assert not any("from axis 6" in h for h in list_hints(plan_case(case)))


def test_points_outside_the_stiffness_grid_are_reported(tmp_path: FilePath) -> None:
    grid = load_stiffness(ROOT / "cells" / "kr500_milling" / "stiffness_two_grid.yaml")
    p = small_job(tmp_path, pass_over_block(), stiffness=grid)
    assert any("100 % of the cutting points lie outside" in h for h in list_hints(p))
    cell = replace(load_cell(ROOT / "cells" / "kr500_milling"), stiffness=grid)
    inside = plan_path(cell, read_toolpath(ROOT / "toolpaths" / "plain.csv"), FREE)
    assert not any("stiffness grid" in h for h in list_hints(inside))


def test_unplannable_cell_is_refused(tmp_path: FilePath) -> None:
    cell = small_cell(tmp_path)
    with pytest.raises(InputError, match="no stiffness file"):
        prepare_planning(cell, FREE)
    stiff = replace(cell, stiffness=ArmStiffness(joints=K))
    with pytest.raises(InputError, match="link 'table' is not in the URDF; it has base_link"):
        prepare_planning(replace(stiff, workpiece=Workpiece("table", np.eye(4))), FREE)
    with pytest.raises(InputError, match="lacks values for 1/EI, 1/GJ"):
        prepare_planning(
            replace(cell, stiffness=ArmStiffness(joints=K, terms=(StiffnessTerm("link_compliance", "link:2"),))), FREE
        )

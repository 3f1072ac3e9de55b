"""Compensated path: the deflected tool is at the programmed position; reasons where no shift is possible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count
from test_cli import optimize
from test_planning_path import Rows, build_planning_path, toolpath
from test_planning_pipeline import FORCE, FREE, K, plan_case, small_job

from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions, ProcessForce
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.options.plan_option_reader import load_options
from machopt.planning.compensation.plan_compensation import add_corner_points, compensate_plan
from machopt.planning.compensation.shifted_path import STEEPEST, compute_offset_slope, compute_residual, shift_path
from machopt.planning.cost.process_force_direction import compute_engaged_force, compute_sideways_directions
from machopt.planning.job.joined_plan import ToolSegmentPlan, join_plans
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.infeasibility_reasons import explain_points
from machopt.planning.tolerance.error_sensitivities import locate_poses
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.joint_stiffness import compute_joint_stiffness
from machopt.verification.motion.checks.compensation_shift import FORCE_TOLERANCE
from machopt.verification.motion.path_geometry.process_force import compute_engaged_share, compute_mean_force

ROOT = FilePath(__file__).resolve().parent.parent
UP = (0.0, 0.0, 1.0)
C, R, A, BACK = MoveKind.CUT, MoveKind.RAPID, MoveKind.APPROACH, MoveKind.RETRACT
HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"


def corner() -> Rows:
    """Return a path down, along x, around a sharp corner, along y and up; then a hole drilled directly after a rapid
    move."""
    rows: Rows = [((-0.1, -0.1, 0.06), UP, R), ((-0.1, -0.1, 0.01), UP, A)]
    rows += [((-0.1 + 0.05 * k, -0.1, 0.01), UP, C) for k in range(1, 4)]
    rows += [((0.05, -0.1 + 0.05 * k, 0.01), UP, C) for k in range(1, 3)]
    return [*rows, ((0.05, 0.0, 0.06), UP, BACK), ((0.1, 0.1, 0.02), UP, R), ((0.1, 0.1, 0.0), UP, C)]


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    options = replace(FREE, force=FORCE, rotation_step=np.radians(15.0), compensation_max=0.01)
    plain = small_job(tmp_path_factory.mktemp("cell"), corner(), options)
    assert len(plain.missing) == 0
    after = compensate_plan(plain, toolpath(corner()))
    assert after.compensation is not None
    return add_corner_points(plain, toolpath(corner()), after.compensation.length), after


def straight_on(p: Plan) -> np.ndarray:
    """Return the planning points of cuts farther from the corner than the blending length of the force."""
    assert p.compensation is not None
    at = int(np.flatnonzero(p.path.index == 4)[0])
    return np.flatnonzero(p.path.counted & (np.abs(p.path.s - p.path.s[at]) > 1.01 * p.compensation.length))


def compute_loaded_tips(p: Plan, rows: np.ndarray, stiffness: ArmStiffness) -> np.ndarray:
    """Return the TCP (n, 3) in the workpiece frame in static equilibrium with the force, with the nonlinear
    joint-spring model."""
    robot, tool, T = p.setup.robot, p.setup.arm.T_flange_tcp, p.setup.arm.machine.T_base_workpiece_zero
    nominal = p.path.position if p.compensation is None else p.path.position - p.compensation.offset
    k = compute_joint_stiffness(stiffness, nominal[rows] @ T[:3, :3].T + T[:3, 3]).k
    commanded = p.chosen.assignment.q[rows]
    q = commanded
    for _ in range(20):
        tau = np.einsum("mci,mc->mi", robot.compute_fk_jacobian(q, tool)[1][:, :3], p.directions.force[rows])
        q = commanded + tau / k
    return np.asarray((robot.compute_fk(q, tool)[:, :3, 3] - T[:3, 3]) @ T[:3, :3])


# --- shift -------------------------------------------------------------------------------------------------------


def test_deflected_tool_is_at_the_programmed_position(bent: tuple[Plan, Plan]) -> None:
    """Reference: the nonlinear equilibrium of the joint springs; the planner uses a linear deflection."""
    before, after = bent
    rows = straight_on(after)
    d = np.linalg.norm(compute_loaded_tips(before, rows, ArmStiffness(joints=K)) - before.path.position[rows], axis=1)
    left = np.linalg.norm(compute_loaded_tips(after, rows, ArmStiffness(joints=K)) - before.path.position[rows], axis=1)
    assert d.min() > 5e-4
    # second-order error: |f| L/k of the deflection, 450 N · 2.5 m / 4e5 N·m = 0.3 %
    assert (left < 0.005 * d).all()
    assert after.compensation is not None
    np.testing.assert_allclose(np.linalg.norm(after.compensation.offset[rows], axis=1), d, rtol=0.01)
    np.testing.assert_array_equal(after.chosen.assignment.phi, before.chosen.assignment.phi)  # the same rotation
    T = after.setup.robot.compute_fk(after.chosen.assignment.q, after.setup.arm.T_flange_tcp)
    base = after.setup.arm.machine.T_base_workpiece_zero
    np.testing.assert_allclose(-T[:, :3, 2] @ base[:3, :3], after.path.axis, atol=1e-8)  # and the same tool axis
    np.testing.assert_allclose((T[:, :3, 3] - base[:3, 3]) @ base[:3, :3], after.path.position, atol=1e-8)


def test_shift_does_not_change_the_load_directions(bent: tuple[Plan, Plan]) -> None:
    """The force acts along the programmed moves; with shifted moves a fading shift would rotate it by up to six
    degrees."""
    before, after = bent
    assert np.linalg.norm(after.path.position - before.path.position, axis=1).max() > 5e-4
    for path in (after.path, join_plans([ToolSegmentPlan(p, 0, "") for p in (after, before)]).path):
        rows = slice(0, len(before.path.index))
        np.testing.assert_array_equal(compute_sideways_directions(path)[rows], compute_sideways_directions(before.path))
        np.testing.assert_array_equal(path.programmed.position[rows], before.path.position)
    poses = [locate_poses(p, p.chosen, np.linspace(0.0, 9.0, 40)) for p in bent]
    np.testing.assert_array_equal(poses[1].travel, poses[0].travel)


def test_shift_fades_along_approach_and_retract_without_jumps(bent: tuple[Plan, Plan]) -> None:
    before, after = bent
    assert after.compensation is not None
    path, offset, length = before.path, after.compensation.offset, after.compensation.fade
    size = np.linalg.norm(offset, axis=1)
    at = {float(k): n for n, k in enumerate(path.index)}
    assert size[at[0.0]] == 0.0
    assert size[at[7.0]] == 0.0
    # the cut starts with the full shift
    np.testing.assert_allclose(offset[at[1.0]], offset[at[2.0]], rtol=0.1, atol=2e-5)
    away = np.where(path.s < path.s[at[1.0]], path.s[at[1.0]] - path.s, path.s - path.s[at[6.0]])
    air = (path.run == 0) & ((path.index < 1) | (path.index > 6))
    assert (size[air & (away >= length)] == 0).all()  # no cutting there
    for n in np.flatnonzero(air & (away < length)):
        full = size[at[1.0] if path.index[n] < 1 else at[6.0]]
        assert size[n] == pytest.approx((1 - away[n] / length) * full, rel=0.05)
    # the hole starts at the end of the rapid move: that end is shifted, so that the drill enters straight
    np.testing.assert_allclose(offset[at[8.0]], offset[at[9.0]], rtol=0.05, atol=2e-5)
    steep = compute_offset_slope(path, offset)
    assert steep.max() <= STEEPEST
    # stated bound: the largest shift over either length, plus the change of the pose
    most = float(np.linalg.norm(np.diff(offset[[at[4.0] - 1, at[4.0]]], axis=0)))
    assert most < size.max()
    assert steep.max() <= 1.2 * size.max() * (1 / after.compensation.length + 1 / length)


def test_refinement_changes_no_choice(tmp_path: FilePath) -> None:
    plain = small_job(tmp_path, corner(), replace(FREE, force=FORCE, rotation_step=np.radians(15.0)))
    fine = add_corner_points(plain, toolpath(corner()), 0.002)
    rows = np.searchsorted(fine.path.index, plain.path.index)
    assert len(fine.path.index) == len(plain.path.index) + 3 * 4  # around the corner, start and end of the cut
    new = np.setdiff1d(np.arange(len(fine.path.index)), rows)
    np.testing.assert_array_equal(fine.path.stations, rows[plain.path.stations])
    for name in ("chosen", "jiao2022", "cam_default"):
        a, b = getattr(plain, name), getattr(fine, name)
        np.testing.assert_array_equal(b.assignment.q[rows], a.assignment.q)
        np.testing.assert_array_equal(b.assignment.reason[rows], a.assignment.reason)
        np.testing.assert_allclose(b.cost[rows], a.cost, rtol=1e-12)
        if np.isfinite(a.objective.total):
            # the force at the corner was weighted with half of the 17 mm before it, and now with half a millimetre
            assert b.objective.mean == pytest.approx(a.objective.mean, rel=0.05)
            low, high = a.assignment.phi[rows.searchsorted(new) - 1], a.assignment.phi[rows.searchsorted(new)]
            assert (np.minimum(low, high) - 1e-12 <= b.assignment.phi[new]).all()
            assert (b.assignment.phi[new] <= np.maximum(low, high) + 1e-12).all()
    arm = fine.setup.arm
    T = fine.setup.robot.compute_fk(fine.chosen.assignment.q, arm.T_flange_tcp)
    base = arm.machine.T_base_workpiece_zero
    np.testing.assert_allclose((T[:, :3, 3] - base[:3, 3]) @ base[:3, :3], fine.path.position, atol=1e-8)
    straight: Rows = [((0, 0, 0.02), UP, R), ((0, 0, 0), UP, C), ((0, 0, -0.01), UP, C)]
    same = small_job(tmp_path, straight, replace(FREE, rotation_step=np.radians(30.0)))
    assert add_corner_points(same, toolpath(straight), 0.002) is same


def test_residual_is_second_order_on_lines_and_half_the_force_turn_at_a_corner(
    bent: tuple[Plan, Plan],
) -> None:
    before, after = bent
    found = compute_residual(after)
    assert found is not None
    assert compute_residual(before) is None
    at = int(np.flatnonzero(before.path.index == 4)[0])  # the corner: along x before it, along y after it
    d = before.directions
    T = before.setup.arm.machine.T_base_workpiece_zero[:3, :3]
    elastic = before.setup.elasticity.evaluate(after.chosen.assignment.q[[at]], d.k[[at]])
    jump = elastic.compute_deflection(d.force[[at]])[0] - elastic.compute_deflection(d.force[[at - 1]])[0]
    assert found.worst == pytest.approx(0.5 * float(np.linalg.norm(jump @ T)), rel=0.05)
    assert found.uncompensated > 5e-4
    assert found.mean < 0.1 * found.uncompensated
    assert found.shift_mean == pytest.approx(found.uncompensated, rel=0.1)


def test_inclined_plunge_shifts_like_an_upright_one(tmp_path: FilePath) -> None:
    """The lateral component of a plunge inclined by a few degrees neither rotates the force nor makes it jump."""
    force = ProcessForce(travel=120.0, normal=250.0, axial=80.0)
    found = {}
    for lean in (0.0, 0.5, 1.0, 1.5, 3.0, 5.0):
        across = 0.04 * float(np.tan(np.radians(lean)))
        rows: Rows = [((-0.05, across, 0.04), UP, R), ((-0.05, 0, 0.0), UP, C), ((0.05, 0, 0.0), UP, C)]
        path = build_planning_path(toolpath(rows), corners=0.005)
        found[lean] = compute_engaged_force(path, force, 0.005)
        way = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
        size = float(np.sqrt(120**2 + 250**2 + 80**2))
        assert (np.linalg.norm(np.diff(found[lean], axis=0), axis=1) <= 1.02 * 2 * size / 0.005 * way).all()
        entry = int(np.flatnonzero(path.index == 1)[0])
        upright = found[0.0][: entry + 1]
        np.testing.assert_allclose(found[lean][entry], upright[-1], atol=0.55 * size)
    step = [np.linalg.norm(found[b][1] - found[a][1]) for a, b in ((0.0, 0.5), (0.5, 1.0), (1.0, 1.5))]
    assert max(step) < 0.06 * size  # w(sin 1.5° / sin 10°) = 6 %: no jump at any angle


def recompute_force(job: Toolpath, index: np.ndarray, force: ProcessForce, lengths: tuple[float, float]) -> np.ndarray:
    """Compute the force (P, 3) in N with the verifier's formula, for the blending and the fading length."""
    share = compute_engaged_share(job, index, lengths[1])
    return np.asarray(share[:, None] * compute_mean_force(job, index, force, lengths[0]))


@settings(max_examples=scale_example_count(60), deadline=None, derandomize=not NIGHTLY)
@given(st.integers(0, 10_000), st.sampled_from([0.005, 0.01, 0.02]), st.sampled_from([0.005, 0.01, 0.02, 0.04]))
def test_compensated_force_never_jumps(seed: int, length: float, fade: float) -> None:
    """Random paths with inclined plunges, corners, reversals, links and rapid moves: the stated Lipschitz bound
    holds."""
    rng = np.random.default_rng(seed)
    rows: Rows = []
    position = np.zeros(3)
    for _ in range(int(rng.integers(1, 4))):
        position = position + np.array([*rng.uniform(-0.1, 0.1, 2), 0.0])
        lean = np.radians(rng.uniform(0.5, 5.0)) * rng.choice([-1, 1])
        top = position + 0.03 * np.array([np.tan(lean), 0.0, 1.0])
        rows.append((tuple(top), UP, R))
        rows.append((tuple(position), UP, MoveKind(int(rng.choice([C, A])))))
        for _ in range(int(rng.integers(1, 6))):
            position = position + rng.uniform(-0.04, 0.04, 3) * [1, 1, 0.2] * rng.choice(
                [0.0, 0.02, 1.0], p=[0.1, 0.2, 0.7]
            )
            rows.append((tuple(position), UP, MoveKind(int(rng.choice([C, C, C, MoveKind.LINK])))))
        if rng.uniform() < 0.7:
            rows.append((tuple(position + np.array([0, 0, 0.03])), UP, BACK))
    path = build_planning_path(toolpath(rows), corners=length)
    force = ProcessForce(*rng.uniform(-300, 300, 3))
    f = compute_engaged_force(path, force, length, fade)
    size = float(np.linalg.norm([force.travel, force.normal, force.axial]))
    assert (np.linalg.norm(f, axis=1) <= size * (1 + 1e-9)).all()
    joined = path.run[1:] == path.run[:-1]
    way = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    change = np.linalg.norm(np.diff(f, axis=0), axis=1)
    grain = 2 * size / 128  # the mean over a window is computed at 128 positions
    assert (change[joined] <= size * (1 / length + 1 / fade) * way[joined] + grain).all()
    # zero force at ends without cutting, where the move is long enough for the change
    for first, last in path.runs:
        ways = way[first:last]
        cuts = np.flatnonzero((path.move[first + 1 : last + 1] == C) & (ways > 0))
        if not len(cuts):
            assert not f[first : last + 1].any()
            continue
        if ways[: cuts[0]].sum() >= fade and cuts[0] > 0:
            assert not f[first].any()
        if ways[cuts[-1] + 1 :].sum() >= fade and cuts[-1] + 1 < len(ways):
            assert not f[last].any()
    theirs = recompute_force(toolpath(rows), path.index, force, (length, fade))
    # the verifier's formula agrees
    assert np.linalg.norm(f - theirs, axis=1).max(initial=0.0) <= FORCE_TOLERANCE * size


def test_short_approach_leaves_the_whole_shift_in_the_hole() -> None:
    """Approach and retract moves shorter than the fading length: the whole cut has the full shift."""
    force = ProcessForce(travel=0.0, normal=0.0, axial=200.0)
    for above in (0.001, 0.004, 0.009, 0.03):
        rows: Rows = [((0, 0, 0.05), UP, R), ((0, 0, above), UP, R), ((0, 0, 0.0), UP, A), ((0, 0, -0.01), UP, C)]
        rows.append(((0, 0, above), UP, BACK))
        path = build_planning_path(toolpath(rows), corners=0.01)
        f = compute_engaged_force(path, force, 0.01)
        cut = (path.index >= 2) & (path.index <= 3)
        np.testing.assert_allclose(f[cut], np.tile([0.0, 0.0, 200.0], (int(cut.sum()), 1)), rtol=1e-9)
        theirs = recompute_force(toolpath(rows), path.index, force, (0.01, 0.01))
        np.testing.assert_allclose(theirs, f, atol=FORCE_TOLERANCE * 200.0)


def test_compensation_on_a_simulated_truth_improves_as_in_jiao2022() -> None:
    """True model: Eqs. 39 and 40 with their two cubes. Compared: no compensation, one set of constants (Eq. 38), and
    the grid.

    The paper measures 0.287 mm without compensation, 0.120 mm with one set and 0.057 mm with 128 cells; the true model
    here has two cells.
    """
    p = plan_case("kr500 force")
    truth = load_stiffness(ROOT / "cells" / "kr500_milling" / "stiffness_two_grid.yaml")
    rows = np.flatnonzero(p.path.counted)

    def error(model: ArmStiffness | None) -> float:
        if model is None:
            return float(np.linalg.norm(compute_loaded_tips(p, rows, truth) - p.path.position[rows], axis=1).mean())
        arm = p.setup.arm
        at = p.path.position @ arm.machine.T_base_workpiece_zero[:3, :3].T + arm.machine.T_base_workpiece_zero[:3, 3]
        setup = replace(p.setup, elasticity=ArmElasticity(p.setup.robot, arm.T_flange_tcp, model))
        directions = replace(p.directions, k=compute_joint_stiffness(model, at).k)
        moved = shift_path(replace(p, setup=setup, directions=directions), 0.005)
        return float(np.linalg.norm(compute_loaded_tips(moved, rows, truth) - p.path.position[rows], axis=1).mean())

    assert truth.grid is not None
    none, constant, grid = error(None), error(ArmStiffness(joints=truth.joints)), error(truth)
    assert constant < 0.6 * none  # the paper: 0.42
    assert grid < 0.01 * none
    # an identification error of 5 % in every joint leaves 5 % of the error
    off = replace(truth, grid=replace(truth.grid, joints=1.05 * truth.grid.joints))
    assert error(off) == pytest.approx(0.05 / 1.05 * none, rel=0.08)  # plus the remainder at changes of direction


# --- impossible shifts -------------------------------------------------------------------------------------------


LARGE = 100.0  # m: no shift is refused for its size


def soften_plan(p: Plan, factor: float) -> Plan:
    p = replace(p, options=replace(p.options, compensation_max=LARGE))
    setup = replace(
        p.setup, elasticity=ArmElasticity(p.setup.robot, p.setup.arm.T_flange_tcp, ArmStiffness(joints=K / factor))
    )
    return replace(p, setup=setup, directions=replace(p.directions, k=p.directions.k / factor))


def test_points_without_a_shift_state_the_reason(bent: tuple[Plan, Plan], tmp_path: FilePath) -> None:
    before, after = bent
    far = shift_path(soften_plan(before, 3000.0), 1000.0)  # shifts of metres, over a length that avoids the slope limit
    assert len(far.missing) > 0
    assert far.compensation is not None
    texts = explain_points(far)
    for n in far.missing:
        assert far.chosen.assignment.reason[n] != InfeasibilityReason.OK
        assert "possible as programmed, but not with the compensation of" in texts[int(n)]
    assert any("out of reach" in t or "same branch" in t for t in texts.values())
    assert not np.isfinite(far.chosen.objective.total)
    # a joint limit between the programmed and the shifted position
    n = int(np.flatnonzero(before.path.counted)[2])
    q, moved = before.chosen.assignment.q[n], after.chosen.assignment.q[n]
    joint = int(np.abs(moved - q).argmax())
    limits = before.setup.cell.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    (upper if moved[joint] > q[joint] else lower)[joint] = 0.5 * (q[joint] + moved[joint])
    cell = replace(before.setup.cell, limits=replace(limits, lower=lower, upper=upper))
    stopped = shift_path(replace(before, setup=replace(before.setup, cell=cell)), 0.005)
    assert stopped.chosen.assignment.reason[n] == InfeasibilityReason.LIMIT
    assert "a joint would leave its range" in explain_points(stopped)[n]


def test_too_large_shift_is_refused_with_point_and_values(bent: tuple[Plan, Plan]) -> None:
    before, after = bent
    assert after.compensation is not None
    size = np.linalg.norm(after.compensation.offset, axis=1)
    most = 0.9 * float(size.max())
    small = shift_path(
        replace(before, options=replace(before.options, compensation_max=most)),
        after.compensation.length,
        fade=after.compensation.fade,
    )
    refused = np.flatnonzero(small.chosen.assignment.reason == InfeasibilityReason.SHIFT)
    np.testing.assert_array_equal(refused, np.flatnonzero(size > most))
    n = int(size.argmax())
    text = explain_points(small)[n]
    assert f"it is {1e3 * size[n]:.3f} mm, more than compensation_max_mm {1e3 * most:g}" in text
    steep = shift_path(before, 0.001)  # over a length of one millimetre
    texts = explain_points(steep)
    assert any("mm per mm of path, more than 0.1" in t for t in texts.values())


def test_colliding_shift_is_reported(tmp_path: FilePath) -> None:
    """The drill deflects by 60 mm, so that the compensated spindle would be that much deeper, in the block."""
    rows: Rows = [((0, 0, 0.06), UP, R), ((0, 0, 0.02), UP, A), ((0, 0, 0.0), UP, C), ((0, 0, 0.06), UP, BACK)]
    p = small_job(tmp_path, rows, PlanOptions(force=ProcessForce(axial=400.0), rotation_step=np.radians(30.0)))
    assert len(p.missing) == 0
    d = p.setup.elasticity.evaluate(p.chosen.assignment.q[[2]], p.directions.k[[2]]).compute_deflection(
        p.directions.force[[2]]
    )
    deep = shift_path(soften_plan(p, 0.08 / float(np.linalg.norm(d))), 0.02)
    texts = explain_points(deep)
    assert any("block" in t and "with the compensation of" in t for t in texts.values()), texts
    assert not compensate_plan(p, toolpath(rows)).missing.size  # a shift of a tenth of a millimetre does not collide


def test_points_missing_before_remain_unchanged(tmp_path: FilePath) -> None:
    rows = [*corner(), ((3.0, 0.0, 0.01), UP, R), ((3.0, 0.1, 0.01), UP, C)]
    before = small_job(tmp_path, rows, replace(FREE, force=FORCE, rotation_step=np.radians(30.0)))
    after = compensate_plan(before, toolpath(rows))
    np.testing.assert_array_equal(before.path.index[before.missing], after.path.index[after.missing])
    assert set(explain_points(before).values()) == set(explain_points(after).values())
    nothing = small_job(tmp_path, rows[-2:], replace(FREE, force=FORCE, rotation_step=np.radians(30.0)))
    assert len(compensate_plan(nothing, toolpath(rows[-2:])).missing) == len(
        nothing.missing
    )  # no solution at any point still gives a plan


def test_no_compensation_without_a_force(tmp_path: FilePath, capsys: pytest.CaptureFixture[str]) -> None:
    assert load_options({"compensate": True, "force_N": {"normal": 5.0}}).compensate
    cobot, path = ROOT / "cells" / "cutting_cobot", ROOT / "toolpaths" / "bone_tracks.csv"
    assert optimize(cobot, path, tmp_path / "out", "--compensate") == 2
    assert "force_N={normal: 200}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

"""Candidate configurations over branches, stations and rotations: independent of the number of threads."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell
from test_planning_path import Rows, toolpath

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import FixedRotation, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind
from machopt.kinematics.inverse.solver import choose_angle_origin, list_whole_turns, shift_angles
from machopt.numerics import parallel_map
from machopt.numerics.parallel_map import count_threads, map_in_threads, run_two_in_threads
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.pipeline.planning_setup import PlanningSetup, prepare_planning
from machopt.planning.sampling import candidate_enumeration as module
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates, solve_station
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath as Way
from machopt.planning.stations.planning_path import build_planning_path, compute_tcp_poses


def build_leaning_cut(n: int) -> Way:
    """Return a cut with increasing inclination of the tool axis, at the end of the workspace."""
    rows: Rows = [((0, 0, 0.05), (0.0, 0.0, 1.0), MoveKind.RAPID)]
    for f in np.linspace(0, 1, n):
        rows.append(((0.9 * f, 0.1 * f, 0.0), (0.5 * f, 0.1, 1.0 - 0.2 * f), MoveKind.CUT))
    return build_planning_path(toolpath(rows))


@pytest.fixture
def setup(tmp_path: Path) -> PlanningSetup:
    return prepare_planning(small_cell(tmp_path, stiffness=ArmStiffness(joints=np.full(6, 1e6))), OPTIONS)


OPTIONS = PlanOptions(rotation_step=np.radians(15.0), fixed=(FixedRotation(3, 0.1234),))


def equal(a: CandidateGrid, b: CandidateGrid) -> None:
    for name in ("q", "turns", "reason", "feasible", "shortfall"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name


def test_one_thread_and_three_give_the_same_bytes(setup: PlanningSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    path = build_leaning_cut(60)
    monkeypatch.setattr(module, "CHUNK", 24 * 7)
    monkeypatch.setattr(parallel_map, "count_threads", lambda: 1)
    alone = enumerate_candidates(path, setup.arm, OPTIONS)
    monkeypatch.setattr(parallel_map, "count_threads", lambda: 3)
    equal(alone, enumerate_candidates(path, setup.arm, OPTIONS))
    monkeypatch.setattr(module, "CHUNK", 4096)
    equal(alone, enumerate_candidates(path, setup.arm, OPTIONS))
    assert 0.05 < alone.feasible.any(axis=-1).mean() < 0.9
    assert len(np.unique(alone.reason)) > 3


def test_each_candidate_has_the_requested_pose(setup: PlanningSetup) -> None:
    """Including the rotation of the fixed point, which is not on the grid."""
    path, arm = build_leaning_cut(30), setup.arm
    c = enumerate_candidates(path, arm, OPTIONS)
    poses = arm.machine.T_base_workpiece_zero @ compute_tcp_poses(path, path.stations, c.phi_at())
    np.testing.assert_allclose(
        np.abs(c.phi_at() + path.offset[path.stations][:, None] - 0.1234).min(axis=1)[
            np.flatnonzero(path.index[path.stations] == 3)
        ],
        0.0,
        atol=1e-12,
    )
    exists = np.isfinite(c.q).all(axis=-1)
    s, r, b = np.nonzero(exists & (c.reason == 0))
    reached = setup.robot.compute_fk(c.q[s, r, b], arm.T_flange_tcp)
    np.testing.assert_allclose(reached, poses[s, r], atol=1e-9)
    one = arm.solver.solve(poses[4] @ invert_transform(arm.T_flange_tcp))
    np.testing.assert_allclose(wrap_angle(c.q[4] - one.q[:, c.branch]), 0.0, atol=1e-9)


@pytest.mark.parametrize("upper", [100.0, 179.0, 185.0, 270.0, 350.0, 360.0, 720.0])
@pytest.mark.parametrize("shift", [0.0, 150.0])
def test_whole_turns_cover_the_joint_range(upper: float, shift: float) -> None:
    limits = np.radians(np.full(6, shift - upper)), np.radians(np.full(6, shift + upper))
    origin, windings = choose_angle_origin(*limits)
    assert len(windings) <= len(list_whole_turns(*limits))
    assert not windings[0].any()
    if upper in (185.0, 350.0):
        assert len(windings) == 2**6
    rng = np.random.default_rng(0)
    for message in (limits[0][0], limits[1][0] - 1e-9, *rng.uniform(limits[0][0], limits[1][0], 50)):
        q = np.full((1, 6), float(wrap_angle(message)))
        shift_angles(origin, q)
        assert ((q >= origin - 1e-12) & (q <= origin + 2 * np.pi)).all()
        if abs(message) < 3 * np.pi:  # range of one turn in either direction
            assert np.abs(q + windings - message).max(axis=1).min() < 1e-9


def test_number_of_threads_follows_cores_and_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in parallel_map.THREAD_LIMIT_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    free = count_threads()
    assert free >= 1
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert count_threads() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert count_threads() == free
    monkeypatch.setenv("NUMBA_NUM_THREADS", "4096")
    assert count_threads() == free


def test_results_keep_the_order_of_the_parts_and_errors_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    for n in (1, 3):
        monkeypatch.setattr(parallel_map, "count_threads", lambda n=n: n)
        assert map_in_threads(lambda x: x * x, range(20)) == [x * x for x in range(20)]
        assert map_in_threads(abs, []) == []
        with pytest.raises(ZeroDivisionError):
            map_in_threads(lambda x: 1 // x, range(3))


def test_two_tasks_return_both_results_in_the_same_context(monkeypatch: pytest.MonkeyPatch) -> None:
    output: ContextVar[str] = ContextVar("said", default="")
    output.set("here")
    empty: dict[str, int] = {}
    for n in (1, 3):
        monkeypatch.setattr(parallel_map, "count_threads", lambda n=n: n)
        assert run_two_in_threads(lambda: 1, output.get) == (1, "here")
        with pytest.raises(ZeroDivisionError):
            run_two_in_threads(lambda: 1 // 0, lambda: empty["second"])
        with pytest.raises(KeyError, match="second"):
            run_two_in_threads(lambda: 1, lambda: empty["second"])


def test_offset_shifts_the_whole_rotation_grid_of_its_station(setup: PlanningSetup) -> None:
    path = build_leaning_cut(10)
    free = enumerate_candidates(path, setup.arm, replace(OPTIONS, fixed=()))
    fixed = enumerate_candidates(path, setup.arm, OPTIONS)
    assert fixed.nudge is not None
    moved = np.flatnonzero(fixed.nudge)
    assert len(moved) == 1
    same = np.setdiff1d(np.arange(len(path.stations)), moved)
    assert free.q[same].tobytes() == fixed.q[same].tobytes()
    assert not np.array_equal(free.q[moved], fixed.q[moved], equal_nan=True)


def test_unusable_branches_are_left_out_with_their_reasons(setup: PlanningSetup) -> None:
    path, arm = build_leaning_cut(200), setup.arm
    every = enumerate_candidates(path, arm, OPTIONS, every_branch=True)
    c = enumerate_candidates(path, arm, OPTIONS)
    assert len(c.branch) < len(every.branch) == arm.solver.branches
    assert c.dropped is not None
    np.testing.assert_array_equal(c.branch, np.flatnonzero(every.feasible.any(axis=(0, 1, 3))))
    np.testing.assert_array_equal(c.q, every.q[:, :, c.branch])
    np.testing.assert_array_equal(c.feasible, every.feasible[:, :, c.branch])
    np.testing.assert_array_equal(c.reason_of_rotation(), every.reason_of_rotation())
    np.testing.assert_array_equal(c.is_out_of_reach(), every.is_out_of_reach())
    for s in (0, len(c.q) - 1):
        np.testing.assert_array_equal(np.sort(c.reasons_at(s)), np.sort(every.reason[s]))
    again = c.expand_branches(every.branch)
    np.testing.assert_array_equal(again.feasible, every.feasible)
    np.testing.assert_array_equal(again.reason_of_rotation(), every.reason_of_rotation())


def test_branch_usable_at_few_stations_has_joints_everywhere(
    setup: PlanningSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A block of stations without this branch is solved again."""
    path, size = build_leaning_cut(200), 7
    monkeypatch.setattr(module, "CHUNK", 24 * size)
    every = enumerate_candidates(path, setup.arm, OPTIONS, every_branch=True)
    usable = every.feasible.any(axis=(1, 3))  # (S, A)
    by_block = np.array([usable[k : k + size].any(axis=0) for k in range(0, len(usable), size)])
    assert (by_block.any(axis=0) & ~by_block.all(axis=0)).any()
    c = enumerate_candidates(path, setup.arm, OPTIONS)
    np.testing.assert_array_equal(c.q, every.q[:, :, c.branch])
    np.testing.assert_array_equal(c.reason, every.reason[:, :, c.branch])


def test_station_is_solved_again_with_every_branch(setup: PlanningSetup) -> None:
    path, arm = build_leaning_cut(30), setup.arm
    every = enumerate_candidates(path, arm, PlanOptions(), every_branch=True)
    q, reason = solve_station(path, arm, every, 7)
    np.testing.assert_allclose(q, every.q[7], atol=1e-12)
    np.testing.assert_array_equal(reason == InfeasibilityReason.LIMIT, every.reason[7] == InfeasibilityReason.LIMIT)

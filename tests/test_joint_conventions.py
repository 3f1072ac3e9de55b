"""Joint angle conventions of controllers that differ from the URDF are identified once, without false positives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_hidden_effects import CELLS, HiddenEffects, arm, load_tests, plan_load_tests, solve_equilibrium

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.robot_program import JointMap
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality.joint_conventions import correct_joint_convention
from machopt.numerics.array_types import Array

CELL = CELLS / "kr240_drilling"


def poses() -> Recording:
    rng = np.random.default_rng(7)
    a = arm(CELL.name)
    plan = plan_load_tests(a, rng, poses=40, sessions=1, loads=1, directions=1, force=1e-6)
    rows = np.flatnonzero(~plan.loaded)
    zero = np.radians([0.0, 0.05, -0.03, 0.02, 0.0, 0.0])
    p: Array = solve_equilibrium(a, HiddenEffects(a.nominal * 1.1, zero=zero), plan)[0][rows]
    N = len(rows)
    return Recording(
        kind="absolute",
        source="simulated",
        q=plan.q[rows],
        pose=plan.pose[rows],
        cycle=np.arange(N, dtype=np.int64),
        session=np.zeros(N, np.int64),
        line=np.arange(2, N + 2),
        position=p + 2e-5 * rng.standard_normal((N, 3)),
        registration="fit",
        stated_labels=frozenset({"pose"}),
    )


def change(joint: int, sign: float, degrees: float) -> Callable[[Array], Array]:
    def recorded(q: Array) -> Array:
        out = q.copy()
        out[:, joint - 1] = sign * (q[:, joint - 1] - np.radians(degrees))
        return out

    return recorded


def pendant(sign: float) -> Callable[[Array], Array]:
    def recorded(q: Array) -> Array:
        out = q.copy()
        out[:, 2] = q[:, 2] - sign * q[:, 1]
        return out

    return recorded


@pytest.mark.parametrize(
    ("recorded", "column"),
    [
        (pendant(1.0), "column:q3_deg"),
        (pendant(-1.0), "column:q3_deg"),
        (change(2, 1.0, 90.0), "column:q2_deg"),
        (change(3, 1.0, -90.0), "column:q3_deg"),
        (change(4, 1.0, 180.0), "column:q4_deg"),
        (change(5, -1.0, 0.0), "column:q5_deg"),
    ],
)
def test_convention_is_identified(recorded: Callable[[Array], Array], column: str) -> None:
    cell, clean = load_cell(CELL), poses()
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    other = replace(clean, q=recorded(clean.q))
    read, (finding,) = correct_joint_convention(other, robot, T)
    assert finding.location == column
    np.testing.assert_allclose(read.q, clean.q, atol=1e-12)
    assert correct_joint_convention(other, robot, T, ("columns",)) == (other, [])


def record_both(*changes: Callable[[Array], Array]) -> Callable[[Array], Array]:
    def recorded(q: Array) -> Array:
        for one in changes:
            q = one(q)
        return q

    return recorded


@pytest.mark.parametrize(
    "recorded",
    [
        record_both(change(2, 1.0, -90.0), change(4, -1.0, 0.0)),
        record_both(pendant(-1.0), change(5, 1.0, 180.0), change(2, -1.0, 90.0)),
        change(6, 1.0, -90.0),
    ],
)
def test_conventions_of_several_joints_are_identified_together(recorded: Callable[[Array], Array]) -> None:
    cell, clean = load_cell(CELL), poses()
    read, (finding,) = correct_joint_convention(
        replace(clean, q=recorded(clean.q)), load_robot(cell), cell.tool.T_flange_tcp
    )
    assert finding.effect == "columns"
    np.testing.assert_allclose(np.sin(read.q - clean.q), 0.0, atol=1e-9)


@pytest.mark.parametrize("recorded", [pendant(-1.0), change(1, 1.0, -90.0), change(4, 1.0, 90.0)])
def test_load_tests_identify_a_convention(recorded: Callable[[Array], Array]) -> None:
    cell, a, rng = load_cell(CELL), arm(CELL.name), np.random.default_rng(21)
    plan = plan_load_tests(a, rng, poses=10, loads=2, sessions=1)
    clean = load_tests(a, HiddenEffects(a.nominal * 1.2), plan, rng)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    assert correct_joint_convention(clean, robot, T) == (clean, [])
    read, (finding,) = correct_joint_convention(replace(clean, q=recorded(clean.q)), robot, T)
    assert finding.location.startswith("column:q")
    np.testing.assert_allclose(read.q, clean.q, atol=1e-9)


def test_joint_map_of_the_cell_is_tried_first() -> None:
    coupling = np.zeros((6, 6))
    coupling[2, 1] = 1.0
    stated = JointMap(
        sign=np.array([1.0, -1, 1, -1, 1, -1]),
        offset_deg=np.array([0.0, 37.0, -11.0, 0.0, 5.0, 0.0]),
        coupling=coupling,
    )
    cell, clean = load_cell(CELL), poses()
    other = replace(clean, q=np.radians(stated.compute_axes_deg(clean.q)))
    read, (finding,) = correct_joint_convention(other, load_robot(cell), cell.tool.T_flange_tcp, (), stated)
    assert "joint_map" in finding.note
    np.testing.assert_allclose(read.q, clean.q, atol=1e-9)
    as_urdf = correct_joint_convention(clean, load_robot(cell), cell.tool.T_flange_tcp, (), stated)
    assert as_urdf == (clean, [])


def test_offsets_and_soft_springs_are_no_convention() -> None:
    """Small zero offsets and soft springs are not reported as a convention."""
    cell, clean = load_cell(CELL), poses()
    assert correct_joint_convention(clean, load_robot(cell), cell.tool.T_flange_tcp) == (clean, [])

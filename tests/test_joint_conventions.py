"""Joint angles that a pendant counts otherwise than the URDF: understood, named once, and never invented."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_hidden_effects import CELLS, HiddenEffects, arm, plan_load_tests, solve_equilibrium

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import load_robot
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
def test_a_convention_is_understood(recorded: Callable[[Array], Array], column: str) -> None:
    cell, clean = load_cell(CELL), poses()
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    other = replace(clean, q=recorded(clean.q))
    read, (finding,) = correct_joint_convention(other, robot, T)
    assert finding.location == column
    np.testing.assert_allclose(read.q, clean.q, atol=1e-12)
    assert correct_joint_convention(other, robot, T, ("columns",)) == (other, [])


def test_nothing_is_invented() -> None:
    """Small zero offsets and soft springs are no convention."""
    cell, clean = load_cell(CELL), poses()
    assert correct_joint_convention(clean, load_robot(cell), cell.tool.T_flange_tcp) == (clean, [])

"""Half width of the gears' loops: how far a deflection depends on the side from which its load was reached.

Readings of one load cycle under the same load, once while it rises and once while it falls, differ by the loops of the
gears. Half of that difference is explained by an angle h of each joint towards its torque,

    (δ_falling − δ_rising) / 2 = Σ_j J_j h_j sign(τ_j),   h_j ≥ 0.

A job may reach its load from either side, and the state without load too. Each loop that the readings show is
therefore added to the discrepancy as an angle of zero mean in the direction of the load's torque, once for either
state: together √2 of the half width. The weight does not count: it holds a gear with play on one flank, but a loop is
passed at any torque.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from machopt.data_types.discrepancy_names import format_joint_name
from machopt.data_types.stiffness import ModelDiscrepancy
from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.numerics.array_types import Array, Ints
from machopt.stiffness.discrepancy_columns import LOOP_COLUMN

STATES = 2  # loaded and unloaded, each reached from either side


def estimate_loop_half_widths(tests: LoadTestExperiment, robust: Array) -> Array:
    """Estimate the half width of each gear's loop from rising and falling loads.

    Args:
        tests: Load tests in base axes, in the order of measurement within each cycle.
        robust: (N, D) outlier weights in [0, 1].

    Returns:
        (6,) rad; zero for a joint whose loop the readings do not show.
    """
    rising, falling = find_branch_pairs(tests)
    good: NDArray[np.bool_] = np.min(robust[:, :3], axis=1) > thresholds.SHARES.majority
    pairs = good[rising] & good[falling]
    rising, falling = rising[pairs], falling[pairs]
    half = np.zeros(tests.joint_count)
    if len(rising) < thresholds.COUNTS.min_degrees_of_freedom:
        return half
    y = 0.5 * (tests.measured[falling, :3] - tests.measured[rising, :3]).reshape(-1)
    J = tests.state.J[rising]
    torque = np.einsum("nci,nc->ni", J, tests.wrench[rising])
    weak = thresholds.SHARES.small * np.abs(torque).max(axis=0)
    A = (J[:, :3] * np.tanh(torque / np.maximum(weak, 1e-9))[:, None, :]).reshape(len(y), tests.joint_count)
    x, _ = nnls(A, y)
    left = (y - A @ x).reshape(-1, 3)
    meat = np.einsum("nci,nc->ni", A.reshape(-1, 3, tests.joint_count), left)
    inverse = np.linalg.pinv(A.T @ A)
    sigma = np.sqrt(np.diag(inverse @ (meat.T @ meat) @ inverse))
    shown = x > thresholds.LEVELS.three_sigma * sigma
    half[shown] = x[shown] + sigma[shown]
    return half


def find_branch_pairs(tests: LoadTestExperiment) -> tuple[Ints, Ints]:
    """Return readings of the same load and cycle: the rising one and the falling one of each pair.

    Args:
        tests: Load tests in base axes, in the order of measurement within each cycle.
    """
    force = np.linalg.norm(tests.wrench[:, :3], axis=1) + np.linalg.norm(tests.wrench[:, 3:], axis=1)
    pairs: list[tuple[int, int]] = []
    for cycle in np.unique(tests.cycle):
        rows = np.flatnonzero(tests.cycle == cycle)
        size = force[rows]
        if len(rows) < 2 or not size.any():
            continue
        top = int(np.argmax(size))
        same = thresholds.SHARES.load_tolerance * size[top]
        for n in range(top + 1, len(rows)):
            apart = np.linalg.norm(tests.wrench[rows[:top]] - tests.wrench[rows[n]], axis=1)
            if top and apart.min() < same:
                pairs.append((int(rows[int(np.argmin(apart))]), int(rows[n])))
    found = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def add_arrival_side(doubt: ModelDiscrepancy, half: Array) -> ModelDiscrepancy:
    """Add the loops of the gears to a discrepancy, so that intervals hold for any side of arrival and departure.

    Args:
        doubt: Model discrepancy.
        half: (6,) half widths, rad.
    """
    names = [format_joint_name(LOOP_COLUMN, j + 1) for j in np.flatnonzero(half > 0).tolist()]
    if not names:
        return doubt
    parts = (*doubt.parts, *(n for n in names if n not in doubt.parts))
    more = len(parts) - len(doubt.parts)
    modes = np.pad(doubt.modes, ((0, len(names)), (0, more)))
    for row, (name, size) in enumerate(zip(names, half[half > 0], strict=True), start=len(doubt.modes)):
        modes[row, parts.index(name)] = STATES**0.5 * size
    return replace(doubt, parts=parts, shift=np.pad(doubt.shift, (0, more)), modes=modes)

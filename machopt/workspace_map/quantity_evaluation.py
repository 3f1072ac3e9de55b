"""Evaluation of the map quantities over many postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.stiffness.joint_stiffness import compute_joint_stiffness
from machopt.workspace_map.quantities import MapQuantity, MapSettings, list_quantities


@dataclass(frozen=True)
class QuantityValues:
    """All quantities at M postures, NaN where there is no posture."""

    fields: tuple[MapQuantity, ...]
    value: dict[str, Array]  # key → (M,) SI
    T_base_tcp: Array  # (M, 4, 4)
    softest: Array | None  # (M, 3) unit, most compliant direction in the map's frame, +z (else +y, +x) half
    is_in_grid: NDArray[np.bool_] | None  # (M,) False: outside the stiffness grid; None where there is no grid


def evaluate_quantities(setting: MapSettings, q: Array, at_once: int = 16_384) -> QuantityValues:
    """Return all quantities at postures; rows of NaN stay NaN.

    Args:
        setting: constant inputs of the quantities.
        q: (M, 6) rad.
        at_once: postures per block.
    """
    fields, M = list_quantities(setting), len(q)
    value = {field.key: np.full(M, np.nan) for field in fields}
    T = np.full((M, 4, 4), np.nan)
    softest = None if setting.elasticity is None else np.full((M, 3), np.nan)
    there = np.flatnonzero(np.isfinite(q).all(axis=1))
    for a in range(0, len(there), at_once):
        rows = there[a : a + at_once]
        at = setting.evaluate_states(q[rows])
        for field in fields:
            number = field.function(at)
            value[field.key][rows] = np.where(np.isfinite(number), number, np.nan)
        T[rows] = at.state.T_base_tool
        if softest is not None:
            softest[rows] = _orient_upwards(
                np.linalg.eigh(at.translational_compliance)[1][:, :, 2] @ setting.R_base_frame
            )
    in_grid = None
    if setting.elasticity is not None and setting.elasticity.stiffness.grid is not None:
        in_grid = np.zeros(M, bool)
        in_grid[there] = compute_joint_stiffness(setting.elasticity.stiffness, T[there, :3, 3]).is_in_grid
    return QuantityValues(fields, value, T, softest, in_grid)


def _orient_upwards(direction: Array) -> Array:
    """Return the orientation of a direction with positive z (else y, else x), as its opposite is equivalent."""
    out = direction.copy()
    undecided = np.ones(len(out), bool)
    for c in (2, 1, 0):
        turn = undecided & (out[:, c] < -1e-9)
        out[turn] *= -1
        undecided &= np.abs(out[:, c]) <= 1e-9
    return out

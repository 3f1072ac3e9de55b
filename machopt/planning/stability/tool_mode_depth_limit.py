"""Largest stable depth of cut of the modes of tool and spindle, which turn with the tool about its axis."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.numerics.array_types import Array
from machopt.process.stability.depth_limit import DelayLaw, compute_depth_limit
from machopt.process.stability.structural_modes import build_tool_modes


def compute_tool_limit(
    cutter: CutterGeometry | None, H: Array, period: Array, path_axes: Array, tool_axes: Array
) -> Array | None:
    """Return (M,) m the limit of the modes of tool and spindle; None where none are stated.

    Args:
        cutter: The cutter with its modes.
        H: (M, 3, 2) or (3, 2) Pa, directional matrix.
        period: (M,) s, time between two teeth.
        path_axes: (M, 3, 3) travel, normal and axis as rows, in base_link.
        tool_axes: (M, 3, 3) TCP axes as columns, in base_link.
    """
    if cutter is None or not cutter.modes:
        return None
    given = np.array([mode.direction for mode in cutter.modes])
    tool = build_tool_modes(
        [mode.frequency for mode in cutter.modes],
        [mode.damping for mode in cutter.modes],
        [mode.stiffness for mode in cutter.modes],
        np.einsum("mij,mjk,nk->mni", path_axes, tool_axes, given),
    )
    return compute_depth_limit(tool, H, period, DelayLaw.ZEROTH_ORDER).depth

"""Properties of cell.yaml that forces and tolerances need: cutter, inertia, stiffness and pose of the part, …"""

from __future__ import annotations

from collections.abc import Callable
from math import nan, radians

import numpy as np

from machopt.cell.cell_schema import AccuracyKeys, CutterKeys, ToolModeKeys
from machopt.data_types.cell import CutterGeometry, ToolMode
from machopt.data_types.process import ArmAccuracy
from machopt.errors import InputError
from machopt.numerics.array_types import Array

_AXES = {"tool_x": (1.0, 0.0, 0.0), "tool_y": (0.0, 1.0, 0.0), "tool_z": (0.0, 0.0, 1.0)}
_NEGATIVE = 1e-9  # relative to the largest eigenvalue; round-off


def build_cutter(keys: CutterKeys) -> CutterGeometry:
    """Return the cutter in SI units.

    Args:
        keys: The keys ``cutter`` of a tool, mm and degrees.
    """
    return CutterGeometry(
        keys.diameter_mm / 1e3,
        keys.length_mm / 1e3,
        keys.corner_radius / 1e3,
        teeth=keys.teeth,
        helix=None if keys.helix_deg is None else radians(keys.helix_deg),
        point_angle=None if keys.point_deg is None else radians(keys.point_deg),
        web=None if keys.web_mm is None else keys.web_mm / 1e3,
        runout=keys.runout_mm / 1e3,
        side_stiffness=None if keys.side_stiffness_N_mm is None else keys.side_stiffness_N_mm * 1e3,
        modes=tuple(_build_mode(mode) for mode in keys.modes),
    )


def _build_mode(keys: ToolModeKeys) -> ToolMode:
    given = np.array(_AXES[keys.direction] if isinstance(keys.direction, str) else keys.direction, float)
    x, y, z = (given / max(float(np.linalg.norm(given)), 1e-300)).tolist()
    return ToolMode(frequency=keys.f_Hz, damping=keys.zeta, stiffness=keys.k_N_um * 1e6, direction=(x, y, z))


def build_accuracy(keys: AccuracyKeys) -> ArmAccuracy:
    """Return the accuracy of the arm in SI units; NaN where it is not stated.

    Args:
        keys: The keys ``accuracy`` of a cell.
    """
    return ArmAccuracy(
        absolute=nan if keys.absolute_mm is None else keys.absolute_mm / 1e3,
        absolute_angle=nan if keys.absolute_deg is None else radians(keys.absolute_deg),
        repeatability=nan if keys.repeatability_mm is None else keys.repeatability_mm / 1e3,
        lost_motion=tuple(radians(v / 60.0) for v in keys.lost_motion_arcmin or ()),
        includes_lost_motion=keys.includes_lost_motion,
        source=keys.source,
    )


def parse_inertia(rows: list[list[float]], fail: Callable[[str], InputError]) -> Array:
    """Return the (3, 3) inertia in kg·m².

    Args:
        rows: Rows of the matrix.
        fail: Builds an error at the key.

    Raises:
        InputError: not symmetric, or not the inertia of a body.
    """
    matrix = np.array(rows, float)
    if np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
        raise fail("is not symmetric")
    moments = np.linalg.eigvalsh(matrix)
    if moments[0] < 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-6):
        raise fail(
            f"no body has the principal moments {', '.join(f'{m:.4g}' for m in moments)} kg·m²; expected moments above "
            "zero, none larger than the sum of the other two"
        )
    matrix.setflags(write=False)
    return matrix


def parse_workpiece_stiffness(value: float | list[float] | None, fail: Callable[[str], InputError]) -> Array | None:
    """Return the (3,) stiffness of the part along the CAM axes in N/m; None where it is not stated.

    Args:
        value: N/mm, one number or three.
        fail: Builds an error at the key.

    Raises:
        InputError: a stiffness that is not above zero.
    """
    if value is None:
        return None
    stiffness = np.broadcast_to(np.array(value, float), (3,)) * 1e3
    if stiffness.min() <= 0:
        raise fail(f"found {value}; expected N/mm above 0")
    return stiffness


def parse_pose_covariance(rows: list[list[float]] | None, fail: Callable[[str], InputError]) -> Array | None:
    """Return the (6, 6) covariance of the part's pose in m and rad; None where it is not stated.

    Args:
        rows: Rows in mm and mrad.
        fail: Builds an error at the key.

    Raises:
        InputError: not symmetric, or with a negative eigenvalue.
    """
    if rows is None:
        return None
    matrix = np.array(rows, float) * 1e-6  # mm and mrad are both 1e-3 of the SI unit
    if np.abs(matrix - matrix.T).max() > 1e-6 * np.abs(matrix).max():
        raise fail("is not symmetric")
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -_NEGATIVE * np.abs(matrix).max():
        raise fail(f"has the negative eigenvalue {1e6 * least:g}; a covariance has none")
    matrix.setflags(write=False)
    return matrix

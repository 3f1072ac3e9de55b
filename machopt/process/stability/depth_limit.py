"""Largest stable depth of cut: coupled modes with regeneration, and the screen of one mode at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, Ints, make_arrays_read_only
from machopt.process.stability.depth_limit_kernels import DELAY_STEP, find_depth_limits
from machopt.process.stability.structural_modes import StructuralModes

LARGEST_DEPTH = 1.0  # m; limits above it count as none


class DelayLaw(Enum):
    """How the delay enters: each value says which of second order, exact delay and period doubling are searched."""

    COUPLED = (True, True, True)  # the smallest of all: for a verdict on modes of the arm
    SECOND_ORDER = (True, False, False)  # chatter below ωT = 1 only
    ZEROTH_ORDER = (False, True, False)  # zeroth-order solution: for modes of the tool and stability lobes


@dataclass(frozen=True)
class DepthLimit:
    """Limits of P points."""

    depth: Array  # (P,) m; inf: stable up to the largest depth; NaN: the damping of a mode is unknown
    omega: Array  # (P,) rad/s, chatter frequency at the limit; NaN without limit
    mode: Ints  # (P,) index of the governing mode, from 0; −1 without limit

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


def compute_tooth_period(spindle_rpm: Array | float, teeth: int) -> Array:
    """Return the time between two teeth, s.

    Args:
        spindle_rpm: revolutions per minute, > 0.
        teeth: number of teeth.

    Raises:
        CuttingInputError: a spindle speed or number of teeth that is not positive.
    """
    speed = np.asarray(spindle_rpm, float)
    if not ((speed > 0.0) & np.isfinite(speed)).all():
        raise CuttingInputError("the spindle speed must be larger than 0", key="spindle_rpm")
    if teeth < 1:
        raise CuttingInputError(f"{teeth} teeth; 1 or more are expected", key="teeth")
    return np.asarray(60.0 / (speed * teeth))


def compute_depth_limit(
    modes: StructuralModes,
    H: Array,
    tooth_period: Array | float,
    law: DelayLaw = DelayLaw.COUPLED,
    largest: float = LARGEST_DEPTH,
) -> DepthLimit:
    """Return the largest axial depth of cut below which no chatter starts.

    All modes enter together, so that those of high frequency count with their static share. With the default law, the
    limit is that of the delay to second order where chatter lies below ωT = 1: there it is 0 to 15 % below the full
    solution on the reference sets, and 0 to 5 % below ωT = 0.5. Above, zeroth-order solution and period doubling take
    its place: an estimate, which may exceed the full solution by some percent.

    Args:
        modes: P points with n modes.
        H: (P, 3, 2) or (3, 2) Pa, directional matrix.
        tooth_period: (P,) or one value, s.
        law: laws of the delay that are searched.
        largest: m, depth from which a limit does not matter; a small one saves time.

    Raises:
        CuttingInputError: a tooth period or largest depth that is not positive.
    """
    count = len(modes.omega)
    T = np.array(np.broadcast_to(np.asarray(tooth_period, float), count))
    if not ((T > 0.0).all() and np.isfinite(T).all()):
        raise CuttingInputError("the tooth period must be larger than 0", key="spindle_rpm")
    if not 0.0 < largest < math.inf:
        raise CuttingInputError("the largest depth must be larger than 0 and finite", key="ap_mm")
    b = np.ascontiguousarray(modes.shape[..., :2])
    c = np.ascontiguousarray(modes.shape @ H)
    unknown = np.asarray((np.isnan(modes.zeta) & (modes.omega > 0.0)).any(axis=1))
    omega = np.where(unknown[:, None], 0.0, modes.omega)
    limit, frequency, mode = np.empty(count), np.empty(count), np.empty(count, np.int64)
    zeta = np.array(modes.zeta)  # a copy that may be written: the kernel is compiled for such arrays only
    turns = float(T.max(initial=0.0)) * float(omega.max(initial=0.0))
    points = math.ceil(max(2.0 * turns, 4.0 * math.pi) / DELAY_STEP)
    find_depth_limits(T, law.value, largest, omega, zeta, b, c, limit, frequency, mode, points)
    limit[unknown] = np.nan
    return DepthLimit(limit, frequency, mode)


def compute_single_mode_limits(modes: StructuralModes, H: Array, tooth_period: Array | float) -> Array:
    """Return the limit of each mode alone with the delay to first order, 2 ζ ω / (T uᵀ H u), (P, n) m; inf without.

    It labels modes. It is neither safe nor sharp where modes are close, and holds for ωT below about 0.5 only.

    Args:
        modes: P points with n modes.
        H: (P, 3, 2) or (3, 2) Pa, directional matrix.
        tooth_period: (P,) or one value, s.
    """
    gain = np.sum((modes.shape @ H) * modes.shape[..., :2], axis=-1)
    T = np.broadcast_to(np.asarray(tooth_period, float), len(modes.omega))[:, None]
    safe = np.where(gain > 0.0, gain, 1.0)
    return np.where(gain > 0.0, 2.0 * modes.zeta * modes.omega / (T * safe), np.inf)


def compute_feedback_coefficients(modes: StructuralModes, H: Array, tooth_period: float, depth: float) -> Array:
    """Return the first-order loop gain of each mode, |1 − exp(−iωT)| |uᵀ H u| a / (2 ζ k), (P, n).

    Args:
        modes: P points with n modes; k = ω² in mass-normalised shape.
        H: (P, 3, 2) or (3, 2) Pa, directional matrix.
        tooth_period: s.
        depth: m, axial depth of cut.
    """
    gain = np.abs(np.sum((modes.shape @ H) * modes.shape[..., :2], axis=-1))
    delay = 2.0 * np.abs(np.sin(0.5 * modes.omega * tooth_period))
    return np.asarray(delay * gain * depth / (2.0 * modes.zeta * modes.omega**2))

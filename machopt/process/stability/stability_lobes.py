"""Stability lobes of the zeroth-order solution: limit over spindle speed, and its absolute minimum.

Source: Altıntaş & Budak, CIRP Annals 44 (1995) 357. It holds for modes of the tool and immersions above about 0.3 of
the diameter; at small immersions it lacks the lobes of period doubling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.process.stability.depth_limit import (
    LARGEST_DEPTH,
    DelayLaw,
    DepthLimit,
    compute_depth_limit,
    compute_tooth_period,
)
from machopt.process.stability.structural_modes import StructuralModes

_SCAN = 4000  # frequencies of the scan for the minimum, before it is refined
_REACH = 3.0  # times the highest natural frequency


@dataclass(frozen=True)
class LobeMinimum:
    """Depth that is stable at every spindle speed."""

    depth: float  # m; inf where no depth is unstable
    omega: float  # rad/s, chatter frequency there


def compute_stability_lobes(
    modes: StructuralModes, H: Array, spindle_rpm: Array, teeth: int, largest: float = LARGEST_DEPTH
) -> DepthLimit:
    """Return the limit at S spindle speeds.

    Args:
        modes: one point.
        H: (3, 2) Pa, directional matrix.
        spindle_rpm: (S,) revolutions per minute.
        teeth: number of teeth.
        largest: m, depth from which a limit does not matter.

    Raises:
        CuttingInputError: a spindle speed that is not positive.
    """
    T = compute_tooth_period(spindle_rpm, teeth)
    rows = (len(T), *modes.omega.shape[1:])
    many = StructuralModes(
        np.broadcast_to(modes.omega[0], rows).copy(),
        np.broadcast_to(modes.zeta[0], rows).copy(),
        np.broadcast_to(modes.shape[0], (*rows, 3)).copy(),
    )
    return compute_depth_limit(many, H, T, DelayLaw.ZEROTH_ORDER, largest)


def find_lobe_minimum(modes: StructuralModes, H: Array) -> LobeMinimum:
    """Return the least limit over all spindle speeds, 1 / (2 Re µ) at the largest Re µ of the oriented response.

    Args:
        modes: one point.
        H: (3, 2) Pa, directional matrix.
    """
    high = float(modes.omega[0].max()) * _REACH
    near = [
        w * (1.0 + z * np.tan(np.linspace(-1.5, 1.5, 400))) for w, z in zip(modes.omega[0], modes.zeta[0], strict=True)
    ]
    w = np.concatenate([np.linspace(high / _SCAN, high, _SCAN), *near])
    w = np.sort(w[w > 0.0])
    for _ in range(4):  # each pass divides the interval about the maximum
        real = _compute_largest_real_part(modes, H, w)
        k = int(np.argmax(real))
        best, at = float(real[k]), float(w[k])
        w = np.linspace(w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)], 201)
    return LobeMinimum(0.5 / best, at) if best > 0.0 else LobeMinimum(np.inf, np.nan)


def _compute_largest_real_part(modes: StructuralModes, H: Array, w: Array) -> Array:
    omega, zeta, u = modes.omega[0], modes.zeta[0], modes.shape[0]
    inverse = 1.0 / (omega**2 - w[:, None] ** 2 + 2j * zeta * omega * w[:, None])
    R = np.einsum("wn,ni,nj->wij", inverse, u[:, :2], u @ H)
    return np.asarray(np.linalg.eigvals(R).real.max(axis=-1))

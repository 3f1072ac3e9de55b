"""Tooth and spindle frequencies that meet a mode: forced vibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array, Bools
from machopt.process.stability.structural_modes import StructuralModes

CRITICAL_AMPLIFICATION = 2.5  # below it a mode counts as well damped and needs no margin (API 617, 7th ed., 2.6.2.10)


@dataclass(frozen=True, kw_only=True)
class ResonanceMeeting:
    """One excitation near one mode at one point."""

    point: int
    mode: int  # from 0
    excitation: str  # "spindle" or "tooth"
    excitation_hz: float
    mode_hz: float
    amplification: float  # dynamic over static displacement of the mode; inf: undamped and equal


def find_resonances(modes: StructuralModes, spindle_rpm: float, teeth: int) -> list[ResonanceMeeting]:
    """Return where the spindle's or the teeth's frequency lies within the separation margin of a mode.

    With the amplification Q = 1 / (2 ζ) the margin is 17 (1 − 1 / (Q − 1.5)) % where the excitation lies above the mode
    and 10 % more where it lies below; none for Q < 2.5. Unknown damping: the full margin.

    Args:
        modes: P points with n modes.
        spindle_rpm: revolutions per minute.
        teeth: number of teeth.

    Source: API 617, 7th ed. (2002), 2.6.2.10, for critical speeds of rotors.
    """
    found = []
    f, zeta = modes.frequency, modes.zeta
    for name, excitation in (("spindle", spindle_rpm / 60.0), ("tooth", spindle_rpm * teeth / 60.0)):
        ratio = excitation / np.where(f > 0.0, f, np.nan)
        inside = _is_within_margin(ratio, zeta) & (f > 0.0)
        gain = _compute_amplification(ratio, zeta)
        for p, m in zip(*np.nonzero(inside), strict=True):
            found.append(
                ResonanceMeeting(
                    point=int(p),
                    mode=int(m),
                    excitation=name,
                    excitation_hz=excitation,
                    mode_hz=float(f[p, m]),
                    amplification=float(gain[p, m]),
                )
            )
    return sorted(found, key=lambda meeting: (meeting.point, meeting.mode, meeting.excitation_hz))


def _is_within_margin(ratio: Array, zeta: Array) -> Bools:
    Q = np.where(np.isnan(zeta), np.inf, 0.5 / np.where(np.isnan(zeta), 1.0, zeta))
    critical = Q >= CRITICAL_AMPLIFICATION
    margin = 0.17 * (1.0 - 1.0 / np.where(critical, Q - 1.5, 1.0))
    above, below = ratio - 1.0, 1.0 - ratio
    return np.asarray(critical & (((above >= 0.0) & (above <= margin)) | ((below > 0.0) & (below <= margin + 0.10))))


def _compute_amplification(ratio: Array, zeta: Array) -> Array:
    damping = 2.0 * np.where(np.isnan(zeta), 0.0, zeta) * ratio
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.hypot(1.0 - ratio**2, damping))

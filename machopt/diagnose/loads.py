"""What the force sensor is good for: components that hold nothing but its noise, loads that are the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.domain.recording import Recording, StandardUncertainty

COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def heard(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with load components that stay within their stated uncertainty at zero.

    A column of noise is a regressor as good as any by chance. All forces are never taken away.

    Args:
        recording: kind deflection.

    Returns:
        the recording (itself where nothing changes), what was done in words.
    """
    if recording.wrench is None:
        return recording, []
    stated = [recording.uncertainty.force] * 3 + [recording.uncertainty.moment] * 3
    quiet = []
    for k, sigma in enumerate(stated):
        w = np.abs(recording.wrench[:, k])
        if not sigma or not w.any():
            continue
        loud = w > calibrated.NOISE.silent_peak * sigma
        rest = w[~loud]
        if loud.mean() <= calibrated.NOISE.silent_share and np.mean(rest**2) <= (calibrated.NOISE.silent * sigma) ** 2:
            quiet.append(k)
    if not quiet or set(quiet) >= {0, 1, 2}:
        return recording, []
    wrench = recording.wrench.copy()
    wrench[:, quiet] = 0.0
    names = ", ".join(COLUMNS[k] for k in quiet)
    return replace(recording, wrench=wrench), [f"{names}: nothing beyond the stated uncertainty; counted as zero"]


def same(largest: Array, share: float, stated: StandardUncertainty) -> Array:
    """(6,) N, N·m: how far each component of two readings may be apart for the same load.

    Args:
        largest: (2,) largest force and moment there, N and N·m.
        share: of them.
        stated: 1 sigma; what it cannot tell apart is the same.
    """
    sigma = np.array([stated.force or 0.0, stated.moment or 0.0])
    return np.repeat(np.maximum(np.maximum(share * largest, calibrated.NOISE.same * sigma), 1e-9 * share), 3)

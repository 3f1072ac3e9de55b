"""What the force sensor is good for: components that hold nothing but its noise, loads that are the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.measurement.diagnosis import thresholds
from machopt.numerics.array_types import Array

COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def discard_noise_components(recording: Recording) -> tuple[Recording, list[str]]:
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
    for k, told in enumerate(stated):
        w = np.abs(recording.wrench[:, k])
        if not w.any():
            continue
        sigma = told or _estimate_component_scatter(recording, k)
        if not sigma:
            continue
        loud = w > thresholds.NOISE.silent_peak * sigma
        rest = w[~loud]
        if loud.mean() <= thresholds.NOISE.silent_share and np.mean(rest**2) <= (thresholds.NOISE.silent * sigma) ** 2:
            quiet.append(k)
    if not quiet or set(quiet) >= {0, 1, 2}:
        return recording, []
    wrench = recording.wrench.copy()
    wrench[:, quiet] = 0.0
    names = ", ".join(COLUMNS[k] for k in quiet)
    return replace(recording, wrench=wrench), [f"{names}: nothing beyond its uncertainty; counted as zero"]


def _estimate_component_scatter(recording: Recording, k: int) -> float:
    """1 sigma of a small component by its readings in one pose while the other forces are alike; 0: not to be told.

    A load that the robot bears comes back with its repeats: of such a component these readings scatter by far less than
    it is large. A component that is large beside the force is none of these, however it scatters.
    """
    assert recording.wrench is not None  # kind deflection
    force = recording.wrench[:, :3]
    largest = float(np.linalg.norm(force, axis=1).max(initial=0.0))
    small = thresholds.NOISE.silent_small * largest * (1.0 if k < 3 else thresholds.NOISE.moment_lever)
    value = recording.wrench[:, k]
    if recording.pose is None or not largest or float(np.sqrt(np.mean(value**2))) > small:
        return 0.0
    others = np.delete(force, k, axis=1) if k < 3 else force
    level = np.round(others / (thresholds.NOISE.silent_step * largest))
    labels = np.column_stack([recording.pose, level])
    _, group, count = np.unique(labels, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    free = int((count - 1).sum())
    if free < thresholds.NOISE.least_freedom:
        return 0.0
    mean = np.bincount(group, value) / count
    return float(np.sqrt(np.sum((value - mean[group]) ** 2) / free))


def compute_load_tolerance(largest: Array, share: float, stated: StandardUncertainty) -> Array:
    """(6,) N, N·m: how far each component of two readings may be apart for the same load.

    Args:
        largest: (2,) largest force and moment there, N and N·m.
        share: of them.
        stated: 1 sigma; what it cannot tell apart is the same.
    """
    sigma = np.array([stated.force or 0.0, stated.moment or 0.0])
    return np.repeat(np.maximum(np.maximum(share * largest, thresholds.NOISE.same * sigma), 1e-9 * share), 3)

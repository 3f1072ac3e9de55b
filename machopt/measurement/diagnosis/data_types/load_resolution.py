"""Resolution of the force sensor: components that contain only noise, and loads that are equal within its
uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.measurement import thresholds
from machopt.numerics.array_types import Array

COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


def discard_noise_components(recording: Recording) -> tuple[Recording, list[str]]:
    """Set load components to zero that stay within their stated uncertainty.

    A column of noise correlates with anything by chance. At least one force component is always kept.

    Args:
        recording: Load tests.

    Returns:
        The recording (unchanged if nothing was removed) and notes.
    """
    if recording.wrench is None:
        return recording, []
    stated = [recording.uncertainty.force] * 3 + [recording.uncertainty.moment] * 3
    quiet = []
    for k, notes in enumerate(stated):
        w = np.abs(recording.wrench[:, k])
        if not w.any():
            continue
        sigma = notes or _estimate_component_scatter(recording, k)
        if not sigma:
            continue
        loud = w > thresholds.LEVELS.outlier_sigma * sigma
        rest = w[~loud]
        if loud.mean() <= thresholds.SHARES.negligible and np.mean(rest**2) <= (thresholds.RATIOS.larger * sigma) ** 2:
            quiet.append(k)
    if not quiet or set(quiet) >= {0, 1, 2}:
        return recording, []
    wrench = recording.wrench.copy()
    wrench[:, quiet] = 0.0
    names = ", ".join(COLUMNS[k] for k in quiet)
    return replace(recording, wrench=wrench), [f"{names}: nothing beyond its uncertainty; counted as zero"]


def _estimate_component_scatter(recording: Recording, k: int) -> float:
    """Return the standard deviation of a small component over readings in one pose with equal other forces; 0 if
    unknown.

    A load that the robot carries repeats. Its replicates scatter much less than its size. A component that is large
    compared with the force is never removed.
    """
    assert recording.wrench is not None  # kind deflection
    force = recording.wrench[:, :3]
    largest = float(np.linalg.norm(force, axis=1).max(initial=0.0))
    small = thresholds.SHARES.negligible * largest * (1.0 if k < 3 else thresholds.LIMITS.lever)
    value = recording.wrench[:, k]
    if recording.pose is None or not largest or float(np.sqrt(np.mean(value**2))) > small:
        return 0.0
    others = np.delete(force, k, axis=1) if k < 3 else force
    level = np.round(others / (thresholds.SHARES.load_tolerance * largest))
    labels = np.column_stack([recording.pose, level])
    _, group, count = np.unique(labels, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    free = int((count - 1).sum())
    if free < thresholds.COUNTS.min_degrees_of_freedom:
        return 0.0
    mean = np.bincount(group, value) / count
    return float(np.sqrt(np.sum((value - mean[group]) ** 2) / free))


def compute_load_tolerance(largest: Array, share: float, stated: StandardUncertainty) -> Array:
    """Compute how far two loads may differ and still count as equal.

    Args:
        largest: (2,) largest force and moment at the pose, N and N·m.
        share: Relative tolerance.
        stated: Standard uncertainty of the sensor; smaller differences are not resolved.

    Returns:
        (6,) tolerance of each component, N and N·m.
    """
    sigma = np.array([stated.force or 0.0, stated.moment or 0.0])
    return np.repeat(
        np.maximum(np.maximum(share * largest, thresholds.LEVELS.difference_sigma * sigma), 1e-9 * share), 3
    )

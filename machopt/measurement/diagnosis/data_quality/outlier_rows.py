"""Single rows of a recording that are impossible: outliers of the model, or copies of the preceding row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from machopt.data_types.effect_locations import format_rows_location, parse_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import OUTLIERS
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.duplicated_rows import is_coarsely_rounded
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem as Equations
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.statistics.outlier_rejection import find_repeated_deviations

Flags = NDArray[np.bool_]
DECIMAL_SHIFTS = (10.0, 100.0, 1000.0)


def find_outlier_rows(
    recording: Recording, diagnosis: DiagnosisResult, copies: Flags, problem: Equations, certain: Flags | None = None
) -> Finding | None:
    """Build a finding for outlier rows if there are more than measurement noise explains, or if they are clearly
    typing errors.

    Args:
        recording: Recording as diagnosed.
        diagnosis: Result with the excluded readings.
        copies: (N,) True for rows that repeat the displacement of the preceding row under another load.
        problem: Equations; defines which readings are replicates.
        certain: (N,) True for rows that contain the reading of another pose; these are always reported.

    Returns:
        The finding, or None.
    """
    out = ~diagnosis.used
    excluded = out & ~find_repeated_deviations(problem, diagnosis.errors.final, out)
    if not excluded.any():
        return None
    measured = recording.displacement if recording.kind == "deflection" else recording.position
    slips = np.zeros(len(excluded), bool)
    if measured is not None:
        d = measured[:, :3]
        predicted = d - diagnosis.errors.final[:, :3]
        noise = thresholds.RATIOS.double * 1e-3 * diagnosis.noise_floor
        for f in DECIMAL_SHIFTS:
            large = (np.abs(d / f - predicted) < noise) & (np.abs(predicted) > thresholds.RATIOS.double * noise)
            small = (np.abs(d - predicted / f) < noise) & (np.abs(predicted) > thresholds.RATIOS.doubtful * noise)
            slips |= excluded & (large | small).any(axis=1)
    clerical = int((slips | (copies & excluded)).sum())
    share = float(excluded.mean())
    if share <= thresholds.SHARES.outliers and (
        clerical < thresholds.COUNTS.min_repetitions or clerical < thresholds.SHARES.majority * excluded.sum()
    ):
        excluded = excluded & (np.zeros(len(excluded), bool) if certain is None else certain)
        clerical = int(excluded.sum())
    if not excluded.any():
        return None
    where = format_rows_location(problem.row[excluded].tolist())
    count = float(excluded.sum())
    # probability that Gaussian noise causes at least one of these rows
    by_noise = float(min(2.0 * ndtr(-thresholds.LEVELS.outlier_sigma) * diagnosis.errors.final.size, 1.0))
    return build_record_finding(
        OUTLIERS.name,
        where,
        f"{clerical} look like slipped decimals or copied rows" if clerical else "",
        diagnosis.heldout_before,
        diagnosis.heldout_after,
        by_noise,
        {"count": build_exact_estimate(count)},
        law="gross errors",
        equation="residual beyond six robust standard deviations",
        stated={"rows": parse_location(where).which},
    )


def find_copied_rows(recording: Recording) -> Flags:
    """Find rows that repeat the measured values of the preceding row although load or pose changed.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        (N,) True for copied rows.
    """
    values = recording.displacement if recording.kind == "deflection" else recording.position
    out = np.zeros(len(recording), bool)
    if values is None:
        return out
    v = values[:, :3]
    if is_coarsely_rounded(v):
        return out
    same = (v[1:] == v[:-1]).all(axis=1) & v[1:].any(axis=1)
    moved = (recording.q[1:] != recording.q[:-1]).any(axis=1) & (recording.pose[1:] != recording.pose[:-1])
    if recording.wrench is not None:
        size = max(float(np.linalg.norm(recording.wrench[:, :3], axis=1).max()), 1e-9)
        change = np.linalg.norm(np.diff(recording.wrench[:, :3], axis=0), axis=1)
        moved |= change > thresholds.SHARES.load_tolerance * size
    out[1:] = same & moved
    return out

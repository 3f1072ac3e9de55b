"""Comparison of residuals and estimated noise with the stated uncertainty of the instruments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import Verdict, compute_rms
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
WEAKER_VERDICTS = {"consistent": "unexplained", "explained": "partly_explained"}


def weaken_verdict(verdict: Verdict) -> Verdict:
    """Return the strongest verdict that is possible with an unexplained remainder.

    Args:
        verdict: Verdict without the remainder.

    Returns:
        The weaker verdict.
    """
    return WEAKER_VERDICTS.get(verdict, verdict)  # type: ignore[return-value]


def compute_measured_noise(problem: DiagnosisProblem, noise: ReplicateNoise, used: Flags) -> float:
    """Compute the noise of the first family that does not depend on the model.

    Args:
        problem: Regression problem.
        noise: Estimated noise.
        used: (N,) True for readings that are used.

    Returns:
        rmse per coordinate in the family's report unit, by replicates or as the recording states it; NaN without both.
    """
    if noise.replicated:
        return holdout_residuals.compute_noise_floor(problem, noise, used)
    family = problem.families[0]
    if not family.stated_uncertainty:
        return float("nan")
    gain = 0.0
    if problem.scale is not None:
        gain = thresholds.SHARES.negligible * compute_rms(problem.scale[used][:, list(family.columns)])
    return family.factor * float(np.hypot(family.stated_uncertainty, gain))


def check_stated_uncertainty(
    problem: DiagnosisProblem, residual: Array, noise: ReplicateNoise, used: Flags
) -> str | None:
    """Check whether noise or misfit is many times the stated uncertainty of the instruments.

    Args:
        problem: Problem; its first family is checked.
        residual: (N, D) held-out residuals, SI; fitted residuals if there are too few poses.
        noise: Estimated noise.
        used: (N,) True for readings that are used.

    Returns:
        The excess in words; None if there is none or no uncertainty is stated.
    """
    family = problem.families[0]
    if not family.stated_uncertainty or not used.any():
        return None
    columns = list(family.columns)
    gain = 0.0
    if problem.scale is not None:
        gain = thresholds.SHARES.negligible * compute_rms(problem.scale[used][:, columns])
    own = float(np.hypot(family.stated_uncertainty, gain / thresholds.RATIOS.implausible))
    floor, rest = (
        holdout_residuals.compute_noise_floor(problem, noise, used),
        holdout_residuals.compute_rmse(problem, residual, used),
    )
    most = thresholds.RATIOS.implausible * family.factor * own
    if max(floor, rest) <= most:
        return None
    stated = family.factor * family.stated_uncertainty
    worst, what = (floor, "passes for noise") if floor > most else (rest, "is left")
    return (
        f"{worst:.3g} {family.unit} {what}, {worst / stated:.0f} times the {stated:.3g} {family.unit} that the "
        "recording states for a reading: something else is there, of the record or of the robot"
    )

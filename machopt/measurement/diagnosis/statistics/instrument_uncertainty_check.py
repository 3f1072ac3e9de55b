"""What is left, or passes for noise, against what the recording states its instruments to be good for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import Verdict, compute_rms
from machopt.measurement.diagnosis.statistics import holdout_residuals
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
WEAKER_VERDICTS = {"consistent": "unexplained", "explained": "partly_explained"}


def weaken_verdict(verdict: Verdict) -> Verdict:
    """What can still be said where something is left: that all is well cannot."""
    return WEAKER_VERDICTS.get(verdict, verdict)  # type: ignore[return-value]


@dataclass(frozen=True)
class ExcessNoise:
    """Something is left that no such instrument makes."""

    words: str

    def verdict(self, verdict: Verdict) -> Verdict:
        """What can still be said."""
        return weaken_verdict(verdict)


def check_stated_uncertainty(
    problem: DiagnosisProblem, left: Array, noise: ReplicateNoise, used: Flags
) -> ExcessNoise | None:
    """Whether noise or misfit is many times what the instruments are stated to make; None: not, or nothing is stated.

    Args:
        problem: its first family is judged.
        left: (N, D) of unseen readings, SI; of all where poses are too few to leave any out.
        noise: as found.
        used: (N,) readings that count.
    """
    family = problem.families[0]
    if not family.stated_uncertainty or not used.any():
        return None
    columns = list(family.columns)
    gain = 0.0
    if problem.scale is not None:
        gain = thresholds.PROOF.gain_doubt * compute_rms(problem.scale[used][:, columns])
    own = float(np.hypot(family.stated_uncertainty, gain / thresholds.PROOF.beyond_stated))
    floor, rest = (
        holdout_residuals.compute_noise_floor(problem, noise, used),
        holdout_residuals.compute_rmse(problem, left, used),
    )
    most = thresholds.PROOF.beyond_stated * family.factor * own
    if max(floor, rest) <= most:
        return None
    stated = family.factor * family.stated_uncertainty
    worst, what = (floor, "passes for noise") if floor > most else (rest, "is left")
    return ExcessNoise(
        f"{worst:.3g} {family.unit} {what}, {worst / stated:.0f} times the {stated:.3g} {family.unit} that the "
        "recording states for a reading: something else is there, of the record or of the robot"
    )

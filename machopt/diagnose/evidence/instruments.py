"""What is left, or passes for noise, against what the recording states its instruments to be good for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence import heldout
from machopt.diagnose.evidence.noise import Noise
from machopt.diagnose.nouns.problem import Problem
from machopt.diagnose.nouns.result import Verdict, rms

Flags = NDArray[np.bool_]
LESS = {"consistent": "unexplained", "explained": "partly_explained"}


def less(verdict: Verdict) -> Verdict:
    """What can still be said where something is left: that all is well cannot."""
    return LESS.get(verdict, verdict)  # type: ignore[return-value]


@dataclass(frozen=True)
class Beyond:
    """Something is left that no such instrument makes."""

    words: str

    def verdict(self, verdict: Verdict) -> Verdict:
        """What can still be said."""
        return less(verdict)


def beyond(problem: Problem, left: Array, noise: Noise, used: Flags) -> Beyond | None:
    """Whether noise or misfit is many times what the instruments are stated to make; None: not, or nothing is stated.

    Args:
        problem: its first family is judged.
        left: (N, D) of unseen readings, SI; of all where poses are too few to leave any out.
        noise: as found.
        used: (N,) readings that count.
    """
    family = problem.families[0]
    if not family.stated or not used.any():
        return None
    columns = list(family.columns)
    gain = 0.0
    if problem.scale is not None:
        gain = calibrated.PROOF.gain_doubt * rms(problem.scale[used][:, columns])
    own = float(np.hypot(family.stated, gain / calibrated.PROOF.beyond_stated))
    floor, rest = heldout.floor(problem, noise, used), heldout.rmse(problem, left, used)
    most = calibrated.PROOF.beyond_stated * family.factor * own
    if max(floor, rest) <= most:
        return None
    stated = family.factor * family.stated
    worst, what = (floor, "passes for noise") if floor > most else (rest, "is left")
    return Beyond(
        f"{worst:.3g} {family.unit} {what}, {worst / stated:.0f} times the {stated:.3g} {family.unit} that the "
        "recording states for a reading: something else is there, of the record or of the robot"
    )

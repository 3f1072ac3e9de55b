"""Noise and joint compliance that a plan of discriminating measurements counts on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.measurement.design.reading_noise import UNLOADED_TWICE, ReadingNoise
from machopt.measurement.diagnosis.discrimination.open_hypotheses import (
    OpenDiagnosis,
)
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class DiscriminationOptions:
    """User input on the next measurement."""

    noise: ReadingNoise  # noise of a reading, with the least number of rounds
    has_stated_noise: bool  # the user stated the noise: it overrides that of the diagnosis
    targets: float  # m, distance between the targets on the tool


def compute_planning_noise(user_options: DiscriminationOptions, diagnosis: OpenDiagnosis, cycles: int) -> ReadingNoise:
    """Compute the noise of a number of rounds, from the diagnosis or from the user's statement.

    Args:
        user_options: User input; a stated noise has priority.
        diagnosis: The open diagnosis with its observed scatter.
        cycles: Number of rounds.

    Returns:
        Noise of the mean of all rounds.
    """
    stated = user_options.noise
    if diagnosis.scatter is None or user_options.has_stated_noise:
        return replace(stated, cycles=cycles, targets=stated.targets if diagnosis.coordinates == 6 else None)
    own, visit = diagnosis.scatter
    targets = None
    if diagnosis.coordinates == 6:
        targets = own / diagnosis.turn if diagnosis.turn else user_options.targets
    # each round moves to the pose again: the error shared by a visit is independent between rounds
    return ReadingNoise(
        displacement=own / np.sqrt(UNLOADED_TWICE),
        cycle=0.0,
        pose=visit / np.sqrt(cycles),
        force=stated.force,
        targets=targets,
        cycles=cycles,
    )


def select_planning_compliance(open_diagnosis: OpenDiagnosis, stiffness: Array) -> Array:
    """Return the joint compliances of the diagnosis, with the cell's where the diagnosis has none.

    Args:
        open_diagnosis: The open diagnosis.
        stiffness: (6,) joint stiffness of the cell, N·m/rad.

    Returns:
        (6,) rad/(N·m).
    """
    return np.array([open_diagnosis.compliance.get(j, 0.0) or 1.0 / stiffness[j - 1] for j in range(1, 7)])

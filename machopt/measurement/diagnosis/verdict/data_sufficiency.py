"""Check whether there are enough readings for a diagnosis, and for the verdict "consistent"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.verdict.verdict_text import format_error_size, format_verdict

POSES_ADVICE = "ten poses or more would do (machopt plan-poses chooses them)"
REPLICATES_ADVICE = (
    "a second session over the same poses and loads, or standard_uncertainty in recording.yaml, would do"
)


def downgrade_if_insufficient(d: DiagnosisResult, problem: DiagnosisProblem) -> DiagnosisResult:
    """Change the verdict to "insufficient" if nothing was found and the data are too few to exclude a mismatch.

    Without replicates and without a stated uncertainty, noise and mismatch cannot be separated. Then findings cannot
    explain everything either.

    Args:
        d: Complete result of a static recording.
        problem: Its problem.

    Returns:
        The result.
    """
    poses = len(np.unique(problem.group[d.used]))
    unknown = bool(np.isnan(d.mismatch_p)) and not problem.families[0].stated_uncertainty
    if unknown and d.verdict == "explained":
        text = (
            f"nothing was measured twice and no uncertainty is stated: what is left passes for noise; "
            f"{REPLICATES_ADVICE}"
        )
        notes = replace(d, verdict="partly_explained", notes=(*d.notes, text))
        return replace(notes, sentence=format_verdict(notes))
    if d.verdict != "consistent":
        return d
    if poses < thresholds.COUNTS.min_groups:
        why, would = f"{poses} pose{'' if poses == 1 else 's'} cannot show what a model leaves out", POSES_ADVICE
    elif unknown:
        why = "nothing was measured twice and no uncertainty is stated, so whatever the model lacks passes for noise"
        would = REPLICATES_ADVICE
    else:
        return d
    return replace(
        d,
        verdict="insufficient",
        sentence=f"Not enough data: the refitted model leaves {format_error_size(d.heldout_after, d.unit)} on "
        f"{d.predicted or 'readings'} that no fit saw, and {why}; {would}.",
        next_experiment=f"{would[0].upper()}{would[1:]}.",
    )


def check_enough_readings(problem: DiagnosisProblem, recording: Recording) -> None:
    """Raise an error if the base unknowns alone could fit every reading.

    Args:
        problem: Problem with its base unknowns.
        recording: Recording, for the message.

    Raises:
        RecordingError: There are too few readings or poses.
    """
    unknowns = sum(u.prior is None or u.location == "tool" for u in problem.unknowns)  # reflector positions included
    distinct = min(len(problem), 2 * len(np.unique(problem.group)))  # further replicates of one pose add no information
    if distinct * problem.dimensions > unknowns and problem.y.size >= 2 * unknowns:
        return
    poses = len(np.unique(problem.group))
    raise RecordingError(
        f"{len(problem)} reading{'' if len(problem) == 1 else 's'} of {problem.dimensions} coordinates in {poses} "
        f"pose{'' if poses == 1 else 's'} cannot test a model that refits {unknowns} numbers to them; ten "
        "poses or more would work (machopt plan-poses chooses them)",
        file=recording.source,
    )

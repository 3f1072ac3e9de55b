"""Findings about the recording: place, correction, and effect of the correction on the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding

STATED_RECORD = "the record, read as stated"  # alternative that the finding is compared with


def build_exact_estimate(value: float, unit: str = "1") -> EstimatedValue:
    """Return a value without uncertainty: a factor, a count, or a computed length.

    Args:
        value: The value.
        unit: Its unit.

    Returns:
        Estimate with intervals of zero width.
    """
    return EstimatedValue(value, unit, (value, value), (value, value))


def build_record_finding(
    effect: str,
    where: str,
    words: str,
    before: float,
    after: float,
    p_value: float,
    parameters: Mapping[str, EstimatedValue] | None = None,
    *,
    law: str = STATED_RECORD,
    equation: str = "",
    further_places: tuple[str, ...] = (),
    stated: Mapping[str, Any] | None = None,
) -> Finding:
    """Build a finding about the recording.

    Args:
        effect: Name of an effect of :mod:`machopt.effects.recording.record_faults` or of a sensor.
        where: Location.
        words: Description of the fault and the correction.
        before: Error of the recording as stated, in the channel's report unit; NaN if not known yet.
        after: Error after the correction, in the same unit.
        p_value: Probability of the improvement by chance.
        parameters: Estimates; the first one is the size.
        law: Name of the law if it is more than a different reading of the recording.
        equation: Its equation.
        further_places: Further affected places.
        stated: Parameters of the correction instead of the words.

    Returns:
        The finding.
    """
    return Finding(
        effect=effect,
        location=where,
        law=law,
        equation=equation,
        note=words,
        one_of=tuple((effect, w) for w in (where, *further_places)),
        parameters=dict(parameters or {}),
        before=before,
        after=after,
        p_value=p_value,
        correction=RecordCorrection(effect, where, {"message": words} if stated is None else stated),
        record=True,
    )

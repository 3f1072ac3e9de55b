"""What was wrong with a record as a finding: its place, what was done, what that did to the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding

STATED_RECORD = "the record, read as stated"  # the law that the finding is held against


def build_exact_estimate(value: float, unit: str = "1") -> EstimatedValue:
    """A number that is no estimate: a factor, a count, a length as computed."""
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
    beside: tuple[str, ...] = (),
    stated: Mapping[str, Any] | None = None,
) -> Finding:
    """The finding.

    Args:
        effect: of :mod:`machopt.effects.recording.record_faults`, or of a sensor.
        where: its place.
        words: what was found and done.
        before, after: error in the channel's report unit, as stated and as put right; NaN: not known yet.
        p_value: that it is chance.
        parameters: the first is the size.
        law, equation: where it is more than a record read otherwise.
        beside: other places that are hit.
        stated: what the correction holds instead of the words.
    """
    return Finding(
        effect=effect,
        location=where,
        law=law,
        equation=equation,
        note=words,
        one_of=tuple((effect, w) for w in (where, *beside)),
        parameters=dict(parameters or {}),
        before=before,
        after=after,
        p_value=p_value,
        correction=RecordCorrection(effect, where, {"message": words} if stated is None else stated),
        record=True,
    )

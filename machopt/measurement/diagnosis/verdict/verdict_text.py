"""Verdict sentence and proposal of the next measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.effects.effect_wording import format_effect_in_sentence, format_place
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import UNCATALOGUED, DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.measurement.diagnosis.verdict.base_model_notes import describe_unstated_values

Flags = NDArray[np.bool_]
MOST_PLACES = 5  # most places in the sentence, the largest shares first
MAX_ALTERNATIVES = 3  # most alternatives in the proposal of a measurement


def format_verdict(d: DiagnosisResult) -> str:
    """Format the verdict: error size, location, effect, certainty, open alternatives, next step.

    Args:
        d: Result of the diagnosis.

    Returns:
        Text.
    """
    error = f"{format_error_size(d.heldout_before, d.unit)} on {d.predicted or 'readings'} that no fit saw"
    if d.verdict == "consistent":
        after = f"{format_error_size(d.heldout_after, d.unit)} on {d.predicted or 'readings'} that no fit saw"
        there = describe_unstated_values(d.coefficients)
        corrections = "; ".join(f"{_format_finding(f)}" for f in d.findings)
        return (
            f"Consistent{f' once the record is corrected ({corrections})' if corrections else ''}: the refitted model "
            f"leaves {after}, {_format_noise(d)}; nothing that comes back "
            f"in repeats is left "
            "to explain." + (f" Refitted for that, and stated nowhere: {there}." if there else "")
        )
    size = format_error_size(d.repeatable, d.unit)
    if d.is_ordered:
        left = f"{size} of it is shared by successive readings of other poses, as a drift is"
    elif math.isfinite(d.mismatch_p):
        left = f"{size} of it comes back in repeats"
    elif d.measured_noise > 0.0:
        left = f"{size} of it is more than the noise"
    else:
        left = "nothing was measured twice, so part of it may be noise"
    if d.verdict == "unexplained":
        places = list(dict.fromkeys(format_place(s.axis) for s in d.mismatch if s.kind == "machine"))
        where = ", ".join(places[:MOST_PLACES]) + (" …" if len(places) > MOST_PLACES else "")
        # without the interval of the note: it is in SI, the report states it in file units
        data_shares = (
            f"; in the data {100 * s.share:.0f} % gathers along {s.axis}" for s in d.mismatch if s.kind == "data"
        )
        data = next(data_shares, "")
        corrected = "; ".join(_format_finding(f) for f in d.findings)
        if corrected:
            error = f"{format_error_size(d.heldout_after, d.unit)} on {d.predicted or 'readings'} that no fit saw"
        return (
            f"Unexplained{f', with the record corrected ({corrected})' if corrected else ''}: the refitted model "
            f"leaves {error}; {left}, and no law of the catalogue explains it. Nearest places: {where or 'none'}{data}."
            + _describe_unnamed_corrections(d)
        )
    parts = [_format_finding(f) for f in d.findings]
    head = "Explained" if d.verdict == "explained" else "Partly explained"
    open_ = sorted({format_effect_in_sentence(*n) for f in d.findings for n in f.one_of[1:]})
    return (
        f"{head}: {'; '.join(parts)}. Unseen {d.predicted or 'readings'}: "
        f"{format_error_size(d.heldout_before, d.unit)} → "
        f"{format_error_size(d.heldout_after, d.unit)} ({_format_noise(d)})"
        + (f", {100 * d.explained:.0f} % of the mismatch closed. " if d.explained > 0 else ". ")
        + (
            f"These data cannot exclude {', '.join(open_[:4])}{' …' if len(open_) > 4 else ''}."
            if open_
            else "No other explanation of the catalogue does as well."
        )
        + _describe_remaining_mismatch(d)
    )


def _format_noise(d: DiagnosisResult) -> str:
    """Return the noise that the model does not influence; residuals of a model are no measure of noise."""
    if not d.measured_noise > 0.0:
        return "noise not measured"
    return f"noise {format_error_size(d.measured_noise, d.unit)}"


def _describe_unnamed_corrections(d: DiagnosisResult) -> str:
    if not d.unnamed:
        return ""
    return (
        f" kinematics.yaml holds {len(d.unnamed)} correction{'s' if len(d.unnamed) > 1 else ''} that cannot be named, "
        f"with which the files leave {format_error_size(d.heldout_after, d.unit)}."
    )


def _describe_remaining_mismatch(d: DiagnosisResult) -> str:
    """Describe how much mismatch remains, and where."""
    after, noise = d.heldout_after, d.measured_noise if d.measured_noise > 0.0 else d.noise_floor
    if d.verdict == "explained":
        if not d.repeatable_after > thresholds.SHARES.majority * noise:
            return ""
        return (
            f" {format_error_size(d.repeatable_after, d.unit)} still comes back in repeats: the law is not quite this "
            "one, or something else is there too."
        )
    replicated = math.isfinite(d.mismatch_p)
    left = d.repeatable_after if replicated and d.repeatable_after > 0.0 else math.sqrt(max(after**2 - noise**2, 0.0))
    if not left > 0.0:
        return ""
    named = {f.location for f in d.findings}
    places = [format_place(s.axis) for s in d.mismatch if s.kind == "machine" and s.axis not in named]
    data = [s.axis for s in d.mismatch if s.kind == "data"]
    where = f", nearest to {', '.join(places[:3])}" if places else ""
    where += f", mostly along {data[0]} of the data" if data else ""
    return f" {format_error_size(left, d.unit)} remains unexplained{where}."


def has_record_findings_only(d: DiagnosisResult) -> bool:
    """Return whether all findings concern the recording.

    Args:
        d: Result of the diagnosis.

    Returns:
        True if there are findings and none concerns the machine.
    """
    return bool(d.findings) and all(f.record for f in d.findings)


def is_mismatch_closed(d: DiagnosisResult) -> bool:
    """Return whether the findings explain at least 0.5 % of the mismatch, which is displayed as 1 %.

    Args:
        d: Result of the diagnosis.

    Returns:
        True if so.
    """
    return round(d.explained, 2) > 0.0


def _list_named_alternatives(f: Finding) -> list[tuple[str, str]]:
    return [name for name in f.one_of[1:] if name[0] != UNCATALOGUED]


def suggest_next_experiment(d: DiagnosisResult) -> str:
    """Propose the next measurement in words.

    Args:
        d: Result of the diagnosis.

    Returns:
        Text.
    """
    sets = [f for f in d.findings if len(f.one_of) > 1]
    if sets:
        f = next((f for f in sets if _list_named_alternatives(f)), sets[0])
        named = _list_named_alternatives(f)
        others = ", ".join(format_effect_in_sentence(*n) for n in (named or f.one_of[1:])[:MAX_ALTERNATIVES])
        if not named:
            return (
                f"To tell {format_effect_in_sentence(f.effect, f.location)} from {others}: repeat the readings with a "
                f"second target on each side of {format_place(f.one_of[1][1])} and compare their displacements."
            )
        return (
            f"To tell {format_effect_in_sentence(f.effect, f.location)} from {others}: machopt plan-poses CELL "
            f"--discriminate OUT chooses "
            "poses and loads at which their predictions differ most."
        )
    if d.verdict == "unexplained" and d.is_ordered:
        return (
            "Measure again with the poses in another, random order, and record time_s and temperature_C: a drift then "
            "separates from errors of the poses."
        )
    if d.verdict == "unexplained":
        behind = next((format_place(s.axis) for s in d.mismatch if s.kind == "machine"), "the arm")
        return f"Repeat the readings that are worst with a second target behind {behind}: what moves between the two?"
    if d.findings:
        f = d.findings[0]
        return f"Confirm {format_effect_in_sentence(f.effect, f.location)} on another day at poses not measured yet."
    return "None needed for the effects above their detection limits; smaller ones need more repeats or larger loads."


def describe_withdrawn_findings(findings: Sequence[Finding]) -> list[str]:
    """Describe findings that were withdrawn because they explain too little.

    Args:
        findings: Withdrawn findings.

    Returns:
        Notes.
    """
    if not findings:
        return []
    names = ", ".join(format_effect_in_sentence(f.effect, f.location) for f in findings)
    return [f"nearest of the catalogue, but most of the mismatch stays with it: {names}; so it is not named"]


def describe_session_contradictions(effects: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Describe contradictions between sessions by the effect that one session alone would support.

    Args:
        effects: Contradicted effects and places.

    Returns:
        Notes.
    """
    return tuple(
        f"the sessions differ by more than noise: what {format_effect_in_sentence(*name)} would explain shows "
        f"in one of them and another "
        "contradicts it, so it is not named; something was not the same on both days"
        for name in effects
    )


def describe_noise_source(noise: ReplicateNoise, problem: DiagnosisProblem, used: Flags) -> tuple[str, ...]:
    """Describe how the noise was estimated, and what the replicates leave unmeasured.

    Args:
        noise: Estimated noise.
        problem: Problem with the labels of the readings.
        used: (N,) True for readings that are used.

    Returns:
        Notes.
    """
    if not noise.replicated:
        return (
            "no pose was visited twice under the same load, or too few were: noise is taken from what the model "
            "leaves, so small effects pass for noise; a second session over the same poses and loads would tell them "
            "apart",
        )
    if problem.repeat is not None:
        return (
            "noise is taken from load cycles of the same stay at a pose; the return to a pose and another day are not "
            "measured by it",
        )
    rows = used & (problem.replicate >= 0)
    days = np.unique(np.stack([problem.replicate[rows], problem.session[rows]]), axis=1)[0]
    if len(days) and np.bincount(days).max() > 1:
        return ("noise is taken from readings of the same thing on different visits",)
    return (
        "noise is taken from readings of the same thing on different visits of one session; what changes from day to "
        "day is not measured by it",
    )


def _format_finding(f: Finding) -> str:
    first = next(iter(f.parameters.values()), None)
    size = "" if first is None or first.unit == "1" else f", {_format_number(first.value)} {first.unit}"
    return f"{format_effect_in_sentence(f.effect, f.location)}{size}{f' ({f.note})' if f.note else ''}"


def format_error_size(value: float, unit: str) -> str:
    """Format an error; below 0.5 mm in micrometres.

    Args:
        value: Error in ``unit``.
        unit: Unit of the error.

    Returns:
        Text.
    """
    return (
        f"{_format_number(1e3 * value)} µm" if unit == "mm" and abs(value) < 0.5 else f"{_format_number(value)} {unit}"
    )


def _format_number(value: float) -> str:
    return (
        f"{value:.3g}" if abs(value) < 1e3 or abs(value) >= 1e5 else f"{float(f'{value:.3g}'):.0f}"
    )  # 1980, no 1.98e+03

"""Verdict of a result in one sentence: gain and safety."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from machopt.cell import absolute_accuracy
from machopt.data_types.manifest import add_scope_to_verdict
from machopt.report.page_types.display_units import FINE_LENGTH, LENGTH, QUANTITY_LABELS, QUANTITY_UNITS, SHARE, TIME

if TYPE_CHECKING:
    from machopt.report.page_types.optimize_page_data import GainOverBaseline, ReportData, ResultSummary, ShiftSummary


@dataclass(frozen=True)
class ResultVerdict:
    """Badge, its colour class, the sentence, and the cautions."""

    badge: str
    tone: str  # "" good, "warn", "bad"
    sentence: str
    cautions: tuple[str, ...]


@dataclass(frozen=True)
class KeyFigure:
    """One key figure of the headline."""

    name: str
    value: str
    unit: str
    more: str


def _build_infeasible_verdict(data: ReportData) -> ResultVerdict:
    """Return badge, sentence and cautions of a result without a trajectory."""
    s = data.summary
    kinds = sorted({p.status for p in data.infeasible})
    why = f" ({', '.join(kinds)})" if kinds else ""
    number = s.infeasible_points or len(data.infeasible)
    parts = [f"for {number} of {s.points} points{why}{_describe_first_infeasible(data)}"] if number else []
    breaks = [b for b in data.breaks if not any(b.reason in p.reason for p in data.infeasible)]
    if breaks:  # those that no point shows
        first = breaks[0]
        parts.append(
            f"at {format_count(len(breaks), 'break')} of the motion, the first from {first.before} to "
            f"{first.after} ({first.reason})"
        )
    sentence = (
        f"No feasible plan {' and '.join(parts)}; no trajectory was written. "
        "The tables below list the cause for each, its amount, and what would help."
    )
    return ResultVerdict(
        add_scope_to_verdict("NO FEASIBLE ANSWER", s.unchecked),
        "bad",
        _join_sentences(s.note, sentence),
        _list_cautions(data),
    )


def build_verdict(data: ReportData) -> ResultVerdict:
    """Return badge, sentence and cautions of a result.

    Args:
        data: Data of the report.
    """
    s = data.summary
    if s.outcome == "infeasible":
        return _build_infeasible_verdict(data)
    tolerances = data.tolerances
    headline = tolerances.headline if tolerances is not None and tolerances.operations else ""
    parts = [_describe_gain(s), _describe_mean_gain(s)]
    if math.isfinite(s.feed_held):
        parts.append(
            f"programmed feed reached for {SHARE.format_value(s.feed_held, unit=True)} of the cutting "
            f"time{_describe_ramps(data)}"
        )
    if math.isfinite(s.nearest_miss):
        where = ", ".join(filter(None, [s.nearest_pair, f"point {s.nearest_point}" if s.nearest_point >= 0 else ""]))
        parts.append(
            f"minimum clearance at the points "
            f"{LENGTH.format_value(s.nearest_miss, unit=True)}{f' ({where})' if where else ''}"
        )
    parts.append(
        add_scope_to_verdict(
            {"passed": "verification passed", "failed": "verification failed", "not run": "verification not run"}[
                s.verification
            ],
            s.unchecked,
        )
    )
    sentence = "; ".join(p for p in parts if p)
    outcome = f"{headline}." if headline else ""
    sentence = _join_sentences(outcome, sentence[:1].upper() + sentence[1:] + ".", s.note)
    if s.verification == "failed" or s.outcome == "verification_failed":
        return ResultVerdict(
            add_scope_to_verdict("VERIFICATION FAILED: DO NOT RUN", s.unchecked), "bad", sentence, _list_cautions(data)
        )
    if s.verification == "not run":
        return ResultVerdict(add_scope_to_verdict("NOT VERIFIED", s.unchecked), "warn", sentence, _list_cautions(data))
    tone = "warn" if s.infeasible_points or s.unchecked or s.blockers or s.misfit else ""
    return ResultVerdict(add_scope_to_verdict("VERIFIED", s.unchecked), tone, sentence, _list_cautions(data))


def _describe_ramps(data: ReportData) -> str:
    """What the rest of the cutting time is where the axes hold the feed."""
    return ", the rest is braking at stops that the path requires" if data.feed_stops and not data.dips else ""


def _describe_first_infeasible(data: ReportData) -> str:
    """Where the first point without an answer lies, and how far off it is."""
    if not data.infeasible:
        return ""
    p = data.infeasible[0]
    x, y, z = (LENGTH.format_value(float(v)) for v in p.position)
    return f", the first point {p.point} at x {x}, y {y}, z {z} mm{f', {p.shortfall}' if p.shortfall else ''}"


def build_key_figures(data: ReportData) -> list[KeyFigure]:
    """Return the key figures below the sentence; those that do not exist are left out.

    Args:
        data: Data of the report.
    """
    s = data.summary
    unit, words = QUANTITY_UNITS[s.quantity], QUANTITY_LABELS[s.quantity]
    least = "least" if words.large_is_good else "worst"
    out: list[KeyFigure] = []
    if s.outcome == "infeasible":  # a stiffness of the points that happen to work is no result
        return (
            [KeyFigure("toolpath points", str(s.points), "", f"{s.infeasible_points} infeasible")] if s.points else out
        )
    for name, chosen, default in (
        (f"{least} {words.axis.lower()}", s.worst_chosen, s.worst_default),
        (f"mean {words.axis.lower()}", s.mean_chosen, s.mean_default),
    ):
        if math.isfinite(chosen):
            more = f"CAM default {unit.format_value(default)}" if math.isfinite(default) else "CAM default not feasible"
            if name.startswith(least) and s.worst_parts:
                more = f"{s.worst_parts}; {more}"
            out.append(KeyFigure(name, unit.format_value(chosen), unit.name, more))
    if s.shift is not None:
        leaves = s.shift.left_mean if s.shift.left_mean90 is None else s.shift.left_mean90[1]
        upto = "" if s.shift.left_mean90 is None else "up to "
        left = f"mean {FINE_LENGTH.format_value(s.shift.mean)}, leaves {upto}{_format_small_length(leaves)} on average"
        out.append(KeyFigure("compensated by up to", FINE_LENGTH.format_value(s.shift.worst), "mm", left))
    if s.certificate is not None:
        c = s.certificate
        side = "below" if c.beyond >= 0.0 else "above"
        over = "above" if c.above >= 0.0 else "below"
        more = (
            f"planned motion {100 * abs(c.above):.2f} % {over} the lower bound {c.bound:.4f}, "
            f"{100 * abs(c.beyond):.2f} % {side} the best sequence on the grid; the bound is a lower limit for every "
            f"sequence on the grid (gap {100 * c.gap:.2f} %)"
            f"{f'; {c.external}' if c.external else ''}"
        )
        out.append(KeyFigure("objective", f"{c.objective:.4f}", "", more))
    if math.isfinite(s.feed_held):
        dips = format_count(len(data.dips), "dip") if data.dips else "no dips"
        out.append(KeyFigure("programmed feed reached", SHARE.format_value(s.feed_held), "%", dips))
    if math.isfinite(s.nearest_miss):
        out.append(
            KeyFigure("minimum clearance at the points", LENGTH.format_value(s.nearest_miss), "mm", s.nearest_pair)
        )
    if math.isfinite(s.cycle_time):
        cut = f"{TIME.format_value(s.cutting_time)} s in the cut" if math.isfinite(s.cutting_time) else ""
        out.append(KeyFigure("cycle time", TIME.format_value(s.cycle_time), "s", cut))
    if s.points:
        length = f"{LENGTH.format_value(s.path_length)} mm of path" if math.isfinite(s.path_length) else ""
        reached = f"{s.infeasible_points} infeasible" if s.infeasible_points else length
        out.append(KeyFigure("toolpath points", str(s.points), "", reached))
    return out


def compute_relative_gain(before: float, after: float) -> float:
    """Return (after − before)/before, NaN where either is missing.

    Args:
        before: The value before.
        after: The value after.
    """
    return (after - before) / before if before else float("nan")


def format_change(before: float, after: float) -> str:
    """Return the relative gain as text, "–" where there is none.

    Args:
        before: The value before.
        after: The value after.
    """
    gain = compute_relative_gain(before, after)
    return format_percent(gain) if math.isfinite(gain) else "–"


def format_count(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 dip``, ``2 dips``.

    Args:
        number: The number.
        noun: The noun in the singular.
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_percent(share: float, *, signed: bool = True) -> str:
    """Return a share as percent, with a true minus sign.

    Args:
        share: The share, 1 is 100 %.
        signed: Write a plus sign for positive values.
    """
    if signed and abs(share) < 0.005:
        return "±0 %"
    return f"{share * 100:{'+' if signed else ''}.0f} %".replace("-", "−")


def _describe_gain(s: ResultSummary) -> str:
    unit, words = QUANTITY_UNITS[s.quantity], QUANTITY_LABELS[s.quantity]
    if not math.isfinite(s.worst_chosen):
        return ""
    to_jiao = compute_relative_gain(s.worst_jiao2022, s.worst_chosen)
    beside = f", {format_percent(to_jiao)} against Jiao 2022" if math.isfinite(to_jiao) else ""
    gain = compute_relative_gain(s.worst_default, s.worst_chosen)
    if not math.isfinite(gain):
        return (
            f"{words.worst} {unit.format_value(s.worst_chosen, unit=True)}{beside}; "
            "the CAM's default rotation is not feasible along the whole path, so there is no gain over it to state"
        )
    return (
        f"{words.worst} {unit.format_value(s.worst_default)} → {unit.format_value(s.worst_chosen, unit=True)} "
        f"({format_percent(gain)}) against the CAM's default rotation{beside}"
    )


def format_gain(gain: GainOverBaseline) -> str:
    """Return a gain with its standard uncertainty: ``18 % ± 6 %``; one decimal where they need it.

    Args:
        gain: The gain over the baseline.
    """
    number = f"{100 * gain.share:.{_count_decimals(gain)}f} %".replace("-", "−")
    return number + (f" ± {100 * gain.std:.{_count_decimals(gain)}f} %" if math.isfinite(gain.std) else "")


def _is_gain_zero(gain: GainOverBaseline) -> bool:
    """No digit of the gain, or of its uncertainty, would show."""
    unsure = gain.std if math.isfinite(gain.std) else 0.0
    return not gain.distinguishable and abs(gain.share) < 5e-4 and unsure < 5e-4


def _count_decimals(gain: GainOverBaseline) -> int:
    return int(gain.std < 0.015 or (not math.isfinite(gain.std) and abs(gain.share) < 0.1))


def _format_small_length(length: float) -> str:
    """A length in mm; a length below the last of three decimals is shown as less than it."""
    return "less than 0.001 mm" if length < 5e-7 else FINE_LENGTH.format_value(length, unit=True)


def _describe_mean_gain(s: ResultSummary) -> str:
    """Return the mean along the path against each baseline, and the compensation shift."""
    known = [g for g in s.gains if math.isfinite(g.share)]
    what = "mean deflection" if s.quantity == "deflection" else "mean compliance"
    parts = []
    for n, g in enumerate(known):
        sign, less = (1.0, "less") if g.share >= 0 else (-1.0, "more")
        if _is_gain_zero(g):
            parts.append(f"the same {what} as with {g.baseline}" if n == 0 else f"the same as with {g.baseline}")
            continue
        n_dec = _count_decimals(g)
        low, high = (round(v, n_dec) + 0.0 for v in sorted(100 * sign * v for v in g.interval))  # no −0.0
        interval = f" (90 %: {low:.{n_dec}f} to {high:.{n_dec}f} %)".replace("-", "−") if math.isfinite(low) else ""
        text = f"{format_gain(replace(g, share=sign * g.share))} {less} than with {g.baseline}{interval}"
        parts.append(f"{what} {text}" if n == 0 else text)
    words = [", ".join(parts)] if parts else []
    if s.shift is not None:
        words.append(
            f"the commanded path is shifted by up to {FINE_LENGTH.format_value(s.shift.worst, unit=True)} against the "
            f"predicted deflection, {_describe_remaining_deflection(s.shift)}"
        )
    return "; ".join(words)


def _describe_remaining_deflection(shift: ShiftSummary) -> str:
    """What a shift leaves: with its interval, where the model's own error is known, and never less than that."""
    if shift.left_mean90 is None or shift.left_worst90 is None or shift.removed90 is None:
        return (
            f"which leaves {_format_small_length(shift.left_mean)} on average and "
            f"{_format_small_length(shift.left_worst)} at worst"
        )
    mean, worst = (
        f"{FINE_LENGTH.format_value(a)} to {_format_small_length(b)}"
        for a, b in (shift.left_mean90, shift.left_worst90)
    )
    low, high = (100.0 * v for v in shift.removed90)
    return (
        f"which removes {low:.0f} to {high:.0f} % of it and leaves {mean} on average and {worst} at worst (90 %, by "
        "what is known of the stiffness)"
    ).replace("-", "−")


def _list_cautions(data: ReportData) -> tuple[str, ...]:
    s = data.summary
    out = [s.misfit] if s.misfit and s.outcome != "infeasible" else []
    gain = compute_relative_gain(s.worst_default, s.worst_chosen)
    if s.outcome != "infeasible" and math.isfinite(gain):
        better = gain if QUANTITY_LABELS[s.quantity].large_is_good else -gain
        if better <= 0:
            out.append("At the worst point there is no gain over the CAM's default rotation.")
    if s.outcome != "infeasible":
        out += [
            f"The gain over {g.baseline}, {format_gain(g)} on average, is below the stiffness model's own uncertainty "
            "or rounding: the two are not distinguishable."
            for g in s.gains
            if not g.distinguishable and not _is_gain_zero(g)
        ]
    if s.outcome != "infeasible" and s.infeasible_points:
        out.append(f"{format_count(s.infeasible_points, 'point')} without an answer, left out of the motion.")
    unknown = [w for w in data.ignored if not w.understood]
    if unknown:
        names = ", ".join(w.word for w in unknown[:4]) + (" …" if len(unknown) > 4 else "")
        out.append(f"The CAM file holds words that were not understood: {names}.")
    if data.excluded_pairs:
        number = format_count(len(data.excluded_pairs), "pair")
        out.append(f"{number} of bodies left out of the collision check, listed below with the reason.")
    out += [f"{w[0].upper()}{w[1:]}." for w in data.warnings if w.startswith(absolute_accuracy.KEY)]
    if data.warnings:
        out.append(f"{format_count(len(data.warnings), 'warning')}, listed below.")
    return tuple(out)


def _join_sentences(*sentences: str) -> str:
    return " ".join(filter(None, sentences))

"""The answer in one sentence: what did I gain, and is it safe?"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from machopt.domain.manifest import with_scope
from machopt.formats import absolute_accuracy
from machopt.report.data import Gain, ReportData, Shift, Summary
from machopt.report.display import FINE_LENGTH, LENGTH, QUANTITY, SHARE, TIME, WORDS


@dataclass(frozen=True)
class Verdict:
    """Badge, its colour class, the sentence, and what to be careful about."""

    badge: str
    tone: str  # "" good, "warn", "bad"
    sentence: str
    cautions: tuple[str, ...]


@dataclass(frozen=True)
class Card:
    """One number of the head line."""

    name: str
    value: str
    unit: str
    more: str


def verdict(data: ReportData) -> Verdict:
    """Badge, sentence and cautions of a result."""
    s = data.summary
    if s.outcome == "infeasible":
        kinds = sorted({p.status for p in data.infeasible})
        why = f" ({', '.join(kinds)})" if kinds else ""
        number = s.infeasible_points or len(data.infeasible)
        parts = [f"for {number} of {s.points} points{why}{_first_of(data)}"] if number else []
        breaks = [b for b in data.breaks if not any(b.reason in p.reason for p in data.infeasible)]
        if breaks:  # those that no point tells
            first = breaks[0]
            parts.append(
                f"at {counted(len(breaks), 'break')} of the motion, the first from {first.before} to "
                f"{first.after} ({first.reason})"
            )
        sentence = (
            f"No answer {' and '.join(parts)} as the cell stands; no trajectory was written. "
            "The tables below say for each what stands in the way, by how much, and what would help."
        )
        return Verdict(with_scope("NO FEASIBLE ANSWER", s.unchecked), "bad", _joined(s.note, sentence), _cautions(data))
    parts = [_gain_words(s), _mean_words(s)]
    if math.isfinite(s.feed_held):
        parts.append(f"feed held on {SHARE.text(s.feed_held, unit=True)} of the cutting time{_ramps_in(data)}")
    if math.isfinite(s.nearest_miss):
        where = ", ".join(filter(None, [s.nearest_pair, f"point {s.nearest_point}" if s.nearest_point >= 0 else ""]))
        parts.append(
            f"nearest miss at the points {LENGTH.text(s.nearest_miss, unit=True)}{f' ({where})' if where else ''}"
        )
    parts.append(
        with_scope(
            {"passed": "verification passed", "failed": "verification failed", "not run": "verification not run"}[
                s.verification
            ],
            s.unchecked,
        )
    )
    sentence = "; ".join(p for p in parts if p)
    sentence = _joined(sentence[:1].upper() + sentence[1:] + ".", s.note)
    if s.verification == "failed" or s.outcome == "verification_failed":
        return Verdict(with_scope("VERIFICATION FAILED: DO NOT RUN", s.unchecked), "bad", sentence, _cautions(data))
    if s.verification == "not run":
        return Verdict(with_scope("NOT VERIFIED", s.unchecked), "warn", sentence, _cautions(data))
    tone = "warn" if s.infeasible_points or s.unchecked or s.blockers or s.misfit else ""
    return Verdict(with_scope("VERIFIED", s.unchecked), tone, sentence, _cautions(data))


def _ramps_in(data: ReportData) -> str:
    """What the rest of the cutting time is where the axes hold the feed."""
    return ", the rest are ramps at stops that the path demands" if data.feed_stops and not data.dips else ""


def _first_of(data: ReportData) -> str:
    """Where the first point without an answer lies, and how far off it is."""
    if not data.infeasible:
        return ""
    p = data.infeasible[0]
    x, y, z = (LENGTH.text(float(v)) for v in p.position)
    return f", the first point {p.point} at x {x}, y {y}, z {z} mm{f', {p.shortfall}' if p.shortfall else ''},"


def cards(data: ReportData) -> list[Card]:
    """The numbers below the sentence; those that do not exist are left out."""
    s = data.summary
    unit, words = QUANTITY[s.quantity], WORDS[s.quantity]
    least = "least" if words.large_is_good else "worst"
    out: list[Card] = []
    if s.outcome == "infeasible":  # a stiffness of the points that happen to work is no result
        return [Card("toolpath points", str(s.points), "", f"{s.infeasible_points} infeasible")] if s.points else out
    for name, chosen, default in (
        (f"{least} {words.axis.lower()}", s.worst_chosen, s.worst_default),
        (f"mean {words.axis.lower()}", s.mean_chosen, s.mean_default),
    ):
        if math.isfinite(chosen):
            more = f"CAM default {unit.text(default)}" if math.isfinite(default) else "CAM default not feasible"
            if name.startswith(least) and s.worst_parts:
                more = f"{s.worst_parts}; {more}"
            out.append(Card(name, unit.text(chosen), unit.name, more))
    if s.shift is not None:
        leaves = s.shift.left_mean if s.shift.left_mean90 is None else s.shift.left_mean90[1]
        upto = "" if s.shift.left_mean90 is None else "up to "
        left = f"mean {FINE_LENGTH.text(s.shift.mean)}, leaves {upto}{_at_least(leaves)} on average"
        out.append(Card("compensated by up to", FINE_LENGTH.text(s.shift.worst), "mm", left))
    if s.certificate is not None:
        c = s.certificate
        side = "below" if c.beyond >= 0.0 else "above"
        over = "above" if c.above >= 0.0 else "below"
        more = (
            f"driven curve {100 * abs(c.above):.2f} % {over} the bound {c.bound:.4f}, "
            f"{100 * abs(c.beyond):.2f} % {side} the grid's sequence; at the stations no sequence on the grid is below "
            f"the bound (gap {100 * c.gap:.2f} %)"
            f"{f'; {c.external}' if c.external else ''}"
        )
        out.append(Card("objective", f"{c.objective:.4f}", "", more))
    if math.isfinite(s.feed_held):
        dips = counted(len(data.dips), "dip") if data.dips else "no dips"
        out.append(Card("feed held", SHARE.text(s.feed_held), "%", dips))
    if math.isfinite(s.nearest_miss):
        out.append(Card("nearest miss at the points", LENGTH.text(s.nearest_miss), "mm", s.nearest_pair))
    if math.isfinite(s.cycle_time):
        cut = f"{TIME.text(s.cutting_time)} s in the cut" if math.isfinite(s.cutting_time) else ""
        out.append(Card("cycle time", TIME.text(s.cycle_time), "s", cut))
    if s.points:
        length = f"{LENGTH.text(s.path_length)} mm of path" if math.isfinite(s.path_length) else ""
        reached = f"{s.infeasible_points} infeasible" if s.infeasible_points else length
        out.append(Card("toolpath points", str(s.points), "", reached))
    return out


def relative_gain(before: float, after: float) -> float:
    """(after − before)/before, NaN where either is missing."""
    return (after - before) / before if before else float("nan")


def change(before: float, after: float) -> str:
    """The relative gain as text, "–" where there is none."""
    gain = relative_gain(before, after)
    return percent(gain) if math.isfinite(gain) else "–"


def counted(number: int, noun: str) -> str:
    """``1 dip``, ``2 dips``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def percent(share: float, *, signed: bool = True) -> str:
    """A share as percent, with a true minus sign."""
    if signed and abs(share) < 0.005:
        return "±0 %"
    return f"{share * 100:{'+' if signed else ''}.0f} %".replace("-", "−")


def _gain_words(s: Summary) -> str:
    unit, words = QUANTITY[s.quantity], WORDS[s.quantity]
    if not math.isfinite(s.worst_chosen):
        return ""
    to_jiao = relative_gain(s.worst_jiao2022, s.worst_chosen)
    beside = f", {percent(to_jiao)} against Jiao 2022" if math.isfinite(to_jiao) else ""
    gain = relative_gain(s.worst_default, s.worst_chosen)
    if not math.isfinite(gain):
        return (
            f"{words.worst} {unit.text(s.worst_chosen, unit=True)}{beside}; "
            "the CAM's default rotation is not feasible along the whole path, so there is no gain over it to state"
        )
    return (
        f"{words.worst} {unit.text(s.worst_default)} → {unit.text(s.worst_chosen, unit=True)} "
        f"({percent(gain)}) against the CAM's default rotation{beside}"
    )


def gain_text(gain: Gain) -> str:
    """``18 % ± 6 %``: a share and its standard uncertainty, with a decimal where that is needed to tell them apart."""
    number = f"{100 * gain.share:.{_decimals(gain)}f} %".replace("-", "−")
    return number + (f" ± {100 * gain.std:.{_decimals(gain)}f} %" if math.isfinite(gain.std) else "")


def _same(gain: Gain) -> bool:
    """No digit of the gain, or of its uncertainty, would show."""
    unsure = gain.std if math.isfinite(gain.std) else 0.0
    return not gain.distinguishable and abs(gain.share) < 5e-4 and unsure < 5e-4


def _decimals(gain: Gain) -> int:
    return int(gain.std < 0.015 or (not math.isfinite(gain.std) and abs(gain.share) < 0.1))


def _at_least(length: float) -> str:
    """A length in mm; what three decimals cannot show is said to be less than the last of them."""
    return "less than 0.001 mm" if length < 5e-7 else FINE_LENGTH.text(length, unit=True)


def _mean_words(s: Summary) -> str:
    """Mean along the path against each yardstick, and what is shifted against it."""
    known = [g for g in s.gains if math.isfinite(g.share)]
    what = "mean deflection" if s.quantity == "deflection" else "mean compliance"
    parts = []
    for n, g in enumerate(known):
        sign, less = (1.0, "less") if g.share >= 0 else (-1.0, "more")
        if _same(g):
            parts.append(f"the same {what} as with {g.over}" if n == 0 else f"the same as with {g.over}")
            continue
        n_dec = _decimals(g)
        low, high = (round(v, n_dec) + 0.0 for v in sorted(100 * sign * v for v in g.interval))  # no −0.0
        interval = f" (90 %: {low:.{n_dec}f} to {high:.{n_dec}f} %)".replace("-", "−") if math.isfinite(low) else ""
        text = f"{gain_text(replace(g, share=sign * g.share))} {less} than with {g.over}{interval}"
        parts.append(f"{what} {text}" if n == 0 else text)
    words = [", ".join(parts)] if parts else []
    if s.shift is not None:
        words.append(
            f"the commanded path is shifted by up to {FINE_LENGTH.text(s.shift.worst, unit=True)} against the "
            f"predicted deflection, {_left_words(s.shift)}"
        )
    return "; ".join(words)


def _left_words(shift: Shift) -> str:
    """What a shift leaves: with its interval, where the model's own error is known, and never less than that."""
    if shift.left_mean90 is None or shift.left_worst90 is None or shift.removed90 is None:
        return f"which leaves {_at_least(shift.left_mean)} on average and {_at_least(shift.left_worst)} at worst"
    mean, worst = (f"{FINE_LENGTH.text(a)} to {_at_least(b)}" for a, b in (shift.left_mean90, shift.left_worst90))
    low, high = (100.0 * v for v in shift.removed90)
    return (
        f"which removes {low:.0f} to {high:.0f} % of it and leaves {mean} on average and {worst} at worst (90 %, by "
        "what is known of the stiffness)"
    ).replace("-", "−")


def _cautions(data: ReportData) -> tuple[str, ...]:
    s = data.summary
    out = [s.misfit] if s.misfit and s.outcome != "infeasible" else []
    gain = relative_gain(s.worst_default, s.worst_chosen)
    if s.outcome != "infeasible" and math.isfinite(gain):
        better = gain if WORDS[s.quantity].large_is_good else -gain
        if better <= 0:
            out.append("At the worst point there is no gain over the CAM's default rotation.")
    if s.outcome != "infeasible":
        out += [
            f"The gain over {g.over}, {gain_text(g)} on average, is below the stiffness model's own uncertainty "
            "or rounding: the two are not distinguishable."
            for g in s.gains
            if not g.distinguishable and not _same(g)
        ]
    if s.outcome != "infeasible" and s.infeasible_points:
        out.append(f"{counted(s.infeasible_points, 'point')} without an answer, left out of the motion.")
    unknown = [w for w in data.ignored if not w.understood]
    if unknown:
        names = ", ".join(w.word for w in unknown[:4]) + (" …" if len(unknown) > 4 else "")
        out.append(f"The CAM file holds words that were not understood: {names}.")
    if data.excluded_pairs:
        number = counted(len(data.excluded_pairs), "pair")
        out.append(f"{number} of bodies left out of the collision check, listed below with the reason.")
    out += [f"{w[0].upper()}{w[1:]}." for w in data.warnings if w.startswith(absolute_accuracy.KEY)]
    if data.warnings:
        out.append(f"{counted(len(data.warnings), 'warning')}, listed below.")
    return tuple(out)


def _joined(*sentences: str) -> str:
    return " ".join(filter(None, sentences))

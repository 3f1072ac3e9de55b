"""Law error: the gain that selected effects may leave because their laws are not exact.

A further effect counts only beyond it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.effect_locations import BASE, LINK, TOOL, parse_location
from machopt.effects.structure import as_built_joint_frames
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import FittedHypothesis
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    BODY,
    SENSOR,
    SelectedEffect,
    is_law_deviation,
)
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis

RELATIVE_UNITS = {"%": 0.01, "deg": np.pi / 180.0}  # relative size of a gain, of an angle
JOINTS_BEFORE_WRIST = 3  # number of joints before the wrist
LAST_LINK_OF_SIX = 5  # from this link on, links count as next to the tool


def compute_law_error(s: FittedHypothesis, chosen: Sequence[SelectedEffect], of_body: float = 0.0) -> float:
    """Compute the gain that the selected laws may leave because their form is not exact.

    Args:
        s: Further law.
        chosen: Selected effects, each fitted together with the others.
        of_body: Least relative model error of compliant bodies under weight.

    Returns:
        Gain that is not evidence for the further law.
    """

    def share(c: SelectedEffect) -> float:
        h = c.whitened.hypothesis
        if h.is_exact:
            return thresholds.SHARES.exact_law_error
        if h.is_approximate or _is_neighbour(h, s.whitened.hypothesis):
            return thresholds.SHARES.minority
        if h.family == SENSOR:
            return min(thresholds.SHARES.law_error, _compute_second_order_share(c))
        bends = h.family == BODY and not _is_behind_body(s.whitened.hypothesis, h)
        return max(thresholds.SHARES.law_error, of_body if bends else 0.0)

    def error(c: SelectedEffect) -> float:
        if not _is_neighbour(c.whitened.hypothesis, s.whitened.hypothesis):
            if c.law_error is not None:
                return c.law_error
            if has_law_deviation(c, chosen):
                return 0.0
        return c.scored.gain * share(c)

    return max((error(c) for c in chosen), default=0.0)


def has_law_deviation(c: SelectedEffect, chosen: Sequence[SelectedEffect]) -> bool:
    """Return whether the deviation of an effect from its law is among the selected forms.

    Args:
        c: Selected effect.
        chosen: All selected effects and forms.

    Returns:
        True if so; False for a deviation itself.
    """
    place = c.whitened.hypothesis.location
    return not is_law_deviation(c) and any(
        is_law_deviation(o) and o.whitened.hypothesis.location == place for o in chosen
    )


def _compute_second_order_share(c: SelectedEffect) -> float:
    """Return the remainder of a gain or axis-rotation column as a share of its power: the square of its size.

    A load cell with a gain error of 7 % has a large effect, but its linear law leaves only 0.5 %, less than laws of
    gears.
    """
    h, s = c.whitened.hypothesis, c.scored
    size = next(iter(h.quantities(s.x * c.whitened.unit[s.shape], c.whitened.shapes[s.shape]).values()))
    return float((size.value * RELATIVE_UNITS[size.unit]) ** 2) if size.unit in RELATIVE_UNITS else 1.0


def compute_body_error_share(tried: Sequence[WhitenedHypothesis]) -> float:
    """Return the least relative model error of compliant bodies in this channel.

    Args:
        tried: All whitened hypotheses.

    Returns:
        Share of the gain.
    """
    poses = any(t.hypothesis.effect == as_built_joint_frames.EFFECT.name for t in tried)
    return thresholds.SHARES.body_law_error if poses else 0.0


def _is_behind_body(a: EffectHypothesis, body: EffectHypothesis) -> bool:
    """Return whether a law acts at one of the first three joints behind a body, which rotate with the body's weight."""
    place, of = parse_location(a.location), parse_location(body.location)
    return place.is_joint_location and min(place.numbers, default=0) > max(
        n + 1 for n in (JOINTS_BEFORE_WRIST - 1, *of.numbers)
    )


def _is_neighbour(a: EffectHypothesis, b: EffectHypothesis) -> bool:
    """Return whether the remainder of one law resembles the other: the same place or an adjacent body."""
    if a.location == b.location:
        return True
    places = [parse_location(h.location) for h in (a, b)]
    links = [p.numbers[0] for p in places if p.kind == LINK]
    if len(links) == 2:
        return abs(links[0] - links[1]) <= 1
    kinds = {p.kind for p in places}
    return len(links) == 1 and (
        (kinds == {LINK, BASE} and links[0] == 1) or (kinds == {LINK, TOOL} and links[0] >= LAST_LINK_OF_SIX)
    )

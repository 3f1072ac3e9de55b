"""Refinement of shape parameters beyond the search grid: gear orders, speeds, displacements, and their intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape, ShapeRefinement
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    compute_gain_by_shape,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.numerics.array_types import Array

RATIO_POINTS = 6  # shapes between two grid neighbours
TWO_NUMBER_POINTS = 3  # points in each direction for two numbers
NARROWER = 5.0  # reduction of the search width if few shapes are equally likely
NARROW = 1e-3  # final search width relative to the grid spacing
MAX_LIKELY_SHAPES = 4
HALVINGS = 6  # bisection steps for an interval end
GAIN_ROUNDING = 1e-6  # relative difference of gains that counts as rounding
MAX_GAIN_ROUNDING = 0.01  # largest rounding difference, in residual variances
CUT_INTERVAL_NOTE = "the interval of its shape ends where no shape was tried beyond"


def build_ratio_refinement(grid: Sequence[Shape]) -> ShapeRefinement | None:
    """Build the refinement of one positive number, with equal ratios towards the grid neighbours and beyond the ends.

    Args:
        grid: Shapes of the search.

    Returns:
        The refinement; None if the grid is not of one positive number.
    """
    values = np.array(sorted({s[0] for s in grid})) if all(len(s) == 1 for s in grid) else np.zeros(0)
    if len(values) < 2 or values[0] <= 0.0:
        return None
    ratio = float(np.exp(np.diff(np.log(values)).max()))

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        part = shape[0] * ratio ** (share * np.linspace(-1.0, 1.0, 2 * RATIO_POINTS + 1))
        return tuple((float(v),) for v in part)

    return ShapeRefinement(shapes_around=about, search_range=(float(values[0]) / ratio, float(values[-1]) * ratio))


def build_two_number_refinement(grid: Sequence[Shape]) -> ShapeRefinement | None:
    """Build the refinement of two numbers on a full rectangular grid, up to the neighbours of each.

    Nothing is searched beyond the ends of the grid, where no reading determines a position or width.

    Args:
        grid: Shapes of the search.

    Returns:
        The refinement; None if the grid is not rectangular.
    """
    if len(grid) < 2 or any(len(s) != 2 for s in grid):
        return None
    each = [np.unique([s[n] for s in grid]) for n in range(2)]
    if any(len(values) < 2 for values in each) or len(each[0]) * len(each[1]) != len(set(grid)):
        return None
    steps = [float(np.diff(values).max()) for values in each]
    within = tuple((float(values[0]), float(values[-1])) for values in each)

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        way = share * np.linspace(-1.0, 1.0, 2 * TWO_NUMBER_POINTS + 1)
        sides = [np.clip(at + way * step, *ends) for at, step, ends in zip(shape, steps, within, strict=True)]
        return tuple((float(a), float(b)) for a in np.unique(sides[0]) for b in np.unique(sides[1]))

    return ShapeRefinement(shapes_around=about, search_ranges=within)


def refine_chosen_shapes(state: SearchState) -> SearchState:
    """Refine the shape of every selected law; equally likely shapes are stored with it.

    Args:
        state: State of the search.

    Returns:
        The state with refined laws.
    """
    chosen, laws = list(state.chosen), list(state.whitened_hypotheses)
    for k, c in enumerate(chosen):
        if c.whitened.hypothesis.refinement is None:
            continue
        model_without = add_selected_effects(state.base, [o for n, o in enumerate(chosen) if n != k])
        chosen[k] = refine_law_shape(state.base, model_without, c, c.whitened.hypothesis.refinement)
        laws[next(n for n, t in enumerate(laws) if t is c.whitened)] = chosen[k].whitened
    return replace(state, whitened_hypotheses=tuple(laws), chosen=tuple(chosen))


def refine_law_shape(
    base: WhitenedModel, model_without: WhitenedModel, c: SelectedEffect, finer: ShapeRefinement
) -> SelectedEffect:
    """Refine the shape of one law and determine all equally likely shapes.

    Args:
        base: Whitened base model.
        model_without: Model with the other selected effects.
        c: The effect.
        finer: Refinement of its shape.

    Returns:
        The refined effect.
    """
    h, best, share = c.whitened.hypothesis, c.whitened.shapes[c.scored.shape], 1.0
    seen: dict[Shape, float] = {}
    if finer.search_range is not None:
        seen.update(zip(c.whitened.shapes, compute_gain_by_shape(model_without, c.whitened).tolist(), strict=True))
        best = max(seen, key=lambda s: seen[s])
    grid = list(seen)

    def compute_gains(shapes: Sequence[Shape]) -> Array:
        found = whiten_hypotheses(base, [replace(h, shapes=tuple(shapes))])  # empty if no shape changes a reading
        gain = compute_gain_by_shape(model_without, found[0]) if found else np.zeros(len(shapes))
        seen.update(zip(shapes, gain.tolist(), strict=True))
        return gain

    def least(best_gain: float) -> float:
        """Gain from which on a shape is as likely."""
        rest = (model_without.rss - best_gain) / max(
            len(model_without.y) - model_without.count - c.whitened.X.shape[2], 1
        )
        return float(best_gain - compute_likelihood_margin(h) * max(rest, 1.0))

    while True:
        shapes = tuple(dict.fromkeys((best, *finer.shapes_around(best, share))))
        gain = compute_gains(shapes)
        near = [s for s, g in zip(shapes, gain.tolist(), strict=True) if g > least(float(gain.max()))]
        best = shapes[int(np.argmax(gain))]
        share /= NARROWER
        if _is_unambiguous(near, finer) or share < NARROW:
            break
    notes = [h.note]
    if len(best) == 1:
        beyond, cut = _extend_shape_range(compute_gains, seen, lambda: least(max(seen.values())), finer)
        near += [*grid, *beyond, *_find_interval_ends(compute_gains, seen, lambda: least(max(seen.values())))]
        notes += [CUT_INTERVAL_NOTE] if cut else []
    elif finer.search_ranges is not None:
        beyond, cut = _find_region_sides(compute_gains, seen, lambda: least(max(seen.values())), finer.search_ranges)
        near += [*seen, *beyond]
        notes += [CUT_INTERVAL_NOTE] if cut else []
    near = [s for s in dict.fromkeys(near) if seen[s] > least(max(seen.values()))]
    plain = [s for s in near if finer.is_preferred(s)]
    at = _select_middle_shape(plain or near, seen)
    notes.append(finer.describe_ambiguity(near))
    # intervals use the equally likely shapes only
    noted = replace(h, shapes=tuple(near), note="; ".join(n for n in notes if n))
    refined = replace(whiten_hypotheses(base, [noted])[0], index=c.whitened.index)
    own = score_hypotheses(model_without, whiten_hypotheses(base, [replace(h, shapes=(at,))]))[0]
    return replace(c, scored=replace(own, whitened=refined, shape=near.index(at)))


def _is_unambiguous(near: Sequence[Shape], finer: ShapeRefinement) -> bool:
    """Return whether few distinct shapes are equally likely; for several numbers for each of them."""
    if finer.search_ranges is None:
        return len(near) >= MAX_LIKELY_SHAPES
    return all(len({s[n] for s in near}) >= MAX_LIKELY_SHAPES - 1 for n in range(len(near[0])))


def compute_likelihood_margin(h: EffectHypothesis) -> float:
    """Compute the loss of gain within which another shape is equally likely, in residual variances.

    The position of a discontinuity has another distribution than a smooth parameter: ξ of max(2 W(s) − |s|) with
    probability (1 − exp(−ξ/2))² (Hansen, Econometrica 68 (2000) 575). At 95 % it is 7.35 instead of 3.84 of χ².

    Args:
        h: Hypothesis.

    Returns:
        Margin.
    """
    chi2 = thresholds.LEVELS.gain_two_sigma
    if not h.has_jumps:
        return chi2
    return float(-2.0 * np.log(1.0 - np.sqrt(1.0 - chdtrc(1.0, chi2))))


def _extend_shape_range(
    evaluate_shapes: Callable[[Sequence[Shape]], Array],
    seen: dict[Shape, float],
    least: Callable[[], float],
    finer: ShapeRefinement,
) -> tuple[list[Shape], bool]:
    """Extend the evaluated shapes by grid steps until they are no longer equally likely on both sides.

    Returns the shapes, and whether the last one at an end of the range is still equally likely.
    """
    if finer.search_range is None:
        return [], False
    out: list[Shape] = []
    cut = False
    for outermost, side in ((min, 0), (max, -1)):
        while seen[last := outermost(seen)] > least():
            at = (float(np.clip(finer.shapes_around(last, 1.0)[side][0], *finer.search_range)),)
            if outermost(at, last) == last:
                cut = True
                break
            evaluate_shapes([at])
            out.append(at)
    return out, cut


def _find_interval_ends(
    evaluate_shapes: Callable[[Sequence[Shape]], Array], seen: dict[Shape, float], least: Callable[[], float]
) -> list[Shape]:
    """Return the outermost equally likely shapes of one number by bisection.

    For a discontinuous law, all shapes between two of its steps are equivalent, and only the surroundings of the best
    one were evaluated.
    """
    for _ in range(HALVINGS):
        order = sorted(seen)
        good = [n for n, s in enumerate(order) if seen[s] > least()]
        pairs = [p for p in ((good[0] - 1, good[0]), (good[-1], good[-1] + 1)) if p[0] >= 0 and p[1] < len(order)]
        between_them = [(0.5 * (order[a][0] + order[b][0]),) for a, b in pairs]
        if not between_them:
            break
        evaluate_shapes(between_them)
    order = [s for s in sorted(seen) if seen[s] > least()]
    return [order[0], order[-1]]


def _find_region_sides(
    evaluate_shapes: Callable[[Sequence[Shape]], Array],
    seen: dict[Shape, float],
    least: Callable[[], float],
    within: tuple[tuple[float, float], ...],
) -> tuple[list[Shape], bool]:
    """Return the outermost equally likely shapes in each of two numbers, with the other number free.

    Also returns whether a shape at the end of the range is still equally likely.
    """
    out: list[Shape] = []
    cut = False
    for n in range(2):
        for side, end in zip((-1.0, 1.0), within[n], strict=True):
            likely = [s for s in seen if seen[s] > least()]
            last = max(likely, key=lambda s: side * s[n])
            step, wide = (max(float(np.ptp([s[k] for s in likely])), GAIN_ROUNDING) for k in (n, 1 - n))
            for _ in range(HALVINGS):
                if last[n] == end:
                    cut = True
                    break
                value = float(np.clip(last[n] + side * step, *within[n]))
                others = np.clip(last[1 - n] + wide * np.linspace(-0.5, 0.5, 2 * TWO_NUMBER_POINTS + 1), *within[1 - n])
                shapes = [(value, float(o)) if n == 0 else (float(o), value) for o in np.unique(others)]
                gain = evaluate_shapes(shapes)
                if gain.max() > least():
                    last = shapes[int(np.argmax(gain))]
                    out.append(last)
                else:
                    step /= 2.0
    return out, cut


def _select_middle_shape(shapes: Sequence[Shape], seen: Mapping[Shape, float]) -> Shape:
    """Return the most likely shape; among equivalent ones the middle one."""
    most = max(seen[s] for s in shapes)
    alike = sorted(s for s in shapes if seen[s] >= most - min(GAIN_ROUNDING * abs(most), MAX_GAIN_ROUNDING))
    return alike[len(alike) // 2]

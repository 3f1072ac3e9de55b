"""Shapes of what was chosen, settled more finely than the grid that was searched: an order, a speed, a path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, tried
from machopt.diagnose.nouns.problem import Finer, Hypothesis, Shape
from machopt.diagnose.search.screen import profile, score
from machopt.diagnose.search.select import Chosen, with_chosen
from machopt.diagnose.search.state import State

BETWEEN = 6  # shapes between one of a grid and its neighbour
BESIDE = 3  # of two numbers at once, to either side
NARROWER = 5.0  # times, where few of these are as likely as the best
NARROW = 1e-3  # of the way between neighbours
FEW = 4
HALVINGS = 6  # of the way from what is as likely to what is not
ALIKE = 1e-6  # of a gain: the same but for rounding
ALIKE_MOST = 0.01  # variances of a residual: as much of a very large gain is no rounding
CUT = "the interval of its shape ends where no shape was tried beyond"


def between(grid: Sequence[Shape]) -> Finer | None:
    """Of one positive number: in even ratios towards the neighbours of the grid, and as far beyond its ends."""
    values = np.array(sorted({s[0] for s in grid})) if all(len(s) == 1 for s in grid) else np.zeros(0)
    if len(values) < 2 or values[0] <= 0.0:
        return None
    ratio = float(np.exp(np.diff(np.log(values)).max()))

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        part = shape[0] * ratio ** (share * np.linspace(-1.0, 1.0, 2 * BETWEEN + 1))
        return tuple((float(v),) for v in part)

    return Finer(about=about, reach=(float(values[0]) / ratio, float(values[-1]) * ratio))


def beside_each_other(grid: Sequence[Shape]) -> Finer | None:
    """Of two numbers whose grid holds each of the first with each of the second: as far as to the next of either.

    Beyond the ends of the grid nothing is looked for: no reading is there that would tell a place or a width.
    """
    if len(grid) < 2 or any(len(s) != 2 for s in grid):
        return None
    each = [np.unique([s[n] for s in grid]) for n in range(2)]
    if any(len(values) < 2 for values in each) or len(each[0]) * len(each[1]) != len(set(grid)):
        return None
    steps = [float(np.diff(values).max()) for values in each]
    within = tuple((float(values[0]), float(values[-1])) for values in each)

    def about(shape: Shape, share: float) -> tuple[Shape, ...]:
        way = share * np.linspace(-1.0, 1.0, 2 * BESIDE + 1)
        sides = [np.clip(at + way * step, *ends) for at, step, ends in zip(shape, steps, within, strict=True)]
        return tuple((float(a), float(b)) for a in np.unique(sides[0]) for b in np.unique(sides[1]))

    return Finer(about=about, within=within)


def settled(state: State) -> State:
    """The state with every chosen law at its best shape between those of the grid, profiled shapes kept with it."""
    chosen, laws = list(state.chosen), list(state.tried)
    for k, c in enumerate(chosen):
        if c.tried.hypothesis.finer is None:
            continue
        beside = with_chosen(state.base, [o for n, o in enumerate(chosen) if n != k])
        chosen[k] = closest(state.base, beside, c, c.tried.hypothesis.finer)
        laws[next(n for n, t in enumerate(laws) if t is c.tried)] = chosen[k].tried
    return replace(state, tried=tuple(laws), chosen=tuple(chosen))


def closest(base: Model, beside: Model, c: Chosen, finer: Finer) -> Chosen:
    """A law at its best shape near the one it has, with all shapes that are as likely.

    Args:
        base: the base.
        beside: with what else was chosen.
        c: the law.
        finer: how its shapes are looked through.
    """
    h, best, share = c.tried.hypothesis, c.tried.shapes[c.scored.shape], 1.0
    seen: dict[Shape, float] = {}
    if finer.reach is not None:
        seen.update(zip(c.tried.shapes, profile(beside, c.tried).tolist(), strict=True))
        best = max(seen, key=lambda s: seen[s])
    grid = list(seen)

    def asked(shapes: Sequence[Shape]) -> Array:
        found = tried(base, [replace(h, shapes=tuple(shapes))])  # none where no shape moves a reading
        gain = profile(beside, found[0]) if found else np.zeros(len(shapes))
        seen.update(zip(shapes, gain.tolist(), strict=True))
        return gain

    def least(best_gain: float) -> float:
        """Gain from which on a shape is as likely."""
        rest = (beside.rss - best_gain) / max(len(beside.y) - beside.count - c.tried.X.shape[2], 1)
        return float(best_gain - worse(h) * max(rest, 1.0))

    while True:
        shapes = tuple(dict.fromkeys((best, *finer.about(best, share))))
        gain = asked(shapes)
        near = [s for s, g in zip(shapes, gain.tolist(), strict=True) if g > least(float(gain.max()))]
        best = shapes[int(np.argmax(gain))]
        share /= NARROWER
        if _told(near, finer) or share < NARROW:
            break
    notes = [h.note]
    if len(best) == 1:
        beyond, cut = _outwards(asked, seen, lambda: least(max(seen.values())), finer)
        near += [*grid, *beyond, *_ends(asked, seen, lambda: least(max(seen.values())))]
        notes += [CUT] if cut else []
    elif finer.within is not None:
        beyond, cut = _sides(asked, seen, lambda: least(max(seen.values())), finer.within)
        near += [*seen, *beyond]
        notes += [CUT] if cut else []
    near = [s for s in dict.fromkeys(near) if seen[s] > least(max(seen.values()))]
    plain = [s for s in near if finer.plain(s)]
    at = _middle(plain or near, seen)
    notes.append(finer.said(near))
    # intervals are taken over the shapes that are as likely: no other is asked for again
    noted = replace(h, shapes=tuple(near), note="; ".join(n for n in notes if n))
    kept = replace(tried(base, [noted])[0], index=c.tried.index)
    own = score(beside, tried(base, [replace(h, shapes=(at,))]))[0]
    return replace(c, scored=replace(own, tried=kept, shape=near.index(at)))


def _told(near: Sequence[Shape], finer: Finer) -> bool:
    """Whether few enough shapes are apart that are as likely: of several numbers, of each of them."""
    if finer.within is None:
        return len(near) >= FEW
    return all(len({s[n] for s in near}) >= FEW - 1 for n in range(len(near[0])))


def worse(h: Hypothesis) -> float:
    """Gain by which another shape of a law may be worse and is as likely all the same, in variances of a residual.

    Where a leap lies has another distribution than a slope: ξ of max(2 W(s) − |s|), (1 − exp(−ξ/2))² its chance
    (Hansen, Econometrica 68 (2000) 575). Of 95 %, 7.35 for χ²'s 3.84.
    """
    chi2 = calibrated.DETECTION.near_shape
    if not h.leaps:
        return chi2
    return float(-2.0 * np.log(1.0 - np.sqrt(1.0 - chdtrc(1.0, chi2))))


def _outwards(
    asked: Callable[[Sequence[Shape]], Array], seen: dict[Shape, float], least: Callable[[], float], finer: Finer
) -> tuple[list[Shape], bool]:
    """Shapes beyond those seen, a step of the grid at once, until one on either side is not as likely.

    Returns:
        the shapes; whether one is as likely still where the law's range ends.
    """
    if finer.reach is None:
        return [], False
    out: list[Shape] = []
    cut = False
    for outermost, side in ((min, 0), (max, -1)):
        while seen[last := outermost(seen)] > least():
            at = (float(np.clip(finer.about(last, 1.0)[side][0], *finer.reach)),)
            if outermost(at, last) == last:
                cut = True
                break
            asked([at])
            out.append(at)
    return out, cut


def _ends(
    asked: Callable[[Sequence[Shape]], Array], seen: dict[Shape, float], least: Callable[[], float]
) -> list[Shape]:
    """The outermost shapes of one number that are as likely, by halving the way to those beyond, which are not.

    Those near the best one may end well inside: where a law turns over at once, shapes between two of its steps are
    all alike, and of such a plain only what lies about its likeliest point was looked at.
    """
    for _ in range(HALVINGS):
        order = sorted(seen)
        good = [n for n, s in enumerate(order) if seen[s] > least()]
        pairs = [p for p in ((good[0] - 1, good[0]), (good[-1], good[-1] + 1)) if p[0] >= 0 and p[1] < len(order)]
        between_them = [(0.5 * (order[a][0] + order[b][0]),) for a, b in pairs]
        if not between_them:
            break
        asked(between_them)
    order = [s for s in sorted(seen) if seen[s] > least()]
    return [order[0], order[-1]]


def _sides(
    asked: Callable[[Sequence[Shape]], Array],
    seen: dict[Shape, float],
    least: Callable[[], float],
    within: tuple[tuple[float, float], ...],
) -> tuple[list[Shape], bool]:
    """The outermost shapes of two numbers that are as likely, to either side of each with the other free.

    Returns:
        the shapes; whether one is as likely still at an end of what is looked at.
    """
    out: list[Shape] = []
    cut = False
    for n in range(2):
        for side, end in zip((-1.0, 1.0), within[n], strict=True):
            likely = [s for s in seen if seen[s] > least()]
            last = max(likely, key=lambda s: side * s[n])
            step, wide = (max(float(np.ptp([s[k] for s in likely])), ALIKE) for k in (n, 1 - n))
            for _ in range(HALVINGS):
                if last[n] == end:
                    cut = True
                    break
                value = float(np.clip(last[n] + side * step, *within[n]))
                others = np.clip(last[1 - n] + wide * np.linspace(-0.5, 0.5, 2 * BESIDE + 1), *within[1 - n])
                shapes = [(value, float(o)) if n == 0 else (float(o), value) for o in np.unique(others)]
                gain = asked(shapes)
                if gain.max() > least():
                    last = shapes[int(np.argmax(gain))]
                    out.append(last)
                else:
                    step /= 2.0
    return out, cut


def _middle(shapes: Sequence[Shape], seen: Mapping[Shape, float]) -> Shape:
    """The likeliest of some shapes; where several are alike, one in their middle."""
    most = max(seen[s] for s in shapes)
    alike = sorted(s for s in shapes if seen[s] >= most - min(ALIKE * abs(most), ALIKE_MOST))
    return alike[len(alike) // 2]

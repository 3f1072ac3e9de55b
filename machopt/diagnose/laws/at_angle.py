"""Where the arm stands without any load, as measured poses see it: the laws of port angle of the registry.

Each is an extra angle Δ_j of one joint at encoder angles q, by its own angle or another joint's, lifted by J_j;
compensated in the exported joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.problem import Curve, Hypothesis, Shape
from machopt.diagnose.nouns.readings import Readings
from machopt.domain.location import joint_at, joints_of
from machopt.effects import registry, within
from machopt.effects.corrections import entry
from machopt.effects.kinematic import LOW_ORDERS, MOST_HIGH
from machopt.effects.protocol import DEGREE, Effect, Swept, Unloaded
from machopt.effects.waves import ARCSEC

FINE = 400  # points of a law's line over the range


def hypotheses(r: Readings) -> list[Hypothesis]:
    """Every law at every place that its effect is likely at, where these angles can show one."""
    out = []
    for effect in registry.of_angles():
        for where in effect.tried:
            by, _ = joints_of(where)
            for law in effect.unloaded:
                grid = law.grid(swept(r, by))
                if grid:
                    out.append(_hypothesis(r, effect, where, law, grid))
    return out


def finer_waves(r: Readings) -> list[Hypothesis]:
    """Laws of the same with the shapes that angles can show, but are too few for to try on noise.

    A gear's tooth order, or its overtone, may lie above one order for every few angles. So many shapes raise what
    chance alone would reach; where something is there that no other law takes, they may still be held against it.
    """
    out = []
    for effect in registry.of_angles():
        for where in effect.tried:
            by, _ = joints_of(where)
            own = swept(r, by)
            if own.most < LOW_ORDERS:
                continue  # not even the low orders have their angles
            for law in effect.unloaded:
                grid = _finer_grid(own, law)
                if grid:
                    out.append(_hypothesis(r, effect, where, law, grid))
    return out


def _finer_grid(own: Swept, law: Unloaded) -> tuple[Shape, ...]:
    """Shapes beyond those that are tried anyway: as many as where angles abound, and the whole orders among them."""
    known, many = law.grid(own), law.grid(replace(own, most=LOW_ORDERS + MOST_HIGH))
    highest = max((s[-1] for s in many if s), default=0.0)
    whole = tuple(s for s in law.grid(replace(own, sampled=True)) if s and s[-1] <= highest)
    return tuple(sorted({*many, *whole} - set(known)))


def swept(r: Readings, j: int) -> Swept:
    """What these angles of joint j (0-based) can show.

    One shape for every few distinct angles (``poses_per_order``). A balancer's torque has the first two orders of its
    joint's angle: there these are offered as that alone.
    """
    q = r.state.q[:, j]
    low, high = float(q.min()), float(q.max())
    distinct = len(np.unique(np.round(q, calibrated.RESTING.angle_decimals)))
    shown = high - low >= calibrated.RESTING.least_wave and distinct >= calibrated.RESTING.fewest_angles
    balanced = any(joint_at(j + 1) in e.places for e in registry.of_beside())
    most = int(distinct / calibrated.RESTING.poses_per_order) if shown else 0
    return Swept(low, high, most, calibrated.RESTING.above_balancer if balanced else 1.0)


def _hypothesis(r: Readings, effect: Effect, where: str, law: Unloaded, grid: tuple[Shape, ...]) -> Hypothesis:
    by, moved = joints_of(where)
    q = r.state.q[:, by]
    bare = hypothesis(effect, where, law, grid, q, lambda columns: r.lift(moved, columns), q)
    # a constant angle leaves nothing of itself: the rounds of the search are linear about what was found
    return replace(bare, penalty=law.penalty, held=law.prior, summed=law.summed, exact=effect.form == 0.0)


def hypothesis(
    effect: Effect,
    where: str,
    law: Unloaded,
    grid: tuple[Shape, ...],
    q: Array,
    lift: Callable[[Array], Array],
    read: Array,
) -> Hypothesis:
    """A law at a place.

    Args:
        effect, where, law, grid: of the law, and the shapes that are tried.
        q: (M,) rad by encoder of the joint that drives it.
        lift: (M, p) rad of the joint that is moved → (N, D, p) of the readings.
        read: (N,) rad the same angles by reading, for the picture.
    """
    by, _ = joints_of(where)
    over = {within.KEY: within.measured(q)} if law.ranged else {}

    def curve(x: Array, shape: Shape) -> Curve:
        at = np.linspace(q.min(), q.max(), FINE)
        line, each = (law.columns(np.array(shape), a) @ x / ARCSEC for a in (at, read))
        return Curve(
            x=at / DEGREE,
            law=line,
            x_label=f"joint {by + 1} in deg",
            y_label="angle in arcsec",
            data_x=read / DEGREE,
            per_reading=each,
        )

    return Hypothesis(
        effect=effect.called,
        location=where,
        law=law.name,
        equation=law.equation,
        columns=lambda s: lift(law.columns(np.array(s), q)),
        quantities=lambda x, s: law.sizes(x, np.array(s)),
        shapes=grid,
        correction=lambda x, s: entry(effect, where, x, np.array(s), over),
        family="kinematic",
        note=law.note,
        curve=curve if law.shape else None,
    )

"""Drift with time and temperature, as resting readings see it: each law of the registry, with what this arm is made of.

A load test counts from the unloaded state of its cycle: it shows what has moved since.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.nouns.readings import BEHIND, Readings
from machopt.effects import files, registry
from machopt.effects.protocol import DriftLaw, Effect, Warming
from machopt.se3 import moved_frame

FOREARM = (3, 4, 5, 6)  # bodies that one casting carries, and grow as one


def hypotheses(r: Readings) -> list[Hypothesis]:
    """The laws of every drift that the record can show."""
    seen = warming(r)
    laws = ((e, law, law.grid(seen)) for e in registry.of_drifts() for law in e.drifts)
    return [_hypothesis(seen, e, law, grid) for e, law, grid in laws if grid]


def _hypothesis(seen: Warming, effect: Effect, law: DriftLaw, grid: tuple[Shape, ...]) -> Hypothesis:
    lower = tuple(least for _, _, least in files.named(law, len(law.coefficients)))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape), seen)

    return Hypothesis(
        effect=effect.called,
        location=effect.places[0],
        law=law.name,
        equation=law.equation,
        columns=lambda shape: law.columns(np.array(shape), seen),
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        family="environment",
        note=effect.note,
        penalty=law.penalty,
    )


def warming(r: Readings) -> Warming:
    """What heat follows in these readings, and which way it moves the TCP."""
    temperature, time = r.recording.temperature, r.recording.time
    rise = None
    if temperature is not None and np.ptp(temperature) > 0.0 and not r.differences:  # unloaded states have none
        rise = temperature - temperature[r.order[0]]
    since, before = (None, None) if time is None else _since(r, time)
    return Warming(since=since, before=before, rise=rise, castings=growth(r), stand=stand(r), counted=r.differences)


def _since(r: Readings, time: Array) -> tuple[Array, Array | None]:
    """(N,) s since each session began, of the readings and of the states that they count from."""
    since, zero = np.zeros(len(r)), _unloaded(r, time) if r.differences else None
    for label in np.unique(r.session):
        rows = r.session == label
        start = time[rows].min() if zero is None else zero[rows].min()
        since[rows] = time[rows] - start
        if zero is not None:
            zero[rows] -= start
    return since, zero


def _unloaded(r: Readings, time: Array) -> Array:
    """(N,) s, when the unloaded state of each reading's cycle stood: as long before the first as readings are apart."""
    gaps = np.concatenate([np.diff(time[rows]) for rows in r.cycles])
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    out = np.zeros(len(r))
    for rows in r.cycles:
        own = np.diff(time[rows])
        out[rows] = time[rows[0]] - (float(np.median(own)) if len(own) else usual)
    return out


def growth(r: Readings) -> Array:
    """(N, D, 3) m per unit strain of the carousel, the upper arm, the forearm with the wrist."""
    assert r.state.R_bodies is not None  # readings come with bodies
    R = r.state.R_bodies
    points = [*r.robot.point, r.robot.T_base_flange_zero[:3, 3]]
    parts = []
    for group in ((1,), (2,), FOREARM):
        moved = np.zeros((len(r), 6))
        for i in group:
            moved[:, :3] += R[:, i] @ (points[i] - points[i - 1])
        parts.append(r.seen(moved, BEHIND))  # a link that grows turns nothing
    return np.stack(parts, axis=2)


def stand(r: Readings) -> Array:
    """(N, D, 6) shift in m and turn in rad of the stand about the middle of the points."""
    p = r.state.T_base_tool[:, :3, 3]
    return r.seen(moved_frame(p, p.mean(axis=0)), BEHIND)  # the tracker's: an inclinometer on the arm sees none of it

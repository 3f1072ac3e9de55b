"""Bodies that give way under what they bear, as resting readings see them: each law of the registry, at the TCP.

A load test cancels weight; a measured pose does not. What hangs on the far side of a spring acts on it with the
resultant of its weights and the recorded load. A wrench on the far side may be stated anywhere there, so at the TCP:
f = Σ m g + f_load, m = Σ (p_b − p_TCP) × m g + m_load. A link's own weight is spread along it, evenly from its root to
twice as far as its centre of mass.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.nouns.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.nouns.readings import BEHIND, Readings
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.protocol import BodyLaw, Effect
from machopt.model.terms.body import BodySpring, Place, placed, spring
from machopt.model.terms.compiled import body_of

NOTE = "out of what the joints' torques explain"
LAST = "link:6"  # one body with the tool, where it is sought
WEIGHT = ", w weight and load"


def hypotheses(r: Readings) -> list[Hypothesis]:
    """The laws of every body at every place."""
    out = []
    for effect in registry.of_bodies():
        for where in (p for p in effect.places if p != LAST):
            place = placed(r.robot, r.T_flange_tcp, where)
            load = borne(r, place)
            laws = [law for law in effect.gives if r.differences or law.weighs]
            shown = [law.seen(r.dimensions, turning=bool(r.wrench[:, 3:].any())) for law in laws]
            for law in {
                one.name: one for one in shown
            }.values():  # some are the same where moments or turning are missing
                grid = law.grid(place.shape)
                if grid:
                    out.append(_hypothesis(r, effect, place, law, load, grid))
    return out if r.differences else [h for h in out if np.abs(h.columns(h.shapes[0])).max() > 0.0]


def borne(r: Readings, place: Place) -> Array:
    """(N, 6) N, N·m at the TCP in base axes: recorded load and, of measured poses, the weight of all beyond."""
    if r.differences or r.masses is None:
        return r.wrench
    return r.wrench + weight_wrench(r, r.masses.body >= place.beyond)


def weight_wrench(r: Readings, carried: NDArray[np.bool_]) -> Array:
    """(N, 6) N, N·m at the TCP in base axes, of the weight of the bodies (B,) ``carried``."""
    if r.masses is None or not carried.any():
        return np.zeros((len(r), 6))
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    body, mass = r.masses.body[carried], r.masses.mass[carried]
    at = np.einsum("nbij,bj->nbi", r.state.R_bodies[:, body], r.masses.com[carried]) + r.state.p_bodies[:, body]
    force = mass[:, None] * r.masses.gravity
    moment = np.cross(at - r.state.T_base_tool[:, None, :3, 3], force)
    total = np.broadcast_to(force.sum(axis=0), (len(r), 3))
    return np.concatenate([total, moment.sum(axis=1)], axis=1)


def moved(r: Readings, term: Term) -> Array:
    """(N, D) m, rad, what a term of a body in stiffness.yaml makes of these readings."""
    made = body_of(term, r.robot, r.T_flange_tcp)
    return r.seen(_twist(r, made, borne(r, made.place)) @ made.values, first(made.place))


def first(place: Place) -> int:
    """The first body that moves where this one gives way; a link that bends moves itself (:meth:`Readings.seen`)."""
    return BEHIND if place.location == "tool" else place.body


def _twist(r: Readings, made: BodySpring, load: Array) -> Array:
    """(N, 6, P) m, rad at the TCP per unit of each coefficient."""
    out = made.response(r.state, load)
    own = [] if r.differences else _spread(r, made.place)
    sag = made.sag(r.state, own) if own else None
    return out if sag is None else out + sag


def _spread(r: Readings, place: Place) -> list[tuple[Array, float]]:
    """Each weight along a link (3,) N, and how far from its root it reaches."""
    if r.masses is None or place.beyond == place.body or not place.shape.length:
        return []
    x = place.shape.axes[:, 0]
    root = place.end - place.shape.length * x
    return [
        (r.masses.mass[b] * r.masses.gravity, 2.0 * float((r.masses.com[b] - root) @ x))
        for b in np.flatnonzero(r.masses.body == place.body)
    ]


def _hypothesis(
    r: Readings, effect: Effect, place: Place, law: BodyLaw, load: Array, grid: tuple[Shape, ...]
) -> Hypothesis:
    def made(values: Array, shape: Shape) -> BodySpring:
        return spring(effect.called, place, law, values, np.array(shape))

    count = len(law.coefficients)
    least = tuple(least for _, _, least in files.named(law, count))
    lower = least if law.bounded else ()

    def columns(shape: Shape) -> Array:
        return r.seen(_twist(r, made(np.zeros(count), shape), load), first(place))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape))

    return Hypothesis(
        effect=effect.called,
        location=place.location,
        law=law.name,
        equation=law.equation if r.differences else law.equation + WEIGHT,
        columns=columns,
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        correction=lambda x, shape: made(x, shape).to_file(),
        family="body",
        penalty=calibrated.DETECTION.simpler * len(law.shape),
        possible=None if np.isfinite(least).all() else law.nearest,
        note=law.note or (NOTE if r.differences else f"under weight, {NOTE}"),
    )

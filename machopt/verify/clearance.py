"""clearance_mm and nearest_pair of points.csv: is the stated distance the least of all pairs that count?

The column is the least distance over the pairs of :func:`machopt.verify.bodies.pairs`, at most 500 mm, 0 in contact,
but for those that one external joint lies between and that are as near wherever it stands (:func:`telling`).
The cutter counts against the workpiece only where a rapid move ends that no move at a feed follows: elsewhere it is
there to touch it. The named pair's distance is enclosed; of any other it need only be known that it is not nearer than
the claim, so a bound once found holds on while the bodies have not moved by what it exceeds the claim. Bounds are those
of :mod:`machopt.verify.between`; where they do not prove a claim, coal measures and decides.

The planner draws round bodies as circumscribed polyhedra (48 sides, 1,280 faces), up to 0.22 % of a cylinder's and 0.7
% of a sphere's radius larger: by so much a true distance may exceed the claim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify.arm import Arm
from machopt.verify.bodies import Body, bounds, distance, gap
from machopt.verify.contact import Scene

CAP = 0.5  # m, beyond which the planner does not measure
TOLERANCE = 5e-7  # m: four decimals of a mm, and six of the joints' degrees over a reach of metres
PLACES = 49  # of an external joint
UNCHANGED = 2e-6  # m, twice the planner's: what it leaves out by its own distances is left out here
CYLINDER, SPHERE = 0.0022, 0.0071  # of the radius, by which a circumscribed polyhedron is larger


@dataclass(frozen=True)
class Clearances:
    """By how much each claim is wrong, and by which pair; N rows."""

    short: Array  # (N,) m, some pair is nearer than claimed; 0 where none is
    beyond: Array  # (N,) m, the named pair is farther than claimed; NaN: there is no such pair
    pair: tuple[str, ...]  # (N,) what comes nearer than claimed, empty where nothing does


def telling(arm: Arm, wanted: list[tuple[Body, Body]]) -> list[tuple[Body, Body]]:
    """The pairs without those whose distance nothing changes, as of a carriage over its own bed.

    The planner answers the same question at the same places of the joint.
    """
    limits = arm.cell.limits
    x = np.linspace(limits.lower, limits.upper, PLACES)
    world = arm.placements(x[:, :6], x[:, 6:])

    def at(body: Body) -> Array:
        return world[:, body.carrier] if body.carrier >= 0 else np.broadcast_to(np.eye(4), world[:, 0].shape)

    def unchanging(a: Body, b: Body) -> bool:
        between = arm.moved_by(a.carrier) ^ arm.moved_by(b.carrier)
        if len(between) != 1 or not between <= arm.external:
            return False
        T = np.linalg.inv(at(a)) @ at(b)
        return as_near(a, b, T[[0, -1]]) and as_near(a, b, T)  # the ends tell most pairs at once

    return [(a, b) for a, b in wanted if not unchanging(a, b)]


def as_near(a: Body, b: Body, T: Array) -> bool:
    """Two bodies are as near at each T (S, 4, 4), within CAP and without touching."""
    d = np.array([distance(a, b, each) for each in T])
    return bool(d.min() > 0.0 and d.max() < CAP and np.ptp(d) < UNCHANGED)


def check_clearances(
    scene: Scene, wanted: list[tuple[Body, Body]], claim: Array, named: tuple[str, ...], may_cut: NDArray[np.bool_]
) -> Clearances:
    """Hold the claims against the scene's rows.

    Args:
        scene: bodies at the N configurations.
        wanted: the pairs that count.
        claim: (N,) m.
        named: (N,) the pair that the row names, ``a ~ b``; empty beyond CAP.
        may_cut: (N,) the cutter may be in the workpiece.
    """
    n = len(claim)
    short, beyond, who = np.zeros(n), np.zeros(n), [""] * n
    stated = _named(scene, claim, named, short, beyond, who)
    for a, b in wanted:
        T = scene.relative(a, b)
        asked = (gap(a, b, T) < claim - TOLERANCE) & (stated != _name(a, b))
        if b.kind == "grazing":
            asked &= ~may_cut
        if not asked.any():
            continue
        below, _ = bounds(a, b, T, np.flatnonzero(asked), scene.gone(a, b), claim - TOLERANCE)
        for k in np.flatnonzero(asked & (below < claim - TOLERANCE)):
            d = max(distance(a, b, T[k]), 0.0)
            if claim[k] - d > max(short[k], TOLERANCE):
                short[k], who[k] = claim[k] - d, _name(a, b)
    return Clearances(short, beyond, tuple(who))


def _named(
    scene: Scene, claim: Array, named: tuple[str, ...], short: Array, beyond: Array, who: list[str]
) -> NDArray[np.str_]:
    """Measure the pair each row names; (N,) the name where there is such a pair, else empty."""
    by_name = {_name(a, b): (a, b) for a, b in _moving_pairs(scene.bodies)}
    out = np.array([name if name in by_name else "" for name in named] or [""])
    none = np.array([not name for name in named])
    beyond[np.where(none, claim < CAP - TOLERANCE, out == "")] = np.nan
    for name in np.unique(out[out != ""]).tolist():
        a, b = by_name[name]
        T, rows = scene.relative(a, b), np.flatnonzero(out == name)
        below, above = bounds(a, b, T, rows)
        loose = TOLERANCE + _rounder(a) + _rounder(b)
        proven = (below >= claim - TOLERANCE) & (above <= claim + loose) & (above > 0.0)
        for k in rows[~proven[rows]]:
            d = max(distance(a, b, T[k]), 0.0)
            if claim[k] - d > TOLERANCE:
                short[k], who[k] = claim[k] - d, name
            elif d - claim[k] > loose:
                beyond[k] = d - claim[k]
    return out


def may_cut(toolpath: Toolpath) -> NDArray[np.bool_]:
    """(N,) False where a rapid move ends and the next one begins."""
    rapid = np.asarray(toolpath.move == Move.RAPID)
    starts = rapid.copy()
    starts[0] = True
    return np.asarray(~(starts & np.r_[rapid[1:], True]) | ~rapid)


def _name(a: Body, b: Body) -> str:
    return f"{a.name} ~ {b.name}"


def _rounder(body: Body) -> float:
    """m by which the planner's polyhedron is larger than a round body."""
    word = type(body.shape).__name__
    return (
        CYLINDER * body.shape.radius if word == "Cylinder" else SPHERE * body.shape.radius if word == "Sphere" else 0.0
    )


def _moving_pairs(bodies: list[Body]) -> list[tuple[Body, Body]]:
    """Any two bodies that move against each other, in either order; the full cutter against all but the part."""
    return [
        (a, b)
        for a in bodies
        for b in bodies
        if a is not b
        and a.carrier != b.carrier
        and ("grazing" in (a.kind, b.kind)) == ({a.kind, b.kind} <= {"workpiece", "grazing", "cutter"})
    ]

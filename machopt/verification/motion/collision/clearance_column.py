"""Check of clearance_mm and nearest_pair of points.csv: the stated distance is the least of all checked pairs.

The column is the least distance over the pairs of
:func:`machopt.verification.motion.collision.checked_pairs.list_checked_pairs`, at most 500 mm, 0 in contact. Pairs
whose distance is constant are left out (:func:`list_varying_pairs`). The cutter counts against the workpiece only
where a rapid move ends that no feed move follows. The named pair's distance is enclosed by bounds. Any other pair only
has to be not nearer than the claim; a bound stays valid until the bodies have moved by its excess over the claim.
Bounds are those of :mod:`machopt.verification.motion.collision.distance_bounds`. Where they do not prove a claim,
coal measures the distance. The planner models round bodies as circumscribed polyhedra (48 sides, 1,280 faces). Their
radius is up to 0.22 % (cylinder) or 0.7 % (sphere) larger. A true distance may exceed the claim by as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.collision.bodies import (
    CoalBody,
    bound_distances,
    bound_sphere_box_distance,
    compute_distance,
)
from machopt.verification.motion.collision.contact_search import PlacedBodies
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

MAX_DISTANCE_M = 0.5  # m, beyond which the planner does not measure
CLEARANCE_TOLERANCE_M = 5e-7  # m: four decimals of a mm, and six of the joints' degrees over a reach of metres
EXTERNAL_JOINT_SAMPLES = 49  # of a joint
CONSTANT_DISTANCE_M = (
    5.02e-4  # m, a little above the planner's: what it leaves out by its own distances is left out here
)
CYLINDER, SPHERE = 0.0022, 0.0071  # of the radius, by which a circumscribed polyhedron is larger


@dataclass(frozen=True)
class ClearanceErrors:
    """Error of each stated clearance, and the pair that causes it; N rows."""

    too_small: Array  # (N,) m, some pair is nearer than claimed; 0 where none is
    too_large: Array  # (N,) m, the named pair is farther than claimed; NaN: there is no such pair
    pair: tuple[str, ...]  # (N,) what comes nearer than claimed, empty where nothing does


def list_varying_pairs(arm: UrdfKinematics, wanted: list[tuple[CoalBody, CoalBody]]) -> list[tuple[CoalBody, CoalBody]]:
    """Return the pairs whose distance changes; a carriage on its own bed has a constant distance.

    The planner makes the same selection at the same positions of the joint.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        wanted: The candidate pairs.
    """
    limits = arm.cell.limits
    x = np.linspace(limits.lower, limits.upper, EXTERNAL_JOINT_SAMPLES)
    world = arm.compute_placements(x[:, :6], x[:, 6:])

    def at(body: CoalBody) -> Array:
        return world[:, body.carrier] if body.carrier >= 0 else np.broadcast_to(np.eye(4), world[:, 0].shape)

    def unchanging(a: CoalBody, b: CoalBody) -> bool:
        between = arm.list_moving_joints(a.carrier) ^ arm.list_moving_joints(b.carrier)
        if len(between) != 1:
            return False
        T = np.linalg.inv(at(a)) @ at(b)
        return is_distance_constant(a, b, np.roll(T, 1, axis=0))  # the two ends first: they tell most pairs

    return [(a, b) for a, b in wanted if not unchanging(a, b)]


def is_distance_constant(a: CoalBody, b: CoalBody, T: Array) -> bool:
    """Return whether two bodies have the same distance in all poses, below the maximum and without contact.

    Args:
        a: The first body.
        b: The second body.
        T: (S, 4, 4) poses of b's carrier in a's carrier.
    """
    least, most = np.inf, -np.inf
    for each in T:  # the first poses tell most pairs at once
        d = compute_distance(a, b, each)
        least, most = min(least, d), max(most, d)
        if not (least > 0.0 and most < MAX_DISTANCE_M and most - least < CONSTANT_DISTANCE_M):
            return False
    return True


def check_clearances(
    scene: PlacedBodies,
    wanted: list[tuple[CoalBody, CoalBody]],
    claim: Array,
    named: tuple[str, ...],
    may_cut: NDArray[np.bool_],
) -> ClearanceErrors:
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
    stated = _check_named_pairs(scene, claim, named, short, beyond, who)
    for a, b in wanted:
        T = scene.compute_relative_motion(a, b)
        is_doubtful = (bound_sphere_box_distance(a, b, T) < claim - CLEARANCE_TOLERANCE_M) & (
            stated != _format_pair_name(a, b)
        )
        if b.kind == "grazing":
            is_doubtful &= ~may_cut
        if not is_doubtful.any():
            continue
        below, _ = bound_distances(
            a, b, T, np.flatnonzero(is_doubtful), scene.compute_travelled_distance(a, b), claim - CLEARANCE_TOLERANCE_M
        )
        for k in np.flatnonzero(is_doubtful & (below < claim - CLEARANCE_TOLERANCE_M)):
            d = max(compute_distance(a, b, T[k]), 0.0)
            if claim[k] - d > max(short[k], CLEARANCE_TOLERANCE_M):
                short[k], who[k] = claim[k] - d, _format_pair_name(a, b)
    return ClearanceErrors(short, beyond, tuple(who))


def _check_named_pairs(
    scene: PlacedBodies, claim: Array, named: tuple[str, ...], short: Array, beyond: Array, who: list[str]
) -> NDArray[np.str_]:
    """Measure the pair each row names; (N,) the name where there is such a pair, else empty."""
    by_name = {_format_pair_name(a, b): (a, b) for a, b in _list_moving_pairs(scene.bodies)}
    out = np.array([name if name in by_name else "" for name in named] or [""])
    none = np.array([not name for name in named])
    beyond[np.where(none, claim < MAX_DISTANCE_M - CLEARANCE_TOLERANCE_M, out == "")] = np.nan
    for name in np.unique(out[out != ""]).tolist():
        a, b = by_name[name]
        T, rows = scene.compute_relative_motion(a, b), np.flatnonzero(out == name)
        below, above = bound_distances(a, b, T, rows)
        loose = CLEARANCE_TOLERANCE_M + _compute_polyhedron_excess(a) + _compute_polyhedron_excess(b)
        proven = (below >= claim - CLEARANCE_TOLERANCE_M) & (above <= claim + loose) & (above > 0.0)
        for k in rows[~proven[rows]]:
            d = max(compute_distance(a, b, T[k]), 0.0)
            if claim[k] - d > CLEARANCE_TOLERANCE_M:
                short[k], who[k] = claim[k] - d, name
            elif d - claim[k] > loose:
                beyond[k] = d - claim[k]
    return out


def find_cutting_points(toolpath: Toolpath) -> NDArray[np.bool_]:
    """Return (N,) False where a rapid move ends and the next one begins, else True.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    rapid = np.asarray(toolpath.move == MoveKind.RAPID)
    starts = rapid.copy()
    starts[0] = True
    return np.asarray(~(starts & np.r_[rapid[1:], True]) | ~rapid)


def _format_pair_name(a: CoalBody, b: CoalBody) -> str:
    return f"{a.name} ~ {b.name}"


def _compute_polyhedron_excess(body: CoalBody) -> float:
    """m by which the planner's polyhedron is larger than a round body."""
    word = type(body.shape).__name__
    return (
        CYLINDER * body.shape.radius if word == "Cylinder" else SPHERE * body.shape.radius if word == "Sphere" else 0.0
    )


def _list_moving_pairs(bodies: list[CoalBody]) -> list[tuple[CoalBody, CoalBody]]:
    """Any two bodies that move against each other, in either order; the full cutter against all but the part."""
    return [
        (a, b)
        for a in bodies
        for b in bodies
        if a is not b
        and a.carrier != b.carrier
        and ("grazing" in (a.kind, b.kind)) == ({a.kind, b.kind} <= {"workpiece", "grazing", "cutter"})
    ]

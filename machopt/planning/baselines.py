"""Baseline plans for the same path: the CAM default rotation and the method of jiao2022 (sections 3.2 and 4).

Both follow one configuration per run by continuity and do not use the global sequence search. The report compares
the plan with them; ``--method jiao2022`` plans with the second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.kinematics.inverse.solver import compute_branch_reasons
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.cost.stiffness_index import LoadDirections, compute_configuration_cost
from machopt.planning.sampling.joint_path import MARGINS, JointAssignment
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses
from machopt.stiffness.arm_stiffness import ArmElasticity

Ints = NDArray[np.int32]
STEP = np.radians(10.0)  # Δθ of eq. 26
LEAST_TILT = np.radians(30.0)  # minimum angle between tool axis and base z; below it the roll is undefined
JUMP = float(np.radians(60.0))  # a larger joint step between neighbouring points is a change of configuration

TURN = 2.0 * np.pi
OK, LIMIT, UNREACHABLE, NO_PATH = (
    int(r)
    for r in (
        InfeasibilityReason.OK,
        InfeasibilityReason.LIMIT,
        InfeasibilityReason.UNREACHABLE,
        InfeasibilityReason.NO_PATH,
    )
)


def plan_cam_default(path: PlanningPath, arm: PlanningArm, home: Array) -> JointAssignment:
    """Return the baseline with gamma = 0 at every point, in the configuration nearest to the previous one (home first).

    Args:
        path: planning points of the job.
        arm: arm model with its inverse kinematics, joint limits and margins.
        home: (6,) rad, configuration from which the first point is approached.

    Returns:
        Rotation, joints and infeasibility reason at each planning point.
    """
    return _follow(path, arm, _unwrap_rotation(path, -path.offset), home)


def plan_jiao2022(
    path: PlanningPath,
    arm: PlanningArm,
    elasticity: ArmElasticity,
    directions: LoadDirections,
    collision: CollisionModel | None,
    home: Array,
    options: PlanOptions,
) -> JointAssignment:
    """Return the baseline of jiao2022: best rotation in 10° steps at the key points, interpolated in between.

    Key points are the ends of each milling run, and the first and last hole of the drilling. Between
    them the roll ψ about the tool axis, measured against the base frame (eqs. 27–32), changes in proportion to
    the coordinate with the longest travel (eq. 34) for holes and to the index (eq. 35) for trajectories. Eq. 33
    prints φ_x = γ₁″ − γ_n″, which with eqs. 34–35 leads away from the end point. The sign that reaches
    the end point is used.

    Args:
        path: planning points of the job.
        arm: arm model with its inverse kinematics, joint limits and margins.
        elasticity: compliance model of the arm.
        directions: process force and its directions at each planning point.
        collision: collision model; None skips the collision check of the key points.
        home: (6,) rad, configuration from which the first key point is approached.
        options: rotation bounds and stiffness index.

    Returns:
        Rotation, joints and infeasibility reason at each planning point.
    """
    phi = np.full(len(path.index), np.nan)
    start = home
    for keys, rows, fraction in _group_key_points(path, arm):
        best, start = _find_best_rotations(path, arm, elasticity, directions, collision, keys, start, options)
        roll = _compute_roll(path, arm, rows)  # keys are the first and the last of rows
        psi = roll[[0, -1]] + best
        rotated = psi[0] + fraction * wrap_angle(psi[1] - psi[0])
        phi[rows] = rotated - roll
    for first, last in path.runs:  # plunges and approaches keep the rotation of their cutting point
        run = slice(first, last + 1)
        known = np.flatnonzero(np.isfinite(phi[run]))
        if len(known):
            between = 0.5 * (known[1:] + known[:-1])  # midpoints between known points
            phi[run] = phi[run][known[np.searchsorted(between, np.arange(last - first + 1))]]
        else:
            phi[run] = 0.0
    return _follow(path, arm, _unwrap_rotation(path, phi), home)


def _compute_roll(path: PlanningPath, arm: PlanningArm, rows: Ints) -> Array:
    """Return ψ at phi = 0 of ``rows``: the angle x of R = Rz Ry Rx about the tool axis (eq. 27; the paper's tool x is
    our z).

    Where a tool axis is nearly parallel to the base z axis, that angle is undefined (β = ±90°: a spindle pointing down,
    as in the paper's own Table 2) and changes rapidly. For such a group, the base axis farthest from all its tool axes
    replaces z.
    """
    R = arm.in_base(path.external[rows], compute_tcp_poses(path, rows, np.zeros(len(rows))))[:, :3, :3]
    across = np.linalg.norm(R[:, :, :2], axis=2).min(axis=0)  # (3,) sine between each base axis and the tool, at worst
    e = 2 if across[2] > np.sin(LEAST_TILT) else int(across.argmax())
    # paper's tool axes as ours: x = z (the rotation axis), y = x, z = y; for e = z this is R32 / R33 of eq. 27
    return np.arctan2(R[:, e, 0], R[:, e, 1])


def _group_key_points(path: PlanningPath, arm: PlanningArm) -> list[tuple[Ints, Ints, Array]]:
    """Return per group: the key points, the points between them, and the proportion (0…1) of each."""
    counted = path.counted
    position = arm.directions(path.external, path.position)
    groups, holes = [], []
    for first, last in path.runs:
        rows = (first + np.flatnonzero(counted[first : last + 1])).astype(np.int32)
        if not len(rows):
            continue
        if path.is_drilling[rows[0]]:
            holes.append(rows)
            continue
        groups.append((rows[[0, -1]], rows, np.arange(len(rows)) / max(len(rows) - 1, 1)))
    if holes:
        rows = np.concatenate(holes)
        keys = np.array([rows[0], rows[-1]], np.int32)
        way = np.abs(position[holes[-1][0]] - position[keys[0]])
        axis = int(way.argmax())
        hole = np.repeat([r[0] for r in holes], [len(r) for r in holes])  # the drill does not turn inside its hole
        along = np.abs(position[hole, axis] - position[keys[0], axis])
        groups.append((keys, rows, np.clip(along / max(way[axis], 1e-12), 0.0, 1.0)))
    return groups


def _find_best_rotations(
    path: PlanningPath,
    arm: PlanningArm,
    elasticity: ArmElasticity,
    directions: LoadDirections,
    collision: CollisionModel | None,
    keys: Ints,
    start: Array,
    options: PlanOptions,
) -> tuple[Array, Array]:
    """Apply steps 1–5 of section 3.2: the stiffest of the 10° rotations per key point, in the branch nearest to
    ``start``.
    """
    index = "jiao2022" if options.index == "auto" else options.index
    low, high = options.rotation_range
    grid = np.arange(-18, 18) * STEP
    q, why = _solve(path, arm, keys, np.broadcast_to(grid, (len(keys), len(grid))))
    gamma = wrap_angle(grid[None, :] + path.offset[keys][:, None])
    why[(gamma < low - 1e-9) | (gamma > high + 1e-9)] = InfeasibilityReason.BOUNDS
    ok = why == InfeasibilityReason.OK  # (K, R, B)
    distance = np.where(ok[0], np.abs(q[0] - start).max(axis=-1), np.inf).min(axis=0)  # (B,) nearest to start
    for b in np.argsort(distance, kind="stable"):
        if collision is not None:  # step 4: colliding configurations are removed
            for i in range(len(keys)):
                rotations = np.flatnonzero(ok[i, :, b])
                configurations = path.whole(q[i, rotations, b], np.full(len(rotations), keys[i]))
                ok[i, rotations, b] = ~collision.check_configurations(configurations, np.ones(len(rotations), bool)).hit
        if ok[:, :, b].any(axis=1).all():
            break
    else:
        return np.zeros(len(keys)), start
    best = np.zeros(len(keys))
    for i in range(len(keys)):
        usable = np.flatnonzero(ok[i, :, b])
        cost = compute_configuration_cost(elasticity, directions, np.full(len(usable), keys[i]), q[i, usable, b], index)
        best[i] = grid[usable[cost.argmin()]]
    return best, q[0, int(np.argmin(np.abs(grid - best[0]))), b]


def _solve(path: PlanningPath, arm: PlanningArm, rows: Ints, phi: Array) -> tuple[Array, NDArray[np.uint8]]:
    """All branches at rows × rotations with the turn nearest to zero that fits the limits: q (…, B, 6), reason."""
    poses = arm.in_base(path.external[rows], compute_tcp_poses(path, rows, phi)) @ invert_transform(arm.T_flange_tcp)
    branches = arm.solver.solve(poses.reshape(-1, 4, 4))
    why = compute_branch_reasons(branches, arm.margins).reshape(*phi.shape, -1)
    q = branches.q.reshape(*phi.shape, -1, 6)
    turned = q[..., None, :] + arm.turns  # zero first
    with np.errstate(invalid="ignore"):
        inside = ((turned >= arm.lower) & (turned <= arm.upper)).all(axis=-1)
    q = np.take_along_axis(turned, inside.argmax(axis=-1)[..., None, None], axis=-2)[..., 0, :]
    why[(why == InfeasibilityReason.OK) & ~inside.any(axis=-1)] = InfeasibilityReason.LIMIT
    return q, why


def _unwrap_rotation(path: PlanningPath, phi: Array) -> Array:
    out = np.array(phi)
    for first, last in path.runs:
        out[first : last + 1] = np.unwrap(out[first : last + 1])
    return out


def _follow(path: PlanningPath, arm: PlanningArm, phi: Array, home: Array) -> JointAssignment:
    """Select per point the feasible configuration nearest to the previous one; NaN where there is none."""
    every = np.arange(len(path.index), dtype=np.int32)
    poses = arm.in_base(path.external, compute_tcp_poses(path, every, phi)) @ invert_transform(arm.T_flange_tcp)
    branches = arm.solver.solve(poses)
    why = compute_branch_reasons(branches, arm.margins)
    P = len(every)
    starts = np.zeros(P, bool)
    starts[[first for first, _ in path.runs]] = True
    q, branch, reason = _find_nearest_to_last(branches.q, why, starts, arm.turns, arm.lower, arm.upper, home)
    rows = np.arange(P)
    margin = {n: np.where(branch >= 0, getattr(branches, n)[rows, branch], np.nan) for n in MARGINS}
    return JointAssignment(phi=phi, q=q, branch=branch, reason=reason, **margin)


@jit_compile
def _take_any_turn(
    solutions: Array,
    reasons: NDArray[np.uint8],
    turns: Array,
    lower: Array,
    upper: Array,
    near: Array,
    fits: NDArray[np.bool_],
) -> bool:
    """Fill ``near`` (B, 6) rad and ``fits`` (B,) with the first turn of each branch inside the limits; return whether
    there is one.
    """
    any_fits = False
    for b in range(len(solutions)):
        fits[b] = False
        for k in range(len(turns)):
            inside = reasons[b] == OK
            for c in range(6):
                x = solutions[b, c] + turns[k, c]
                inside = inside and lower[c] <= x <= upper[c]
            if inside:
                for c in range(6):
                    near[b, c] = solutions[b, c] + turns[k, c]
                fits[b] = any_fits = True
                break
    return any_fits


@jit_compile
def _find_nearest_to_last(
    solutions: Array,
    reasons: NDArray[np.uint8],
    starts: NDArray[np.bool_],
    turns: Array,
    lower: Array,
    upper: Array,
    home: Array,
) -> tuple[Array, Ints, NDArray[np.uint8]]:
    """Select per point the feasible configuration nearest to the previous one: q (P, 6), branch, and reason where none
    exists.

    Args:
        solutions: (P, B, 6) rad, all branches of a point, NaN where there is none.
        reasons: (P, B) infeasibility reason of each branch.
        starts: (P,) a rapid move ends here: any turn of the joints is accepted where the nearest one violates a limit.
        turns: (K, 6) rad, multiples of a full turn.
        lower: (6,) rad, lower joint limits.
        upper: (6,) rad, upper joint limits.
        home: (6,) rad, configuration before the first point.
    """
    count, branches = solutions.shape[0], solutions.shape[1]
    q, branch = np.full((count, 6), np.nan), np.full(count, -1, np.int32)
    reason = np.full(count, UNREACHABLE, np.uint8)
    last, near = home.copy(), np.empty((branches, 6))
    fits = np.zeros(branches, np.bool_)
    for p in range(count):
        any_fits = False
        for b in range(branches):
            fits[b] = reasons[p, b] == OK
            for c in range(6):
                near[b, c] = solutions[p, b, c] + TURN * np.round((last[c] - solutions[p, b, c]) / TURN)
                fits[b] = fits[b] and lower[c] <= near[b, c] <= upper[c]
            any_fits = any_fits or fits[b]
        if starts[p] and not any_fits:
            any_fits = _take_any_turn(solutions[p], reasons[p], turns, lower, upper, near, fits)
        if not any_fits:
            latest_reason, exists = 0, False
            for b in range(branches):
                latest_reason = max(latest_reason, reasons[p, b])
                exists = exists or reasons[p, b] != UNREACHABLE
            reason[p] = max(latest_reason, LIMIT) if exists else UNREACHABLE
            continue
        least, which = np.inf, 0
        for b in range(branches):
            if fits[b]:
                step = 0.0
                for c in range(6):
                    step = max(step, abs(near[b, c] - last[c]))
                if step < least:
                    least, which = step, b
        reason[p] = OK if starts[p] or least < JUMP else NO_PATH
        branch[p] = which
        for c in range(6):
            q[p, c] = last[c] = near[which, c]
    return q, branch, reason

"""Flange direction of the arm and workpiece placement for a new cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import (
    build_transform,
    compute_axis_rotation,
    compute_rpy_matrix,
    compute_tool_rotation,
    normalise_vectors,
)
from machopt.workspace_map.postures import POSE_BLOCK_SIZE, ReachingArm, compute_candidates

PostureFilter = Callable[[Array], bool]

_ROTATIONS = 12  # about the tool axis that are tried, every 30°
_MOST = 24  # points along the path by which places are compared, beside its extremes
_ALONG, _UP = np.linspace(0.35, 0.85, 6), np.linspace(-0.2, 0.6, 7)  # shares of the reach where the workpiece may lie
_ABOVE = (0.3, 0.2, 0.1)  # shares of the reach above the workpiece where home may be


_TRIED = 40  # positions that are checked for contacts, those with the most clearance first


def _accept_any_posture(_: Array) -> bool:
    return True


def find_flange_direction(robot: Robot) -> Array | None:
    """Find the direction along the last joint that leads out of the arm.

    It points from the point of its axis nearest to the axis before it (the wrist centre, where there is one) to the
    flange.

    Args:
        robot: Kinematics of the robot.

    Returns:
        Unit vector (3,) in the flange frame. None where the flange lies at that point, or both axes are parallel:
        the direction is then undetermined.
    """
    a5, a6, p5, p6 = robot.axis[-2], robot.axis[-1], robot.point[-2], robot.point[-1]
    n = np.cross(a5, a6)
    if n @ n < 1e-12:
        return None
    t = np.linalg.det(np.stack([p6 - p5, a5, n])) / (n @ n)  # of the point on axis 6 nearest to axis 5
    flange = robot.T_base_flange_zero
    along = float(a6 @ (flange[:3, 3] - (p6 + t * a6)))
    if abs(along) < 1e-4:  # m; no flange is that thin
        return None
    return np.asarray(normalise_vectors(np.sign(along) * flange[:3, :3].T @ a6))


NO_ROTATION = "the tool axis is that of the last joint, so the rotation has no effect: expected gain 0 %"
_ON_AXIS = (1e-3, 1e-3)  # m and rad by which a tool on the last joint's axis may miss it


def is_on_last_axis(robot: Robot, T_flange_tcp: Array) -> bool:
    """Return whether the tool axis is the axis of joint 6, which then performs every rotation about it alone.

    Args:
        robot: Kinematics of the robot.
        T_flange_tcp: Pose (4, 4) of the TCP in the flange frame, m.
    """
    T = robot.T_base_flange_zero @ T_flange_tcp
    axis, way = robot.axis[5], T[:3, 3] - robot.point[5]
    beside = float(np.linalg.norm(way - (way @ axis) * axis))
    return beside < _ON_AXIS[0] and float(np.linalg.norm(np.cross(axis, T[:3, 2]))) < _ON_AXIS[1]


def report_last_axis(robot: Robot, T_flange_tcp: Array) -> tuple[str, ...]:
    """Describe a tool whose axis is that of joint 6, so that rotations about it have no effect.

    Args:
        robot: Kinematics of the robot.
        T_flange_tcp: Pose (4, 4) of the TCP in the flange frame, m.

    Returns:
        One sentence, or none.
    """
    if not is_on_last_axis(robot, T_flange_tcp):
        return ()
    return (f"{NO_ROTATION}; --tool-angle-deg 45, or the tool's own --tcp-mm and --tcp-rpy-deg, would work",)


def compute_pointing_rpy(direction: Array) -> Array:
    """Compute a frame whose z axis has a direction, with the smallest rotation.

    Args:
        direction: Direction (3,), unit vector.

    Returns:
        Roll, pitch and yaw (3,), rad.
    """
    z = normalise_vectors(np.asarray(direction, float))
    axis = np.cross([0.0, 0.0, 1.0], z)
    size = float(np.linalg.norm(axis))
    turn = np.arctan2(size, z[2])
    R = compute_axis_rotation(axis / size if size > 1e-12 else np.array([0.0, 1.0, 0.0]), np.asarray(turn))
    pitch = np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))
    if abs(R[2, 0]) > 1 - 1e-12:  # roll and yaw turn about the same line
        return np.array([0.0, pitch, np.arctan2(-R[0, 1], R[1, 1])])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def build_sample_path(reach: float) -> tuple[Array, Array]:
    """Build sample points for a cell without a toolpath: corners of a block with perpendicular tools.

    Args:
        reach: Reach of the arm, m.

    Returns:
        Corners (8, 3) around its centre in m, and tool axes (8, 3).
    """
    edge = 0.12 * reach * np.array([1.0, 1.0, 0.5])
    corners = np.stack(np.meshgrid(*([[-0.5, 0.5]] * 3), indexing="ij"), axis=-1).reshape(-1, 3) * edge
    return corners, np.broadcast_to([0.0, 0.0, 1.0], corners.shape).copy()


@dataclass(frozen=True)
class WorkpiecePlace:
    """Where the workpiece lies and the arm waits."""

    T_base_workpiece: Array  # (4, 4), axes those of base_link, in which the path was given
    home: Array  # (6,) rad
    margin: float  # rad, least distance to a joint limit, a bent wrist or a bent elbow, over all checked points
    share: float  # of the path's points that the branch reaches there, each at a rotation of its own; 1.0: all
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # deg, roll, pitch and yaw of the workpiece for it


@dataclass(frozen=True)
class _BranchTrial:
    """One branch at one place, each point of the sample at one rotation."""

    smallest_margin: float  # rad
    shift: Array  # (3,) m
    branch: int
    poses: Array  # (P, 4, 4) T_base_tcp
    q: Array  # (P, 6) rad


def find_place(
    arm: ReachingArm, position: Array, axis: Array, reach: float, free: PostureFilter = _accept_any_posture
) -> WorkpiecePlace | None:
    """A place of the workpiece where one branch reaches all of a path, far from limits and from a stretched wrist.

    Places are compared by few points of the path; the result is checked against all of them.

    Args:
        arm: kinematics, limits and margins.
        position: (N, 3) m, of the tool tip in the workpiece frame.
        axis: (N, 3) unit, tip to shank.
        reach: m, of the arm.
        free: whether postures (K, 6) rad touch nothing; called for the path and for home.

    Returns:
        Of the places before the arm, the one with the most room of those where the branch reaches every point; where
        none does, the one where it reaches most; None where even few points are too much, or home has no room.
    """
    far = _find_farthest_points(position)  # where one of these is out of reach the others need not be checked
    some = np.unique(np.concatenate([_select_sample_points(position, axis), far]))
    middle = (position.min(axis=0) + position.max(axis=0)) / 2.0
    R, R_far = _list_turned_rotations(axis[some]), _list_turned_rotations(axis[far])
    tries: list[_BranchTrial] = []
    for along in _ALONG:
        for up in _UP:
            shift = np.array([along * reach, 0.0, up * reach]) - middle
            if _list_branch_trials(arm, R_far, position[far] + shift, shift):
                tries += _list_branch_trials(arm, R, position[some] + shift, shift)
    best: WorkpiecePlace | None = None
    for one in sorted(tries, key=lambda t: -t.smallest_margin)[:_TRIED]:
        if not free(one.q):
            continue
        home = _find_pose_above(arm, one.poses, one.branch, reach, free)
        if home is None:
            continue
        share = _compute_reached_share(arm, position + one.shift, axis, one.branch)
        if best is None or share > best.share:
            best = WorkpiecePlace(build_transform(np.eye(3), one.shift), home, one.smallest_margin, share)
        if best.share == 1.0:
            break
    return best


def find_place_or_middle(
    arm: ReachingArm,
    position: Array,
    axis: Array,
    reach: float,
    free: PostureFilter = _accept_any_posture,
    *,
    turns: Sequence[tuple[float, float, float]] = ((0.0, 0.0, 0.0),),
) -> WorkpiecePlace | None:
    """:func:`find_place`; where there is none, a block of the arm's size in the path's middle is placed instead.

    Args:
        arm, position, axis, reach, free: as there.
        turns: deg, roll, pitch and yaw in the base by which the workpiece may be turned: the first that brings all in
            reach.

    Returns:
        With ``share`` 0.0 where only that block is reached; None where nothing is.
    """
    best: WorkpiecePlace | None = None
    for turn in turns:
        R = compute_rpy_matrix(np.radians(turn))
        found = find_place(arm, position @ R.T, axis @ R.T, reach, free)
        if found is not None and (best is None or found.share > best.share):
            best = replace(found, T_base_workpiece=found.T_base_workpiece @ build_transform(R, np.zeros(3)), turn=turn)
        if best is not None and best.share == 1.0:
            return best
    if best is not None:
        return best
    block, upright = build_sample_path(reach)
    middle = find_place(arm, block + (position.min(axis=0) + position.max(axis=0)) / 2.0, upright, reach, free)
    return None if middle is None else replace(middle, share=0.0)


def _find_farthest_points(position: Array) -> NDArray[np.intp]:
    """(P,) indices of the points farthest out in each direction."""
    return np.unique([int(np.argmax(way * position[:, k])) for k in range(3) for way in (-1.0, 1.0)])


def _select_sample_points(position: Array, axis: Array) -> NDArray[np.intp]:
    """(P,) indices: evenly along the path, and where it and its tool go farthest in each direction."""
    n = len(position)
    even = np.linspace(0, n - 1, min(_MOST, n)).round().astype(np.intp)
    far = [np.argmax(way * of[:, k]) for of in (position, axis) for k in range(3) for way in (-1.0, 1.0)]
    return np.unique(np.concatenate([even, np.array(far, np.intp)]))


def _list_turned_rotations(axis: Array) -> Array:
    """(P, R, 3, 3) rotations of the TCP for axes (P, 3), every 30° about them."""
    gamma = np.arange(_ROTATIONS) * (2 * np.pi / _ROTATIONS)
    reference = np.where(np.abs(axis[:, :1]) > 1 - 1e-6, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    return compute_tool_rotation(axis[:, None], reference[:, None], np.broadcast_to(gamma, (len(axis), len(gamma))))


def _list_branch_trials(arm: ReachingArm, R: Array, position: Array, shift: Array) -> list[_BranchTrial]:
    """What each branch can do there: at one rotation for all points if there is one, else each point at its best."""
    points, rotations = R.shape[:2]
    T = build_transform(R, np.repeat(position[:, None], rotations, axis=1))
    found = compute_candidates(arm, T)
    q = found.q.reshape(points, rotations, -1, 6)
    limits = np.minimum(q - arm.lower, arm.upper - q).min(axis=-1)
    room = np.minimum(limits, found.singularity_margin.reshape(limits.shape))  # (P, R, B), NaN where there is none
    made, at = [], np.arange(points)
    for b in range(room.shape[2]):
        least = np.nan_to_num(room[:, :, b], nan=-np.inf)
        turn = np.full(points, least.min(axis=0).argmax())
        if not np.isfinite(least[at, turn]).all():
            turn = least.argmax(axis=1)
        if np.isfinite(least[at, turn]).all():
            made.append(_BranchTrial(float(least[at, turn].min()), shift, b, T[at, turn], q[at, turn, b]))
    return made


def _compute_reached_share(arm: ReachingArm, position: Array, axis: Array, branch: int) -> float:
    """Share of the points (N, 3) m in base_link that a branch reaches at one rotation at least."""
    rows, reached = POSE_BLOCK_SIZE // _ROTATIONS, 0
    for a in range(0, len(position), rows):
        R = _list_turned_rotations(axis[a : a + rows])
        T = build_transform(R, np.repeat(position[a : a + rows, None], _ROTATIONS, axis=1))
        ok = compute_candidates(arm, T).reason[:, branch].reshape(-1, _ROTATIONS) == InfeasibilityReason.OK
        reached += int(ok.any(axis=1).sum())
    return reached / len(position)


def _find_pose_above(arm: ReachingArm, T: Array, branch: int, reach: float, free: PostureFilter) -> Array | None:
    """(6,) rad with the tool above the path (N, 4, 4), as high as that branch reaches; None where it does not."""
    centre = T[len(T) // 2].copy()
    top = T[:, 2, 3].max()
    for up in _ABOVE:
        centre[2, 3] = top + up * reach
        found = compute_candidates(arm, centre[None, None])
        if found.reason[0, branch] == InfeasibilityReason.OK and free(found.q[:1, branch]):
            return np.asarray(found.q[0, branch])
    return None

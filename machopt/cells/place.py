"""What a new cell needs to know of its arm: which way the flange looks, and where a workpiece can lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.domain.reason import Reason
from machopt.model.robot import Robot
from machopt.se3 import axis_rotation, normalise, tool_rotation, transform
from machopt.workspace.postures import Arm, candidates

Free = Callable[[Array], bool]

_ROTATIONS = 12  # about the tool axis that are tried, every 30°
_MOST = 24  # points of the path that are looked at
_ALONG, _UP = np.linspace(0.35, 0.85, 6), np.linspace(-0.2, 0.6, 7)  # shares of the reach where the workpiece may lie
_ABOVE = (0.3, 0.2, 0.1)  # shares of the reach above the workpiece where home may be


_TRIED = 40  # places that are looked at for contacts, those with the most room first


def _any_will_do(_: Array) -> bool:
    return True


def outward(robot: Robot) -> Array | None:
    """The direction along joint 6 that leads out of the arm, (3,) unit in the flange frame.

    It points from the place on axis 6 nearest to axis 5 (the wrist's centre, where the wrist has one) to the flange.

    Returns:
        None where the flange stands at that place, or both axes are parallel: the arm does not tell then.
    """
    a5, a6, p5, p6 = robot.axis[4], robot.axis[5], robot.point[4], robot.point[5]
    n = np.cross(a5, a6)
    if n @ n < 1e-12:
        return None
    t = np.linalg.det(np.stack([p6 - p5, a5, n])) / (n @ n)  # of the point on axis 6 nearest to axis 5
    flange = robot.T_base_flange_zero
    along = float(a6 @ (flange[:3, 3] - (p6 + t * a6)))
    if abs(along) < 1e-4:  # m; no flange is that thin
        return None
    return np.asarray(normalise(np.sign(along) * flange[:3, :3].T @ a6))


def pointing(direction: Array) -> Array:
    """(3,) rad, roll, pitch and yaw of a frame whose z has this direction (3,), turned no further than that needs."""
    z = normalise(np.asarray(direction, float))
    axis = np.cross([0.0, 0.0, 1.0], z)
    size = float(np.linalg.norm(axis))
    turn = np.arctan2(size, z[2])
    R = axis_rotation(axis / size if size > 1e-12 else np.array([0.0, 1.0, 0.0]), np.asarray(turn))
    pitch = np.arcsin(np.clip(-R[2, 0], -1.0, 1.0))
    if abs(R[2, 0]) > 1 - 1e-12:  # roll and yaw turn about the same line
        return np.array([0.0, pitch, np.arctan2(-R[0, 1], R[1, 1])])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def sample_path(reach: float) -> tuple[Array, Array]:
    """Where no path is given: corners of a block, (8, 3) m around its middle, and tools that stand on it, (8, 3)."""
    edge = 0.12 * reach * np.array([1.0, 1.0, 0.5])
    corners = np.stack(np.meshgrid(*([[-0.5, 0.5]] * 3), indexing="ij"), axis=-1).reshape(-1, 3) * edge
    return corners, np.broadcast_to([0.0, 0.0, 1.0], corners.shape).copy()


@dataclass(frozen=True)
class Place:
    """Where the workpiece lies and the arm waits."""

    T_base_workpiece: Array  # (4, 4), axes those of base_link, in which the path was given
    home: Array  # (6,) rad
    margin: float  # rad, of the joint that comes nearest to its limit over all points looked at


def find_place(arm: Arm, position: Array, axis: Array, reach: float, free: Free = _any_will_do) -> Place | None:
    """A place of the workpiece where one branch reaches all of a path at one rotation, far from limits.

    Args:
        arm: kinematics, limits and margins.
        position: (N, 3) m, of the tool tip in the workpiece frame.
        axis: (N, 3) unit, tip to shank.
        reach: m, of the arm.
        free: whether postures (K, 6) rad touch nothing; asked of the path and of home.

    Returns:
        Of the places before the arm, the one with the most room to the joint limits; None where none will do.
    """
    some = np.unique(np.linspace(0, len(position) - 1, min(_MOST, len(position))).round().astype(int))
    middle = (position.min(axis=0) + position.max(axis=0)) / 2.0
    reference = np.where(np.abs(axis[some, :1]) > 1 - 1e-6, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    gamma = np.arange(_ROTATIONS) * (2 * np.pi / _ROTATIONS)
    R = tool_rotation(axis[some, None], reference[:, None], np.broadcast_to(gamma, (len(some), _ROTATIONS)))
    found: list[tuple[float, Array, Array, int, Array]] = []  # room, shift, poses, branch, postures
    for along in _ALONG:
        for up in _UP:
            shift = np.array([along * reach, 0.0, up * reach]) - middle
            T = transform(R, np.repeat((position[some] + shift)[:, None], _ROTATIONS, axis=1))
            q = candidates(arm, T).q.reshape(len(some), _ROTATIONS, -1, 6)
            room = np.minimum(q - arm.lower, arm.upper - q).min(axis=-1).min(axis=0)  # (R, B), NaN where one is missing
            for b in np.flatnonzero(np.isfinite(room).any(axis=0)).tolist():
                r = int(np.nanargmax(room[:, b]))
                found.append((float(room[r, b]), shift, T[:, r], b, q[:, r, b]))
    for room_left, shift, T, b, q in sorted(found, key=lambda f: -f[0])[:_TRIED]:
        if not free(q):
            continue
        home = _above(arm, T, b, reach, free)
        if home is not None:
            return Place(transform(np.eye(3), shift), home, room_left)
    return None


def _above(arm: Arm, T: Array, branch: int, reach: float, free: Free) -> Array | None:
    """(6,) rad with the tool above the path (N, 4, 4), as high as that branch reaches; None where it does not."""
    centre = T[len(T) // 2].copy()
    top = T[:, 2, 3].max()
    for up in _ABOVE:
        centre[2, 3] = top + up * reach
        found = candidates(arm, centre[None, None])
        if found.reason[0, branch] == Reason.OK and free(found.q[:1, branch]):
            return np.asarray(found.q[0, branch])
    return None

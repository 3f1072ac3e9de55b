"""Joint positions at every planning point from a rotation curve, with the reason where that fails."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.inverse.solver import compute_branch_reasons, refine_by_newton
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.numerics.rigid_transforms import invert_transform, wrap_angle
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

CONVERGED = 1e-9  # m and rad, accuracy of every exported configuration
MARGINS = ("shoulder", "elbow", "wrist")
ROWS = 4096  # rows per block: their matrices fit a core's cache
SAME_POSE = 1e-4  # rad: a branch farther than this from the configuration is another one
SAME_BRANCH = np.radians(30.0)  # a Newton step that ends farther from its seed has left the branch


@dataclass(frozen=True, kw_only=True)
class JointAssignment:
    """One configuration per planning point."""

    phi: Array  # (P,) rad about the transported reference, continuous inside each run
    q: Array  # (P, 6) rad, NaN where there is none
    branch: NDArray[np.int32]  # (P,) index of the solver's branch, −1 where there is none
    reason: NDArray[np.uint8]  # (P,) Reason
    shoulder: Array  # (P,) m, margins to the singularities
    elbow: Array  # (P,) rad
    wrist: Array  # (P,) rad

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def marked(self, rows: NDArray[np.bool_], why: InfeasibilityReason | NDArray[np.uint8]) -> JointAssignment:
        """Return the same assignment with another reason at some rows.

        Args:
            rows: (P,) mask of the rows.
            why: the reason, or (P,) reasons.
        """
        return replace(self, reason=np.where(rows, why, self.reason).astype(np.uint8))


def solve_joint_path(path: PlanningPath, arm: PlanningArm, robot: Robot, phi: Array, seed: Array) -> JointAssignment:
    """Solve for the exact poses near a seed; rows with a NaN seed have no configuration.

    Args:
        path: planning points.
        arm: arm model with its limits and margins.
        robot: kinematic model.
        phi: (P,) rad, rotation.
        seed: (P, 6) rad.
    """
    P = len(path.index)
    out: dict[str, NDArray[Any]] = {
        "q": np.full((P, 6), np.nan),
        "branch": np.full(P, -1, np.int32),
        "reason": np.full(P, InfeasibilityReason.NO_PATH, np.uint8),
        **{margin: np.full(P, np.nan) for margin in MARGINS},
    }
    known = np.flatnonzero(np.isfinite(seed).all(axis=1) & np.isfinite(phi))
    for first in range(0, len(known), ROWS):
        rows = known[first : first + ROWS]
        good, solved, bad = _solve_rows(path, arm, robot, rows, phi, seed)
        out["reason"][bad] = InfeasibilityReason.UNREACHABLE
        for name, values in solved.items():
            out[name][good] = values
    return JointAssignment(phi=phi, **out)


def _solve_rows(
    path: PlanningPath, arm: PlanningArm, robot: Robot, known: NDArray[np.intp], phi: Array, seed: Array
) -> tuple[NDArray[np.intp], dict[str, NDArray[Any]], NDArray[np.intp]]:
    """Return, of some rows (n,), those with a pose with the data of their assignment, and those without."""
    poses = arm.in_base(path.external[known], compute_tcp_poses(path, known.astype(np.int32), phi[known]))
    q, error = refine_by_newton(robot, poses, seed[known], arm.T_flange_tcp, iterations=5)
    bad = (error > CONVERGED) | (np.abs(q - seed[known]).max(axis=1) > SAME_BRANCH)
    good, q = known[~bad], q[~bad]
    flange = poses[~bad] @ invert_transform(arm.T_flange_tcp)
    branches = arm.solver.solve(flange)
    distance = np.abs(wrap_angle(branches.q - q[:, None])).max(axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    b = distance.argmin(axis=1)
    rows = np.arange(len(good))
    why = compute_branch_reasons(branches, arm.margins)[rows, b]
    margins = {name: getattr(branches, name)[rows, b] for name in MARGINS}
    missed = np.flatnonzero(distance[rows, b] > SAME_POSE)
    known_ones = arm.solver.compute_margins(flange[missed], q[missed]) if len(missed) else None
    if known_ones is not None:
        why[missed] = compute_branch_reasons(known_ones, arm.margins)[:, 0]
        for name in MARGINS:
            margins[name][missed] = getattr(known_ones, name)[:, 0]
    inside = ((q >= arm.lower) & (q <= arm.upper)).all(axis=1)
    why[(why == InfeasibilityReason.OK) & ~inside] = InfeasibilityReason.LIMIT
    if arm.stability is not None:
        fine = np.flatnonzero(why == InfeasibilityReason.OK)
        is_unstable = arm.stability.find_violations(arm, path, good[fine], q[fine])
        why[fine[is_unstable]] = InfeasibilityReason.UNSTABLE
    return good, {"q": q, "branch": b, "reason": why, **margins}, known[bad]


def interpolate_between_stations(path: PlanningPath, values: Array) -> Array:
    """Return values at all planning points, interpolated linearly in path length inside each run.

    Args:
        path: planning points.
        values: (S, …) values at the stations.
    """
    st = path.stations
    out = np.full((len(path.index), *values.shape[1:]), np.nan)
    flat = values.reshape(len(st), -1)
    target = out.reshape(len(path.index), -1)
    position = np.searchsorted(st, np.arange(len(path.index)))  # the station at or after each point
    for first, last in path.runs:
        a, b = position[first], position[last]
        rows = slice(first, last + 1)
        for c in range(flat.shape[1]):
            # equal lengths (duplicate points) are legal: np.interp takes the later value there
            target[rows, c] = np.interp(path.s[rows], path.s[st[a : b + 1]], flat[a : b + 1, c])
    target[st] = flat
    return out

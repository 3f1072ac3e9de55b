"""From a rotation curve to joint positions at every planning point, with the reason where that fails."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, held
from machopt.domain.reason import Reason
from machopt.model.ik import branch_reasons, refine
from machopt.model.robot import Robot
from machopt.plan.configurations.candidates import PlanningArm
from machopt.plan.stations.path import Path, tcp_poses
from machopt.se3 import inverse, wrap

CONVERGED = 1e-9  # m and rad, the accuracy every exported configuration is held to
MARGINS = ("shoulder", "elbow", "wrist")
ROWS = 4096  # solved at once: matrices of them stay in a core's cache, and a million points in memory
SAME_POSE = 1e-4  # rad: a branch farther than this from the configuration is another one
SAME_BRANCH = np.radians(30.0)  # a Newton step that ends farther from its seed has left the branch


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """One configuration per planning point."""

    phi: Array  # (P,) rad about the carried reference, continuous inside each run
    q: Array  # (P, 6) rad, NaN where there is none
    branch: NDArray[np.int32]  # (P,) index of the solver's branch, −1 where there is none
    reason: NDArray[np.uint8]  # (P,) Reason
    shoulder: Array  # (P,) m, margins to the singularities
    elbow: Array  # (P,) rad
    wrist: Array  # (P,) rad

    def __post_init__(self) -> None:
        held(self)

    def marked(self, rows: NDArray[np.bool_], why: Reason | NDArray[np.uint8]) -> Assignment:
        """The same with another reason, one or (P,), at some rows (P,)."""
        return replace(self, reason=np.where(rows, why, self.reason).astype(np.uint8))


def realise(path: Path, arm: PlanningArm, robot: Robot, phi: Array, seed: Array) -> Assignment:
    """Solve for the exact poses near ``seed`` (P, 6); rows with a NaN seed stay without a configuration."""
    P = len(path.index)
    out: dict[str, NDArray[Any]] = {
        "q": np.full((P, 6), np.nan),
        "branch": np.full(P, -1, np.int32),
        "reason": np.full(P, Reason.NO_PATH, np.uint8),
        **{margin: np.full(P, np.nan) for margin in MARGINS},
    }
    known = np.flatnonzero(np.isfinite(seed).all(axis=1) & np.isfinite(phi))
    for first in range(0, len(known), ROWS):
        rows = known[first : first + ROWS]
        good, solved, bad = _solved(path, arm, robot, rows, phi, seed)
        out["reason"][bad] = Reason.UNREACHABLE
        for name, values in solved.items():
            out[name][good] = values
    return Assignment(phi=phi, **out)


def _solved(
    path: Path, arm: PlanningArm, robot: Robot, known: NDArray[np.intp], phi: Array, seed: Array
) -> tuple[NDArray[np.intp], dict[str, NDArray[Any]], NDArray[np.intp]]:
    """Of some rows (n,): those with a pose, with what an assignment says of them, and those without."""
    poses = arm.in_base(path.external[known], tcp_poses(path, known.astype(np.int32), phi[known]))
    q, error = refine(robot, poses, seed[known], arm.T_flange_tcp, iterations=5)
    bad = (error > CONVERGED) | (np.abs(q - seed[known]).max(axis=1) > SAME_BRANCH)
    good, q = known[~bad], q[~bad]
    flange = poses[~bad] @ inverse(arm.T_flange_tcp)
    branches = arm.solver.solve(flange)
    distance = np.abs(wrap(branches.q - q[:, None])).max(axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf)
    b = distance.argmin(axis=1)
    rows = np.arange(len(good))
    why = branch_reasons(branches, arm.margins)[rows, b]
    margins = {name: getattr(branches, name)[rows, b] for name in MARGINS}
    missed = np.flatnonzero(distance[rows, b] > SAME_POSE)
    known_ones = arm.solver.measure(flange[missed], q[missed]) if len(missed) else None
    if known_ones is not None:
        why[missed] = branch_reasons(known_ones, arm.margins)[:, 0]
        for name in MARGINS:
            margins[name][missed] = getattr(known_ones, name)[:, 0]
    inside = ((q >= arm.lower) & (q <= arm.upper)).all(axis=1)
    why[(why == Reason.OK) & ~inside] = Reason.LIMIT
    return good, {"q": q, "branch": b, "reason": why, **margins}, known[bad]


def between_stations(path: Path, values: Array) -> Array:
    """Values (S, …) at stations carried to all planning points, linearly in path length inside each run."""
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

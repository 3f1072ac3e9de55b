"""Time of rapid moves, branch changes and whole turns: terms of J (``weights.rapid``, ``weights.reorientation``).

A rapid move is straight in joint space from rest to rest. Its speed, acceleration and jerk along the line are those of
the tightest axis, as :func:`machopt.planning.motion.rapid_moves.retime_straight_segments` drives it; detours around
obstacles are not counted. The moves from and to home count by the shorter way of every joint, whatever whole turns the
path needs. With n rapid moves of t_k s each, m branch changes and whole turns, and the time t_cut at the
programmed feed,

    J_rapid = w_rapid·Σ t_k / (t_cut + n·STOP),      J_reorientation = w_reorientation·m·J₀.

J₀ is the lowest J that the index alone permits: every station and the worst index at their best. So a change of the
posture has to save a share of J, however long the job is. A whole turn is counted for each joint that
turns by more than 180° in a rapid move. The branches of arms without assembly modes have no numbers that hold from pose
to pose, so that their changes are not counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.stations.planning_path import PlanningPath

STOP = 1.0  # s, added for each rapid move to the reference time, so that jobs without a long cut have one too


@jit_compile
def compute_rest_time(slowness: float, inertia: float, harshness: float) -> Any:  # numba infers
    """Return the time in s of a line of unit length from rest to rest.

    Args:
        slowness: s, 1 / largest speed.
        inertia: s², 1 / largest acceleration.
        harshness: s³, 1 / largest jerk.
    """
    if not slowness > 0.0:
        return 0.0
    v, a, j = 1.0 / slowness, 1.0 / inertia, 1.0 / harshness
    ramp = v / a + a / j if v * j >= a * a else 2.0 * np.sqrt(v / j)
    if v * ramp <= 1.0:  # the largest speed is reached
        return slowness + ramp
    if 2.0 * a**3 <= j * j:  # the largest acceleration is
        top = 0.5 * a * (np.sqrt(a * a / (j * j) + 4.0 / a) - a / j)
        return 2.0 * (top / a + a / j)
    return 4.0 * np.cbrt(0.5 * harshness)


@dataclass(frozen=True, kw_only=True)
class RapidPricing:
    """Prices of the rapid moves of one path."""

    need: Array  # (3, 6 + E) s, s², s³ per equivalent rad: 1 / limit of speed, acceleration, jerk in rapid moves
    external_need: Array  # (S, 3) s, s², s³ that the external joints need on the way into each station
    per_second: float  # 1/s
    unit: float  # J₀
    home: Array  # (6 + E,) equivalent rad, where the motion begins and ends
    ends: Array  # (2, E) equivalent rad, external joints at the first and the last planning point
    weights: tuple[float, float]  # of time, and of changes
    stable: bool  # branches have numbers that hold from pose to pose

    @classmethod
    def build(
        cls,
        path: PlanningPath,
        limits: Array,
        home: Array,
        per_rad: Array,
        least: Array,
        stable: bool,
        options: PlanOptions,
    ) -> RapidPricing | None:
        """Return the prices; None where neither term counts.

        Args:
            path: planning points.
            limits: (3, 6 + E) limits of speed, acceleration and jerk in equivalent rad.
            home: (6 + E,) rad or m, true angles.
            per_rad: (6 + E,) factor from each joint to equivalent rad.
            least: (S,) lowest index of each station in units of c₀, inf where there is none.
            stable: the branch index is an assembly mode.
            options: plan options with the weights.
        """
        w = options.weights
        if w.rapid == 0.0 and w.reorientation == 0.0:
            return None
        seconds = float(path.time[-1]) + STOP * float(find_rapids(path).sum())
        known = np.isfinite(least)
        counted = known & path.counted[path.stations]
        mean = float(path.station_weight[known] @ least[known])
        need = 1.0 / (options.rapid_scale * limits)
        e = path.external[path.stations] * per_rad[6:]
        step = np.abs(np.diff(e, axis=0, prepend=e[:1]))
        return cls(
            need=need,
            external_need=(step[:, None, :] * need[None, :, 6:]).max(axis=2, initial=0.0),
            per_second=1.0 / seconds if seconds > 0.0 else 0.0,  # of no time there is no share
            unit=w.mean * mean + w.worst * float(least[counted].max(initial=0.0)),
            home=home * per_rad,
            ends=path.external[[0, -1]] * per_rad[6:],
            weights=(w.rapid, w.reorientation),
            stable=stable,
        )

    def measure(self, path: PlanningPath, x: Array, branch: NDArray[np.int32]) -> tuple[float, float]:
        """Return the time of the rapid moves of an assignment as a share, and its changes in units of J.

        Args:
            path: planning points.
            x: (P, 6 + E) joints in equivalent rad, NaN where there are none.
            branch: (P,) branches.
        """
        known = np.flatnonzero(np.isfinite(x).all(axis=1))
        if not len(known):
            return 0.0, 0.0
        flown = path.run[known[1:]] != path.run[known[:-1]]
        a, b = known[:-1][flown], known[1:][flown]
        step = np.abs(x[b] - x[a])
        need = (step[:, None, :] * self.need[None]).max(axis=2)
        seconds = sum(compute_rest_time(*row) for row in need.tolist()) + sum(
            self._time_home(x[known[[0, -1]]]).tolist()
        )
        return seconds * self.per_second, self.unit * count_changes(path, x[:, :6], branch, self.stable)

    def price_ends(self, q: Array, external: Array) -> Array:
        """Return the price of the move from or to home.

        Args:
            q: (…, 6) rad, joints of the arm.
            external: (E,) external joints in equivalent rad.
        """
        x = np.concatenate([q, np.broadcast_to(external, (*q.shape[:-1], len(external)))], axis=-1)
        return self.weights[0] * self.per_second * self._time_home(x)

    def _time_home(self, x: Array) -> Array:
        """Return the time in s between joints (…, 6 + E) and home, by the shorter way of the arm's joints."""
        step = np.abs(x - self.home)
        arm = step[..., :6]
        step = np.concatenate([np.abs(arm - 2 * np.pi * np.round(arm / (2 * np.pi))), step[..., 6:]], axis=-1)
        need = (step[..., None, :] * self.need).max(axis=-1).reshape(-1, 3)
        return np.array([compute_rest_time(*row) for row in need.tolist()]).reshape(x.shape[:-1])

    def price_changes(self) -> tuple[float, float]:
        """Return the price of one branch change, and that of one whole turn."""
        price = self.weights[1] * self.unit
        return (price if self.stable else 0.0), price


def count_changes(path: PlanningPath, q: Array, branch: NDArray[np.int32], stable: bool) -> int:
    """Return the number of branch changes and whole turns in the rapid moves of an assignment.

    Args:
        path: planning points.
        q: (P, 6) rad, NaN where there are none.
        branch: (P,) branches.
        stable: the branch numbers hold from pose to pose.
    """
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    flown = path.run[known[1:]] != path.run[known[:-1]]
    a, b = known[:-1][flown], known[1:][flown]
    turns = int(np.round(np.abs(q[b] - q[a]) / (2 * np.pi)).sum())
    return turns + (int((branch[a] != branch[b]).sum()) if stable else 0)


def find_rapids(path: PlanningPath) -> Bools:
    """Return (P,) True at points that a rapid move leads to from the point before.

    Args:
        path: planning points.
    """
    return np.asarray(np.r_[False, path.run[1:] != path.run[:-1]])

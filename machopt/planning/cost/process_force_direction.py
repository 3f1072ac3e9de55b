"""The process force along the path: its sideways direction where the travel has none, and its change along the path.

With the tool axis n and the unit direction of travel u at a place, sin α = |u − (u·n)n| is the sideways share of the
travel. Where that is small, its direction is noise: a plunge inclined by 1° would have the force of a cut
along the inclination. The direction is therefore blended with one propagated along the run,

    t = w(sin α / sin α₀) · (u − (u·n)n)/sin α + (1 − w) · c,      w(x) = x²(3 − 2x) on 0 … 1,  α₀ = 10°,

c the sideways direction of the next place in the run (else the last one) that travels at α₀ or more across the axis,
projected on the plane normal to n; in a run without such a place (a hole) the workpiece x axis (y where x is parallel
to n). |t| ≤ 1. The force is f = f_travel t + f_normal (n × t) + f_axial n.

A shift of the path is computed with a force that has no jumps, over two given lengths ℓ and λ:

    F(s) = a(s) · 1/(2ℓ) ∫_{−ℓ}^{ℓ} f(s + σ) dσ,      |F(s₁) − F(s₂)| ≤ |f| (1/ℓ + 1/λ) |s₁ − s₂|

s is the length of the path in its run. Outside the cuts, and in those without a force (the way out of a hole, say), f
is that of the nearest cut with a force: the tool leaves a hole along the line that it was drilled on. a fades: 1 while
cutting, to 0 over λ away from the cuts, and from 0 over λ at the ends of a run that the tool approaches or leaves
without cutting, where that way is at least λ long. On a shorter one (2 mm above a hole, say) a ramp would reach into
the cut: the rapid move goes to a shifted point instead. Between two cuts of a run that are no more than 2λ apart (the
pecks of a hole that are left at feed) a is 1. A sharp corner turns the force over 2ℓ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import ProcessForce
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.numerics.identity_cache import IdentityCache
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.stations.planning_path import NO_MOVE, PlanningPath, compute_any_normal

SIDEWAYS = float(np.sin(np.radians(10.0)))  # sin α₀
_SIDEWAYS: IdentityCache[PlanningPath, Array] = IdentityCache()
PLACES = 128  # samples of the averaging window; a corner is resolved to 1 % of its angle


def compute_sideways_directions(path: PlanningPath) -> Array:
    """Return (P, 3) t of the move that leaves each point; at the end of a run, of the move that arrives, where it is no
    re-entry.

    Args:
        path: planning points.

    Returns:
        An array that must not be written: it is kept with the path.
    """
    return _SIDEWAYS.get(path, _compute_sideways)


def _compute_sideways(path: PlanningPath) -> Array:
    path = path.programmed
    out = np.empty_like(path.position)
    for first, last in path.runs:
        rows = np.arange(first, last + 1)
        run = _Run(path, first, last)
        out[rows] = run.direction(np.minimum(np.arange(len(rows)), max(len(rows) - 2, 0)), path.axis[rows])
    again = np.flatnonzero(path.is_reentry)
    out[again - 1] = out[again]  # the move of the file that leaves the point, whether the tool is lifted there or not
    out.setflags(write=False)
    return out


def compute_process_force(axis: Array, t: Array, force: ProcessForce, own: Array | None = None) -> Array:
    """Return the (..., 3) force in N of the process on the tool, in the frame of the arguments.

    Args:
        axis: (..., 3) unit tool axes, tip to shank.
        t: (..., 3) sideways directions of travel, length at most 1.
        force: force components along travel, normal and tool axis, N.
        own: (..., 3) components of the points themselves, NaN where ``force`` holds; None: it holds at all.
    """
    travel, normal, axial = force.resolve_components(own)
    return np.asarray(travel * t + normal * np.cross(axis, t) + axial * axis)


def compute_engaged_force(path: PlanningPath, force: ProcessForce, length: float, fade: float | None = None) -> Array:
    """Return (P, 3) F in N at every planning point, in the workpiece frame.

    Args:
        path: planning points.
        force: force components along travel, normal and tool axis, N.
        length: m, ℓ.
        fade: m, λ; None: ℓ.
    """
    path = path.programmed
    out = np.zeros_like(path.position)
    places = length * ((2 * np.arange(PLACES) + 1) / PLACES - 1)
    for first, last in path.runs:
        run = _Run(path, first, last)
        if not len(run.loaded):
            continue
        s = run.s[:, None] + places
        mean = run.force(_move_into(s, run.loaded), force).mean(axis=1)
        out[first : last + 1] = run.share(length if fade is None else fade)[:, None] * mean
    return out


def compute_engaged_share(path: PlanningPath, fade: float) -> Array:
    """Return (P,) a at every planning point, 0 in runs without a force.

    Args:
        path: planning points.
        fade: m, λ.
    """
    path = path.programmed
    out = np.zeros(len(path.position))
    for first, last in path.runs:
        run = _Run(path, first, last)
        if len(run.loaded):
            out[first : last + 1] = run.share(fade)
    return out


class _Run:
    """One run parameterised by its length."""

    def __init__(self, path: PlanningPath, first: int, last: int) -> None:
        rows = slice(first, last + 1)
        self.axis, position = path.axis[rows], path.position[rows]
        self.own = None if path.force is None else path.force[rows]  # (n, 3) N on the way to each point
        step = np.diff(position, axis=0)
        length = np.linalg.norm(step, axis=1)
        self.s = np.r_[0.0, np.cumsum(length)]  # (n,) m
        self.u = np.where(length[:, None] > NO_MOVE, step / np.maximum(length, 1e-300)[:, None], 0.0)  # (n − 1, 3)
        cut = path.move[first + 1 : last + 1] == MoveKind.CUT
        self.cuts = self._list_stretches(cut & (length > NO_MOVE))  # (k, 2) m, start and end of each cut
        self.loaded = self.cuts  # (l, 2) m, of each stretch of cuts with a force
        if self.own is not None:  # on the way out of a hole, and in the air, nothing is cut
            self.loaded = self._list_stretches(cut & (length > NO_MOVE) & ~(self.own[1:] == 0.0).all(axis=1))
        long = cut[length > NO_MOVE]  # coincident points have no direction
        self.comes, self.goes = bool(len(long) and not long[0]), bool(len(long) and not long[-1])
        points = np.flatnonzero(
            path.is_point[rows]
        )  # a move between toolpath points has one c, independent of its subdivision
        after = np.clip(np.searchsorted(points, np.arange(len(step)), side="right"), 1, max(len(points) - 1, 1))
        low, high = (points[after - 1], points[after]) if len(points) > 1 else (points[:0], points[:0])
        middle = normalise_vectors(self.axis[low] + self.axis[high])
        across = self.u - np.sum(self.u * middle, axis=1, keepdims=True) * middle
        size = np.linalg.norm(across, axis=1)
        self.carried = self._carry_directions(across / np.maximum(size, 1e-300)[:, None], size >= SIDEWAYS)

    def _list_stretches(self, mine: NDArray[np.bool_]) -> Array:
        """Return (k, 2) m start and end of each unbroken row of moves."""
        edge = np.flatnonzero(np.diff(np.r_[False, mine, False].astype(int)))
        return np.asarray(self.s[edge.reshape(-1, 2)])

    @staticmethod
    def _carry_directions(across: Array, good: NDArray[np.bool_]) -> Array:
        """Return (n − 1, 3) c of every move before projection; zero where the run has none."""
        rows = np.flatnonzero(good)
        if not len(rows):
            return np.zeros_like(across)
        return np.asarray(across[rows[np.minimum(np.searchsorted(rows, np.arange(len(across))), len(rows) - 1)]])

    def direction(self, move: NDArray[np.intp], axis: Array) -> Array:
        """Return t (..., 3) of moves.

        Args:
            move: (...,) index of the move in the run.
            axis: (..., 3) unit tool axes.
        """
        bare = _project_unit(compute_any_normal(axis.reshape(-1, 3)).reshape(axis.shape), axis)
        if not len(self.u):
            return bare
        c = _project_unit(self.carried[move], axis)
        c = np.where(np.linalg.norm(c, axis=-1, keepdims=True) > 0.5, c, bare)
        across = self.u[move] - np.sum(self.u[move] * axis, axis=-1, keepdims=True) * axis
        size = np.linalg.norm(across, axis=-1, keepdims=True)
        x = np.clip(size / SIDEWAYS, 0.0, 1.0)
        w = x * x * (3.0 - 2.0 * x)
        return np.asarray(w * across / np.maximum(size, 1e-300) + (1.0 - w) * c)

    def force(self, s: Array, force: ProcessForce) -> Array:
        """Return the (..., 3) force in N of the move at each place; at the end of a cut, of the move that ends there.

        Args:
            s: (...,) m, length along the run.
            force: force components, N.
        """
        move = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.u) - 1)
        ends = np.isin(s, self.loaded[:, 1])
        move = np.where(ends, np.clip(np.searchsorted(self.s, s, side="left") - 1, 0, len(self.u) - 1), move)
        f = ((s - self.s[move]) / np.maximum(self.s[move + 1] - self.s[move], 1e-300))[..., None]
        axis = normalise_vectors((1 - f) * self.axis[move] + f * self.axis[move + 1])
        own = None if self.own is None else self.own[move + 1]
        return compute_process_force(axis, self.direction(move, axis), force, own)

    def share(self, fade: float) -> Array:
        """Return (n,) a.

        Args:
            fade: m, λ.
        """
        is_apart = self.cuts[1:, 0] - self.cuts[:-1, 1] > 2.0 * fade
        load_intervals = np.column_stack([self.cuts[np.r_[True, is_apart], 0], self.cuts[np.r_[is_apart, True], 1]])
        away = np.abs(_move_into(self.s, load_intervals) - self.s)
        out = np.clip(1.0 - away / fade, 0.0, 1.0)
        if self.comes and self.cuts[0, 0] >= fade:
            out = np.minimum(out, self.s / fade)
        if self.goes and self.s[-1] - self.cuts[-1, 1] >= fade:
            out = np.minimum(out, (self.s[-1] - self.s) / fade)
        return np.asarray(out)


def _move_into(s: Array, stretches: Array) -> Array:
    """Return lengths (...,) along a run, moved to the nearest of its stretches (k, 2)."""
    inside = np.clip(s[..., None], stretches[:, 0], stretches[:, 1])  # (..., k)
    nearest = np.abs(inside - s[..., None]).argmin(axis=-1)
    return np.asarray(np.take_along_axis(inside, nearest[..., None], axis=-1)[..., 0])


def _project_unit(v: Array, axis: Array) -> Array:
    """(..., 3) projected on the plane normal to the axis, at unit length; zero where nothing is left."""
    flat = v - np.sum(v * axis, axis=-1, keepdims=True) * axis
    size = np.linalg.norm(flat, axis=-1, keepdims=True)
    return np.asarray(np.where(size > 1e-9, flat / np.maximum(size, 1e-300), 0.0))

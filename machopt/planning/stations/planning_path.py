"""Planning path: runs, a reference direction without jumps, planning points and stations of a toolpath.

A *run* is a stretch without rapid moves: it starts at rest at the end point of a rapid move and is
traversed on straight lines. At a re-entry (``toolpath.reentries``) a run ends and the next begins at the same
point, which is then a planning point twice. Long segments get additional points, so that nothing important (a limit,
a minimum of stiffness) is missed inside them. Long paths are thinned to *stations*, as dense as their
detail requires, and the choice is made there.

Rotation is planned as ``phi`` about a reference direction transported along the run by minimal rotation, so
that constant phi means "no rotation"; ``gamma = phi + offset`` is the angle of the files, measured from the
direction of travel (trajectories) or the workpiece x axis (point operations).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import interpolate_axis, normalise_vectors, wrap_angle
from machopt.planning.stations.path_station_selection import select_stations
from machopt.planning.stations.reference_transport import transport_reference

ARM = 0.15  # m per rad: equivalent path length of an axis change, about a tool's length
PARALLEL = np.cos(np.radians(1.0))  # a plunge runs along the tool axis within this
UNKNOWN_FEED = 0.05  # m/s, for the time of approach moves without a feed
FASTEST_FEED = (
    0.3  # m/s; a higher feed in a file (air cut, laser path) is not reachable and lost time would dominate the index
)
SAME_INDEX = 1e-9  # tolerance of fractional indices; absolute, because the index of a long path is large
SEGMENT = 0.02  # m, longest stretch without a planning point
AROUND = np.array([-1.0, -0.5, 0.5, 1.0])  # of the given length: positions of points added around a corner
ROOM = 0.125  # of that length: points nearer to an existing one are not added
TURN = np.cos(np.radians(5.0))  # sharper turns of the direction of travel are corners
NO_MOVE = 1e-10  # m: a shorter move has no direction; files print 1e-9 m, interpolation leaves 1e-16 m
SEGMENT_AXIS = np.radians(3.0)  # rad, the same for axis changes


@dataclass(frozen=True, kw_only=True)
class PlanningPath:
    """P planning points in order: every toolpath point, and extra ones inside long segments."""

    index: Array  # (P,) fractional toolpath index
    position: Array  # (P, 3) m in workpiece
    axis: Array  # (P, 3) unit, tip to shank
    move: NDArray[np.int8]  # (P,) Move of the segment ending here
    feed: Array  # (P,) m/s of the segment ending here, NaN for rapid
    run: NDArray[np.int32]  # (P,)
    time: Array  # (P,) s, cumulative time at the programmed feed (at most FASTEST_FEED); rapid moves do not count
    s: Array  # (P,) m, cumulative length in the metric |dp| ⊕ ARM |dn|; rapid moves do not count
    travel: Array  # (P, 3) unit direction of travel in workpiece (any normal direction where there is none)
    is_point: NDArray[np.bool_]  # (P,) True: a toolpath point
    is_drilling: NDArray[np.bool_]  # (P,) belongs to a point operation
    plunge: NDArray[np.bool_]  # (P,) the segment ending here runs along the tool axis: rotation is kept
    reference: Array  # (P, 3) unit, direction of TCP x at phi = 0
    offset: Array  # (P,) rad, gamma − phi
    stations: NDArray[np.int32]  # (S,) indices into the P points where the choice is made
    runs: tuple[tuple[int, int], ...]  # first and last planning point of each run
    external: Array  # (P, E) m or rad, external joints
    force: Array | None = None  # (P, 3) N along travel, normal, axis on the way here; NaN: planning option; None: all
    untilted: PlanningPath | None = None  # the path of the CAM file, where position and axis are those of a tilted tool
    lead: Array | None = None  # (P,) rad, tilt against it (:mod:`machopt.numerics.tool_tilt`); None: no tilt
    side: Array | None = None  # (P,) rad
    unshifted: Array | None = None  # (P, 3) m, positions before a shift against the deflection; None: no shift

    @property
    def programmed(self) -> PlanningPath:
        """The path of the CAM file, with the same external joints: loads refer to its axes, lengths to its points."""
        if self.untilted is None:
            return self.without_shift
        return replace(self.untilted, external=self.external)

    @property
    def without_shift(self) -> PlanningPath:
        """The path before a shift against the deflection, tilted as this one."""
        return self if self.unshifted is None else replace(self, position=self.unshifted, unshifted=None)

    def shift_positions(self, offset: Array) -> PlanningPath:
        """Return the commanded path, shifted against the programmed one.

        Args:
            offset: (P, 3) m, from the positions before any shift, in the workpiece frame.
        """
        before = self.without_shift.position
        return replace(self, position=before + offset, unshifted=before)

    def whole(self, q: Array, rows: NDArray[Any] | slice = slice(None)) -> Array:
        """Return (n, 6 + E) machine joints.

        Args:
            q: (n, 6) rad, joints of the arm.
            rows: planning points, default all.
        """
        return np.hstack([q, self.external[rows]])

    @cached_property
    def is_reentry(self) -> NDArray[np.bool_]:
        """(P,) True where a run begins at the point that the previous one ends at: the tool was lifted in a cut."""
        return np.asarray((self.move == MoveKind.RAPID) & ~self.is_point)

    @cached_property
    def may_touch(self) -> NDArray[np.bool_]:
        """(P,) True in runs with linear moves: there the cutter may be in the workpiece, after a rapid move never."""
        return np.asarray((np.bincount(self.run)[self.run] > 1) | (self.move != MoveKind.RAPID))

    @cached_property
    def motion_share(self) -> Array:
        """(P,) weight of the motion into each point: the share of its run in the length cut.

        Motion and index are thus traded equally in each run, for one contour as for a hundred holes. A run
        without cuts counts like the next one that cuts. The parts of a run that re-entries divide count as one.
        """
        run = self.run - np.cumsum(self.is_reentry)
        share = np.bincount(run, weights=self.weight).astype(float)
        for k in range(len(share) - 2, -1, -1):
            share[k] = share[k] or share[k + 1]
        for k in range(1, len(share)):
            share[k] = share[k] or share[k - 1]
        return np.asarray(share[run])

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """(P,) True where the index counts: toolpath points the tool cuts to, and points inside cut segments."""
        return np.asarray(self.move == MoveKind.CUT)

    @cached_property
    def weight(self) -> Array:
        """(P,) share of the length cut of each counted point; zero elsewhere, 1 in total.

        Half of either neighbouring segment, so that a mean does not depend on the sampling. The half
        at a start point that is not cut goes to the first cut point. Holes count by their depth: a job of holes and
        contours
        has one unit. Without any length (touches) every counted point has equal weight.
        """
        cut = self.counted
        position = self.programmed.position
        half = 0.5 * np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)] * cut
        out = half + np.r_[half[1:], 0.0] * cut
        out[1:] += half[1:] * ~cut[:-1]
        again = np.flatnonzero(self.is_reentry)
        out[again + 1] -= half[again + 1]  # a re-entry does not change the weights of the points around it
        out[again - 1] += half[again + 1]
        total = float(out.sum())
        return out / total if total > 0 else cut / max(int(cut.sum()), 1)

    @cached_property
    def station_weight(self) -> Array:
        """(S,) the weights transferred to the stations, as the points between them interpolate their cost linearly."""
        rows = np.arange(len(self.index))
        after = np.minimum(np.searchsorted(self.stations, rows), len(self.stations) - 1)
        before = np.maximum(after - 1, 0)
        span = np.maximum(self.stations[after] - self.stations[before], 1)
        f = np.where(after > before, (rows - self.stations[before]) / span, 1.0)
        n = len(self.stations)
        return np.asarray(
            np.bincount(after, self.weight * f, n) + np.bincount(before, self.weight * (1.0 - f), n), float
        )


def build_planning_path(toolpath: Toolpath, keep: tuple[int, ...] = (), *, corners: float = 0.0) -> PlanningPath:
    """Split a toolpath into runs, densify long segments, transport the reference direction, choose stations.

    Args:
        toolpath: toolpath of one tool.
        keep: toolpath points that must be stations, because the user fixed the rotation there.
        corners: m, add points up to this distance around each corner, start and end of a cut, where a shift against the
            deflection changes; 0 for none.
    """
    n = len(toolpath)
    starts = (toolpath.move == MoveKind.RAPID) | (np.arange(n) == 0)
    run_of_point = np.cumsum(starts) - 1
    index = _densify(toolpath, starts)
    if corners > 0:
        index = _add_corner_points(toolpath, index, run_of_point, corners)
    index, entered = _repeat_reentry_points(index, toolpath.reentries)
    low = np.clip(np.ceil(index).astype(int) - 1, 0, n - 1)  # previous toolpath point (or the point itself)
    high = np.ceil(index).astype(int)  # toolpath point at the end of its segment
    f = np.where(high > low, index - low, 1.0)[:, None]
    position = (1 - f) * toolpath.position[low] + f * toolpath.position[high]
    axis = interpolate_axis(toolpath.axis[low], toolpath.axis[high], f[:, 0])
    run = (run_of_point[high] + np.cumsum(entered)).astype(np.int32)
    joined = np.r_[False, run[1:] == run[:-1]]
    step = np.r_[0.0, np.hypot(*_compute_steps(position, axis))]
    s = np.cumsum(np.where(joined, step, 0.0))
    seconds = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)] / _fill_unknown_feed(toolpath.feed[high])
    bounds = np.flatnonzero(~joined)
    runs = tuple((int(a), int(b) - 1) for a, b in zip(bounds, np.r_[bounds[1:], len(index)], strict=True))
    move = np.where(entered, MoveKind.RAPID, toolpath.move[high]).astype(np.int8)
    drilling = np.array([o.kind == "point" for o in toolpath.operations])[toolpath.operation[high]]
    travel = _compute_travel_direction(position, axis, joined)
    again = np.flatnonzero(entered)
    travel[again - 1] = travel[again]  # at a re-entry the file's direction holds on both sides
    # values of the file at a point apply to the move that leaves it, like the direction of travel
    left = np.floor(index).astype(int)
    of_left = np.array([o.kind == "point" for o in toolpath.operations])[toolpath.operation[left]]
    natural = _choose_reference(toolpath.reference[left], travel, axis, of_left)
    reference = transport_reference(natural, axis, runs)
    return PlanningPath(
        index=index,
        position=position,
        axis=axis,
        move=move,
        feed=np.where(entered, np.nan, toolpath.feed[high]),
        run=run,
        time=np.cumsum(np.where(joined, seconds, 0.0)),
        s=s,
        travel=travel,
        is_point=(np.abs(index - np.round(index)) < SAME_INDEX) & ~entered,
        is_drilling=drilling,
        plunge=_find_plunges(position, axis, joined),
        reference=reference,
        offset=compute_signed_angle(natural, reference, -axis),
        stations=select_stations(position, axis, move, runs, np.searchsorted(index, keep)),
        runs=runs,
        external=np.empty((len(index), 0)),
        force=None if toolpath.force is None else toolpath.force[high],
    )


def _repeat_reentry_points(index: Array, reentries: tuple[int, ...]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the indices with each point of a re-entry twice, and where its second one is, which begins a run."""
    entered = np.zeros(len(index), bool)
    if not reentries:
        return index, entered
    after = np.searchsorted(index, np.array(reentries, float) + SAME_INDEX)
    return np.insert(index, after, np.array(reentries, float)), np.insert(entered, after, True)


def _find_plunges(position: Array, axis: Array, joined: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (P,) whether the step into each point follows the tool axis; ``joined`` (P,): it is inside a run."""
    along = np.abs(np.sum(np.diff(position, axis=0, prepend=position[:1]) * axis, axis=1))
    length = np.r_[0.0, np.linalg.norm(np.diff(position, axis=0), axis=1)]
    return np.asarray(joined & (length > 0) & (along >= PARALLEL * length))


def _fill_unknown_feed(feed: Array) -> Array:
    return np.where(feed > 0, np.minimum(feed, FASTEST_FEED), UNKNOWN_FEED)


def _compute_steps(position: Array, axis: Array) -> tuple[Array, Array]:
    turn = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    return np.linalg.norm(np.diff(position, axis=0), axis=1), ARM * turn


def _densify(toolpath: Toolpath, starts: NDArray[np.bool_]) -> Array:
    """Fractional indices of all planning points."""
    length, turn = _compute_steps(toolpath.position, toolpath.axis)
    pieces = np.maximum(np.ceil(length / SEGMENT - 1e-9), np.ceil(turn / ARM / SEGMENT_AXIS - 1e-9)).astype(int)
    pieces = np.where(starts[1:], 1, np.maximum(pieces, 1))
    segment = np.repeat(np.arange(len(pieces)), pieces)
    nth = np.arange(1, len(segment) + 1) - (np.cumsum(pieces) - pieces)[segment]
    return np.asarray(np.r_[0.0, segment + nth / pieces[segment]], float)


def _add_corner_points(toolpath: Toolpath, index: Array, run: NDArray[np.int_], length: float) -> Array:
    """Return the indices with additional ones within ``length`` of sharp corners, starts and ends of cuts."""
    step = np.diff(toolpath.position, axis=0)
    size = np.linalg.norm(step, axis=1)
    cut, same = toolpath.cutting[1:], run[1:] == run[:-1]
    turn = np.einsum("ij,ij->i", step[1:], step[:-1]) < TURN * size[1:] * size[:-1]
    sharp = turn & cut[1:] & cut[:-1] & (size[1:] > 0)
    at = 1 + np.flatnonzero((sharp | (cut[1:] != cut[:-1])) & same[1:] & same[:-1])
    s = np.r_[0.0, np.cumsum(np.where(same, size, 0.0))]
    there = np.interp(index, np.arange(len(s)), s)
    out = [index]
    for k in at.tolist():
        mine = np.flatnonzero(run == run[k])
        places = s[k] + length * AROUND
        places = places[(places > s[mine[0]]) & (places < s[mine[-1]])]
        near = there[(index >= mine[0]) & (index <= mine[-1])]
        room = np.abs(places[:, None] - near).min(axis=1) > ROOM * length
        out.append(np.interp(places[room], s[mine], mine.astype(float)))
    found = np.unique(np.concatenate(out))
    return found[np.r_[True, np.diff(found) > SAME_INDEX]]


def _compute_travel_direction(position: Array, axis: Array, joined: NDArray[np.bool_]) -> Array:
    """Outgoing direction (incoming at a run's end); the last valid one where the tool only moves along its axis."""
    d = np.zeros_like(position)
    d[:-1] = np.where(joined[1:, None], np.diff(position, axis=0), 0.0)
    last = np.r_[~joined[1:], True]
    d[1:] = np.where((last[1:] & joined[1:])[:, None], np.diff(position, axis=0), d[1:])
    across = d - np.sum(d * axis, axis=1, keepdims=True) * axis
    size, whole = np.linalg.norm(across, axis=1), np.linalg.norm(d, axis=1)
    good = (size > np.sin(np.radians(1.0)) * whole) & (whole > NO_MOVE)
    fill = _find_nearest_valid(good, joined)
    from_there = np.maximum(fill, 0)
    move = d[from_there]  # the full move: its projection must not depend on its subdivision
    flat = move - np.sum(move * axis, axis=1, keepdims=True) * axis
    clear = np.linalg.norm(flat, axis=1) > np.sin(np.radians(1.0)) * np.linalg.norm(move, axis=1)
    lent = across[from_there] - np.sum(across[from_there] * axis, axis=1, keepdims=True) * axis
    out = np.where((fill >= 0)[:, None], np.where(clear[:, None], flat, lent), 0.0)
    left = np.linalg.norm(out, axis=1)  # its source may have another axis
    bare = (fill < 0) | (left <= 1e-9 * whole[from_there])
    out[bare] = compute_any_normal(axis[bare])
    return normalise_vectors(out)


def _find_nearest_valid(good: NDArray[np.bool_], joined: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each point the next valid one of its run, else the previous one, else −1."""
    rows, run = np.arange(len(good)), np.cumsum(~joined)
    none = len(good)  # means no such point
    ahead = np.minimum.accumulate(np.where(good, rows, none)[::-1])[::-1]  # a plunge uses the cut that follows
    behind = np.maximum.accumulate(np.where(good, rows, -1))
    run_of = np.r_[run, -1, -1]  # the last two mean none, and −1
    return np.where(run_of[ahead] == run, ahead, np.where(run_of[behind] == run, behind, -1))


def compute_any_normal(axis: Array) -> Array:
    """Return the workpiece x axis projected on the plane normal to the tool axis; y where x is (nearly) parallel to it.

    Args:
        axis: (n, 3) unit tool axes in the workpiece frame.
    """
    x = np.broadcast_to(np.array([1.0, 0.0, 0.0]), axis.shape)
    y = np.broadcast_to(np.array([0.0, 1.0, 0.0]), axis.shape)
    pick = np.where(np.abs(axis[:, :1]) > PARALLEL, y, x)
    return np.asarray(pick - np.sum(pick * axis, axis=1, keepdims=True) * axis)


def _choose_reference(file_reference: Array, travel: Array, axis: Array, drilling: NDArray[np.bool_]) -> Array:
    """Return the direction of gamma = 0: the file's own, else travel (trajectories) or workpiece x (points)."""
    ref = np.where(drilling[:, None], compute_any_normal(axis), travel)
    own = file_reference - np.sum(file_reference * axis, axis=1, keepdims=True) * axis
    size = np.linalg.norm(file_reference, axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):  # a direction along the tool axis defines no rotation
        useful = np.linalg.norm(own, axis=1, keepdims=True) > np.sin(np.radians(1.0)) * size
    ref = np.where(useful, own, ref)
    ref = ref - np.sum(ref * axis, axis=1, keepdims=True) * axis
    return normalise_vectors(ref)


def compute_signed_angle(a: Array, b: Array, about: Array) -> Array:
    """Return the (n,) angle in rad from one direction to another about an axis.

    Args:
        a: (n, 3) unit, normal to the axis.
        b: (n, 3) unit, normal to the axis.
        about: (n, 3) unit.
    """
    return wrap_angle(np.arctan2(np.sum(np.cross(a, b) * about, axis=1), np.sum(a * b, axis=1)))


def compute_tcp_poses(path: PlanningPath, points: NDArray[np.int32], phi: Array) -> Array:
    """Return the TCP poses in the workpiece frame, (n, …, 4, 4).

    Args:
        path: planning points.
        points: (n,) planning points.
        phi: (n, …) rad.
    """
    from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation

    extra = (1,) * (np.ndim(phi) - 1)
    axis = path.axis[points].reshape(len(points), *extra, 3)
    reference = path.reference[points].reshape(len(points), *extra, 3)
    R = compute_tool_rotation(axis, reference, np.asarray(phi))
    return build_transform(R, path.position[points].reshape(len(points), *extra, 3))

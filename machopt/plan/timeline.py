"""The whole motion in time: home → rapid → run → rapid → … → home, one row a control sample.

Runs are retimed at the programmed feed (:mod:`machopt.plan.retime`), rapid moves go from rest to rest in joint
space (:mod:`machopt.plan.rapids`) and are checked for collisions like everything else. Where points were dropped
(``allow_gaps``) the tool lifts along its axis, goes over by a rapid move and comes down again. Where the CAM file
leaves or enters the workpiece in a rapid move (a drill drawn out, a cut without approach), the tool goes straight
along its axis at a feed until it is out, and only then in rapid.

Where the cell has kinematic corrections, the plan's configurations are true angles and everything in the result is told
to the robot, so in encoder angles: runs are timed in them, rapid moves are straight in them. Rapid moves were checked
for collisions straight in true angles, which differ by how much the corrections change on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.toolpath import Move, Toolpath
from machopt.domain.trajectory import Trajectory
from machopt.model.ik import refine
from machopt.plan.path import Path, tcp_poses
from machopt.plan.pipeline import Plan
from machopt.plan.rapids import Blocked, plan_rapid, time_legs
from machopt.plan.retime import Dip, RunFailure, RunInput, RunTrajectory, retime_run

Array = NDArray[np.float64]
LIFTS = (0.02, 0.05, 0.1, 0.2, 0.4)  # m along the tool axis, tried in this order around obstacles
BEND = np.radians(0.1)  # rotation that a straight move between two toolpath points may miss before a point is added
BOW = 2e-6  # m, the same of a shifted path; unshifted it is straight between toolpath points to rounding
SEARCH = 2000  # extensions of the random tree for a rapid move that nothing simpler frees
SEARCH_IN_VAIN = 100  # the same once another move is known to be stuck
GAP_LIFT = 0.05  # m, where the path is interrupted
WITHDRAWALS = (0.002, 0.005, 0.01, 0.02, 0.035, 0.05, 0.1, 0.2, 0.4)  # m along the tool axis out of the workpiece
JUMP = np.radians(45.0)  # between neighbouring planning points where the choice broke off: another configuration
FLIP = np.radians(120.0)  # the same anywhere: no rotation about the tool axis that a run was given turns a joint so far
LIFT_STEP = 0.01  # m between the configurations along a lift


@dataclass(frozen=True)
class Leg:
    """A stretch of the motion from rest to rest."""

    name: str  # "rapid", "run", "lift"
    q: Array  # (S, 6) rad by encoder
    index: Array  # (S,) fractional toolpath index, NaN from and to home
    move: NDArray[np.int8]  # (S,)
    operation: NDArray[np.int32]  # (S,)
    gamma: Array  # (S,) rad, NaN in rapid moves
    waypoints: Array  # (W, 6) rad by encoder, targets in order, without the start
    waypoint_index: Array  # (W,) fractional toolpath index
    waypoint_feed: Array  # (W,) m/s of the straight move that ends there, NaN in rapid moves


@dataclass(frozen=True)
class Obstruction:
    """A rapid move no free way was found for, or a run that cannot be driven."""

    before: float  # toolpath index the motion comes from, NaN for home
    after: float  # toolpath index it should go to, NaN for home
    reason: str


@dataclass(frozen=True)
class Timeline:
    """The motion, what slows it, and what stops it."""

    trajectory: Trajectory | None  # None where something stops it
    dips: tuple[Dip, ...]  # with toolpath indices
    obstructions: tuple[Obstruction, ...]
    detours: tuple[str, ...]  # rapid moves that could not go straight
    legs: tuple[Leg, ...]
    held_share: float  # of the cutting time at ≥ 95 % of the programmed feed
    phi: Array  # (P,) rad, the rotation as driven: a little smoother than planned


def build_timeline(plan: Plan, toolpath: Toolpath, progress: Callable[[float], None] | None = None) -> Timeline:
    """Drive the chosen assignment from home through every run and back home."""
    return _Builder(plan, toolpath, progress or (lambda _: None)).build()


class _Builder:
    def __init__(self, plan: Plan, toolpath: Toolpath, progress: Callable[[float], None]) -> None:
        self.plan, self.toolpath, self.progress = plan, toolpath, progress
        self.cell: Cell = plan.setup.cell
        self.options: PlanOptions = plan.options
        self.path: Path = plan.path
        self.q = plan.chosen.assignment.q
        self.feed_after = self._feed_after()
        self.phi = plan.chosen.assignment.phi.copy()
        self.legs: list[Leg] = []
        self.dips: list[Dip] = []
        self.obstructions: list[Obstruction] = []
        self.detours: list[str] = []
        self.withdrawn: list[tuple[float, float]] = []  # toolpath index, m
        self.cut_time = self.held_time = 0.0
        self.rng = np.random.default_rng(self.options.seed)

    def build(self) -> Timeline:
        here, index, axis_row = self.plan.setup.driven.home, float("nan"), -1
        stretches = list(self._stretches())
        for n, (first, last) in enumerate(stretches):
            gap_in = first > 0 and self.path.run[first] == self.path.run[first - 1]
            gap_out = last + 1 < len(self.path.index) and self.path.run[last + 1] == self.path.run[last]
            lift_in = GAP_LIFT if gap_in else self._withdrawal(first)
            lift_out = GAP_LIFT if gap_out else lift_in if first == last else self._withdrawal(last)
            start = self._lifted(first, lift_in) if lift_in else self.q[first]
            end = self._lifted(last, lift_out) if lift_out else self.q[last]
            if start is None or end is None:
                row = first if start is None else last
                self.obstructions.append(
                    Obstruction(index, self.path.index[row], "no room to lift the tool at the gap")
                )
                continue
            self._rapid(here, start, index, float(self.path.index[first]), axis_row, first)
            if lift_in:
                self._straight(start, self.q[first], first, Move.APPROACH, lift_in)
            if last > first and np.ptp(self.path.s[first : last + 1]) > 0:
                self._run(first, last)
            elif last > first or self.path.move[first] != Move.RAPID:
                self._touch(first, last)
            if lift_out:
                self._straight(self.q[last], end, last, Move.RETRACT, lift_out)
            here, index, axis_row = end, float(self.path.index[last]), last
            self.progress((n + 1) / max(len(stretches), 1))
        self._rapid(here, self.plan.setup.driven.home, index, float("nan"), axis_row, -1)
        if self.withdrawn:
            places = ", ".join(f"{index:g}" for index, _ in self.withdrawn[:8]) + (
                " …" if len(self.withdrawn) > 8 else ""
            )
            self.detours.append(
                f"in the workpiece at its start or end, at point {places}: there the tool is first drawn straight "
                f"along its axis at a feed, by up to {1e3 * max(height for _, height in self.withdrawn):.0f} mm"
            )
        trajectory = None if self.obstructions else self._joined()
        held = self.held_time / self.cut_time if self.cut_time > 0 else 1.0
        return Timeline(
            trajectory,
            tuple(self.dips),
            tuple(self.obstructions),
            tuple(self.detours),
            tuple(self.legs),
            held,
            self.phi,
        )

    def _stretches(self) -> Iterator[tuple[int, int]]:
        """Runs, cut at points without a configuration and at changes of configuration.

        At such gaps a stretch ends at the last toolpath point before it, not somewhere on the way to a point that is
        never reached. Lonely rapid points without a configuration are passed by.
        """
        ok = self.plan.chosen.assignment.reason == Reason.OK
        broke = np.zeros(len(ok), int)  # how often the choice had broken off until a point
        broke[self.path.stations[list(self.plan.choice.broken)]] = 1
        broke = np.cumsum(broke)
        for first, last in self.path.runs:
            rows = first + np.flatnonzero(ok[first : last + 1])
            step = np.abs(np.diff(self.q[rows], axis=0)).max(axis=1, initial=0.0)
            apart = (np.diff(rows) != 1) | (step > np.where(np.diff(broke[rows]) > 0, JUMP, FLIP))
            for part in np.split(rows, np.flatnonzero(apart) + 1):
                begin = part if len(part) and part[0] == first else part[np.cumsum(self.path.is_point[part]) > 0]
                keep = np.flatnonzero(self.path.is_point[begin])
                whole = begin if len(begin) and begin[-1] == last else begin[: keep[-1] + 1 if len(keep) else 0]
                if len(whole) > 1 or (len(whole) == 1 and first == last):
                    yield int(whole[0]), int(whole[-1])

    def _feed_after(self) -> Array:
        """(P,) m/s of the move to each point, of the next one with a feed where that is a rapid move."""
        feed = np.where(self.path.feed > 0, self.path.feed, np.nan)
        known = np.flatnonzero(np.isfinite(feed))
        if not len(known):
            return np.full(len(feed), self.options.approach_feed)
        return feed[known[np.minimum(np.searchsorted(known, np.arange(len(feed))), len(known) - 1)]]

    def _rapid(self, a: Array, b: Array, index_a: float, index_b: float, row_a: int, row_b: int) -> None:
        move = plan_rapid(
            a, b, limits=self.plan.setup.driven.limits, scale=self.options.rapid_scale, sample=self.options.sample,
            collision=self.plan.setup.collision, step=self.options.collision_step, rng=self.rng,
            detours=lambda: self._detours(row_a, row_b),
            iterations=SEARCH if not self.obstructions else SEARCH_IN_VAIN,
        )  # fmt: skip
        if isinstance(move, Blocked):
            why = (
                f"{move.pair} at the {move.reason} of the rapid move"
                if move.reason != "way"
                else f"no free way past {move.pair}"
            )
            self.obstructions.append(Obstruction(index_a, index_b, why))
            return
        q, waypoints = move.q, move.waypoints
        if self.plan.setup.correction is not None:
            waypoints = self._told(waypoints)
            q = time_legs(waypoints, self.cell.limits, self.options.rapid_scale, self.options.sample)
        n = len(q)
        if move.kind != "direct":
            self.detours.append(f"{_name(index_a)} → {_name(index_b)}: {move.kind}, {len(waypoints) - 2} way points")
        operation = self.toolpath.operation[round(index_b)] if np.isfinite(index_b) else -1
        self.legs.append(Leg("rapid", q, np.linspace(index_a, index_b, n) if n > 1 else np.array([index_b]),
                             np.full(n, Move.RAPID, np.int8), np.full(n, operation, np.int32), np.full(n, np.nan),
                             waypoints[1:], np.full(len(waypoints) - 1, index_b),
                             np.full(len(waypoints) - 1, np.nan)))  # fmt: skip

    def _detours(self, row_a: int, row_b: int) -> Iterator[Array]:
        """Way points that lift the tool off at either end, or both."""
        for height in LIFTS:
            up_a = self._lifted(row_a, height) if row_a >= 0 else None
            up_b = self._lifted(row_b, height) if row_b >= 0 else None
            for pair in ((up_a, up_b), (up_a, None), (None, up_b)):
                way = [w for w in pair if w is not None]
                if way and len(way) == sum(p is not None for p in pair):
                    yield np.array(way)

    def _lifted(self, row: int, height: float) -> Array | None:
        """The configuration with the tool drawn back along its axis, or None where there is none nearby."""
        arm = self.plan.setup.arm
        q: Array = self.q[row]
        rows = np.array([row], np.int32)
        pose = arm.T_base_workpiece @ tcp_poses(self.path, rows, self.plan.chosen.assignment.phi[rows])[0]
        for share in np.linspace(0.0, height, int(np.ceil(height / LIFT_STEP - 1e-9)) + 1)[1:]:
            lifted = pose.copy()
            lifted[:3, 3] -= share * pose[:3, 2]
            q, error = refine(self.plan.setup.robot, lifted, q, arm.T_flange_tcp, 5)
            if not error < 1e-8 or (q < arm.lower).any() or (q > arm.upper).any():
                return None
        return q

    def _withdrawal(self, row: int) -> float:
        """m along the tool axis until a rapid move may begin; 0 where it may at once, or never."""
        model = self.plan.setup.collision
        if model is None:
            return 0.0
        q = self.q[row][None]
        if not model.check(q, np.array([False])).hit[0] or model.check(q, np.array([True])).hit[0]:
            return 0.0
        for height in WITHDRAWALS:
            up = self._lifted(row, height)
            if (
                up is None
                or model.check_motion(np.vstack([q, up]), np.array([True, True]), self.options.collision_step).any
            ):
                return 0.0
            if not model.check(up[None], np.array([False])).hit[0]:
                self.withdrawn.append((float(self.path.index[row]), height))
                return height
        return 0.0

    def _straight(self, a: Array, b: Array, row: int, move: Move, height: float) -> None:
        """A straight lift or descent along the tool axis; down not faster than the cut that follows."""
        rows = np.array([row, row], np.int32)
        up = np.asarray([height, 0.0]) if move is Move.APPROACH else np.asarray([0.0, height])
        position = self.path.position[rows] + up[:, None] * self.path.axis[rows]
        feed = (
            min(self.options.approach_feed, float(self.feed_after[row]))
            if move is Move.APPROACH
            else self.options.approach_feed
        )
        done = self._retime(position, rows, np.array([a, b]), np.full(2, feed))
        if isinstance(done, RunFailure):
            self.obstructions.append(Obstruction(self.path.index[row], self.path.index[row], done.reason))
            return
        n = len(done.q)
        self.legs.append(Leg("lift", done.q, np.full(n, self.path.index[row]), np.full(n, move, np.int8),
                             np.full(n, self._operation(rows[:1])[0], np.int32), np.full(n, np.nan),
                             self._told(b[None]), self.path.index[rows[:1]], np.array([feed])))  # fmt: skip

    def _touch(self, first: int, last: int) -> None:
        """Points without any way between them: the tool stands there for a sample each."""
        rows = np.r_[first, first, np.arange(first, last + 1)]
        n = len(rows)
        leg = Leg(
            name="run",
            q=np.repeat(self._told(self.q[first][None]), n, axis=0),
            index=self.path.index[rows],
            move=self.path.move[rows],
            operation=self._operation(rows.astype(np.int32)),
            gamma=np.full(n, np.nan),
            waypoints=self._told(self.q[[last]]),
            waypoint_index=self.path.index[[last]],
            waypoint_feed=np.array([self.options.approach_feed]),
        )
        self.legs.append(leg)

    def _run(self, first: int, last: int) -> None:
        rows = np.arange(first, last + 1, dtype=np.int32)
        feed = np.where(self.path.feed[rows] > 0, self.path.feed[rows], self.options.approach_feed)
        done = self._retime(self.path.position[rows], rows, self.q[rows], feed)
        index = self.path.index[rows]
        if isinstance(done, RunFailure):
            at = float(np.interp(done.point, np.arange(len(rows)), index))
            self.obstructions.append(Obstruction(at, at, done.reason))
            return
        local = done.point
        segment = np.clip(np.ceil(local - 1e-9).astype(int), 1, len(rows) - 1)  # the segment a sample lies on
        move = self.path.move[rows][segment]
        below = np.clip(np.floor(local + 1e-9).astype(int), 0, len(rows) - 1)
        move = _every_cut_shown(move, local, index, rows, self.path)
        gamma = done.phi + self.path.offset[rows][below]
        self.phi[rows] = np.interp(np.arange(len(rows)), local, done.phi)
        told = _needed(self.plan.chosen.assignment.phi[rows], self.path.is_point[rows], index, self.path.position[rows])
        told[0] = False  # the move starts there
        cutting = move == Move.CUT
        self.cut_time += float(cutting.sum()) * self.options.sample
        self.held_time += float((cutting & done.held).sum()) * self.options.sample
        self.legs.append(Leg("run", done.q, np.interp(local, np.arange(len(rows)), index), move,
                             self._operation(rows[segment]), gamma,
                             self._told(self.q[rows][told]), index[told], feed[told]))  # fmt: skip
        self.dips += [dip.at(np.interp([dip.first, dip.last], np.arange(len(rows)), index)) for dip in done.dips]

    def _retime(self, position: Array, rows: NDArray[np.int32], q: Array, feed: Array) -> RunTrajectory | RunFailure:
        setup = self.plan.setup
        return retime_run(RunInput(
            position=position, axis=self.path.axis[rows], reference=self.path.reference[rows],
            phi=self.plan.chosen.assignment.phi[rows], q=q, feed=feed,
            T_base_workpiece=setup.arm.T_base_workpiece, T_flange_tcp=setup.arm.T_flange_tcp, robot=setup.robot,
            limits=self.cell.limits, sample=self.options.sample, path_tolerance=self.options.path_tolerance,
            axis_tolerance=self.options.axis_tolerance, limit_scale=self.options.limit_scale,
            correction=setup.correction,
        ))  # fmt: skip

    def _told(self, q: Array) -> Array:
        """(W, 6) encoder angles of true angles."""
        correction = self.plan.setup.correction
        return q if correction is None else correction.encoder_angles(q)

    def _operation(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        return np.asarray(self.toolpath.operation[np.ceil(self.path.index[rows] - 1e-12).astype(int)])

    def _joined(self) -> Trajectory:
        """Legs share their ends; the later one's first row is dropped."""
        first, later = self.legs[0], self.legs[1:]

        def join(name: str) -> NDArray[np.float64]:
            return np.concatenate([getattr(first, name), *(getattr(leg, name)[1:] for leg in later)])

        q = join("q")
        correction = self.plan.setup.correction
        stands = q if correction is None else correction.true_angles(q)
        T = self.plan.setup.robot.fk(stands, self.cell.tool.T_flange_tcp)
        speed = np.r_[0.0, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / self.options.sample]
        return Trajectory(
            time=np.arange(len(q), dtype=float) * self.options.sample,
            q=q,
            external=np.empty((len(q), 0)),
            point=join("index"),
            move=join("move").astype(np.int8),
            operation=join("operation").astype(np.int32),
            gamma=join("gamma"),
            feed=speed,
        )


def _every_cut_shown(
    move: NDArray[np.int8], local: Array, index: Array, rows: NDArray[np.int32], path: Path
) -> NDArray[np.int8]:
    """(S,) moves of the samples, so that each cut point lies between two samples of a cut, or near one.

    Where points are denser than samples, the last points of a cut lie before a sample that already belongs to the
    retract (and the first ones behind a sample of the approach); such samples count to the cut they complete.
    """
    out = move.copy()
    place = np.interp(local, np.arange(len(rows)), index)
    points = 1 + np.flatnonzero((path.move[rows] == Move.CUT)[1:] & path.is_point[rows][1:])
    after = np.clip(np.searchsorted(local, points - 1e-9), 1, len(local) - 1) if len(local) > 1 else points[:0]
    for k, n in zip(index[points[: len(after)]], after, strict=True):
        pair = [n - 1, n]
        near = (np.abs(place[pair] - k) <= 0.5) & (move[pair] == Move.CUT)
        if not near.any():
            out[pair] = Move.CUT
    return out


def _needed(phi: Array, is_point: NDArray[np.bool_], index: Array, position: Array) -> NDArray[np.bool_]:
    """(n,) planning points a program needs: toolpath points, and those where rotation or path leave the straight line.

    The path does so only where it is shifted against a deflection that changes along it.
    """
    keep = is_point.copy()
    keep[[0, -1]] = True
    at = np.flatnonzero(keep)
    line = np.column_stack([np.interp(index, index[at], position[at, c]) for c in range(3)])
    bowed = np.linalg.norm(position - line, axis=1) > BOW
    return np.asarray(keep | bowed | (np.abs(phi - np.interp(np.arange(len(phi)), at, phi[at])) > BEND))


def _name(index: float) -> str:
    return "home" if not np.isfinite(index) else f"point {index:g}"

"""Planner of single legs of the motion: a rapid move, a lift along the tool axis, a run at the feed, a touch.

Where the cell has kinematic corrections, the plan's configurations are true angles and a leg has the encoder angles
sent to the robot: runs are timed in them, rapid moves are straight in them.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.cache import compute_cached
from machopt.planning.motion.blocked_rapid_break import RestPose, build_blocked_break
from machopt.planning.motion.depth_below_cuts import BELOW, CutSurface
from machopt.planning.motion.motion_segment import (
    MotionSegment,
    count_rest_samples,
    label_cut_samples,
    select_program_points,
)
from machopt.planning.motion.rapid_chain import CornerSpace
from machopt.planning.motion.rapid_moves import (
    BlockedRapid,
    FreeSpace,
    RapidTiming,
    plan_rapid,
    retime_straight_segments,
)
from machopt.planning.motion.retract_moves import RetractMoves
from machopt.planning.motion.straight_rapid_collisions import Way, build_rapid_key
from machopt.planning.motion.tilted_motion import compute_tip_speed_share, limit_tilted_rounding
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak, build_undriven_break
from machopt.planning.retiming.path_curve import SPIN_TOLERANCE
from machopt.planning.retiming.run_retiming import RunFailure, RunInput, RunTrajectory, retime_run
from machopt.planning.retiming.slowdowns import FeedSlowdown


class SegmentPlanner:
    """Planner of one leg of a plan at a time; slowdowns, detours and time at the feed accumulate."""

    def __init__(self, plan: Plan, toolpath: Toolpath, lifts: RetractMoves) -> None:
        self.plan, self.toolpath, self.lifts = plan, toolpath, lifts
        self.options, self.path = plan.options, plan.path
        self.q = plan.chosen.assignment.q
        self.phi = plan.chosen.assignment.phi.copy()  # replaced by the driven rotation after each run
        self.feed_after = self._compute_feed_after()
        self.rests = count_rest_samples(toolpath, self.options.sample)
        self.rng = np.random.default_rng(self.options.seed)
        self.dips: list[FeedSlowdown] = []
        self.detours: list[str] = []
        self.cut_time = self.held_time = 0.0
        self.free: frozenset[Way] = frozenset()  # straight rapid moves known to be free
        self.level = CutSurface.build(plan.setup.cell, toolpath)
        self.graze = BELOW + self._measure_shift()
        self.cuts = CutSurface.list_near(plan.setup.cell, toolpath, plan.options.rapid_blend)

    def rapid(self, a: RestPose, b: RestPose, extensions: int) -> MotionSegment | SequenceBreak:
        """Return the rapid move between two rest poses, or the break where none is found.

        Args:
            a: start.
            b: end.
            extensions: maximum number of extensions of the random tree.
        """
        move = plan_rapid(
            a.x,
            b.x,
            timing=RapidTiming(
                self.plan.setup.driven.limits,
                self.options.rapid_scale,
                self.options.sample,
                self.options.rapid_blend > 0.0,
            ),
            space=FreeSpace(
                collision=self.plan.setup.collision,
                step=self.options.collision_step,
                per_rad=self.plan.setup.per_rad,
                barred=self._passes_below_cut if self._stays_above_cuts(a, b) else None,
            ),
            rng=self.rng,
            detours=lambda: self.lifts.detours(a.row, b.row),
            iterations=extensions,
            known_free=build_rapid_key(a.x, b.x) in self.free,
        )
        if isinstance(move, BlockedRapid):
            return build_blocked_break(move, a, b)
        x, waypoints = move.q, move.waypoints
        if self.plan.setup.correction is not None:
            waypoints = self._convert_to_encoder_angles(waypoints)
            x = retime_straight_segments(
                waypoints, self.plan.setup.cell.limits, self.options.rapid_scale, self.options.sample
            )
        if len(x) == 1 and np.isfinite(a.index) and np.isfinite(b.index):
            x = np.repeat(x, 2, axis=0)  # the file lists one place twice: a sample for the second, too
        n = len(x)
        if move.kind != "direct":
            via = len(waypoints) - 2
            self.detours.append(f"{a.name} → {b.name}: {move.kind}, {via} way point{'' if via == 1 else 's'}")
        operation = self.toolpath.operation[round(b.index)] if np.isfinite(b.index) else -1
        return MotionSegment(
            name="rapid",
            q=x[:, :6],
            index=np.linspace(a.index, b.index, n) if n > 1 else np.array([b.index]),
            move=np.full(n, MoveKind.RAPID, np.int8),
            operation=np.full(n, operation, np.int32),
            gamma=np.full(n, np.nan),
            waypoints=waypoints[1:, :6],
            waypoint_index=np.full(len(waypoints) - 1, b.index),
            waypoint_feed=np.full(len(waypoints) - 1, np.nan),
            external=x[:, 6:],
            waypoint_external=waypoints[1:, 6:],
        )

    def _stays_above_cuts(self, a: RestPose, b: RestPose) -> bool:
        """Return whether a rapid move has to stay above the cuts: any except one from or to a home below one of
        them.
        """
        resting = [place.x for place in (a, b) if not np.isfinite(place.index) and not place.change]
        return self.level is not None and not (resting and self._passes_below_cut(np.array(resting)))

    def _passes_below_cut(self, x: Array) -> bool:
        """Return whether a rapid move (S, 6 + E) passes below a cut."""
        assert self.level is not None  # called only then
        arm = self.plan.setup.arm
        return self.level.under(arm.machine.compute_fk(x, arm.T_flange_tcp)) > self.graze

    def build_corner_space(self) -> CornerSpace:
        """Return what the rounded corners of rapid moves have to keep."""
        setup, options = self.plan.setup, self.options
        correction = setup.correction
        limits = setup.driven.limits if correction is None else setup.cell.limits
        return CornerSpace(
            timing=RapidTiming(limits, options.rapid_scale, options.sample),
            collision=setup.collision,
            step=options.collision_step,
            deviation=max(options.rapid_blend - self._measure_rapid_shift(), 0.0),
            compute_tcp=lambda x: setup.arm.machine.compute_fk(x, setup.arm.T_flange_tcp),
            compute_true=lambda x: (
                x if correction is None else np.hstack([correction.compute_true_angles(x[:, :6]), x[:, 6:]])
            ),
            barred=None if self.level is None else self._passes_below_cut,
            is_above_cuts=self._is_above_cuts,
        )

    def _measure_rapid_shift(self) -> float:
        """Return the largest distance in m of the tool at rapid points from those of the file: a shift or a tilt."""
        rows = np.flatnonzero(self.path.is_point & (self.path.move == MoveKind.RAPID))
        arm = self.plan.setup.arm
        x = self.path.whole(self.q[rows], rows.astype(np.int32))
        known = np.isfinite(x).all(axis=1)
        if not known.any():
            return 0.0
        place = arm.machine.compute_fk(x[known], arm.T_flange_tcp)[:, :3, 3]
        stated = self.toolpath.position[np.round(self.path.index[rows[known]]).astype(int)]
        return float(np.linalg.norm(place - stated, axis=1).max())

    def _is_above_cuts(self, x: Array) -> bool:
        """Return whether true angles (S, 6 + E) are above all cuts that a moved corner may come near to."""
        arm = self.plan.setup.arm
        return self.cuts is None or self.cuts.is_below(arm.machine.compute_fk(x, arm.T_flange_tcp))

    def _measure_shift(self) -> float:
        """Return the distance in m of the commanded cuts from those of the file: a free move begins where a shifted
        cut ends.
        """
        rows = np.flatnonzero(self.path.is_point)
        away = self.path.position[rows] - self.toolpath.position[np.round(self.path.index[rows]).astype(int)]
        return float(np.linalg.norm(away, axis=1).max(initial=0.0))

    def straight(self, a: Array, b: Array, row: int, move: MoveKind, height: float) -> MotionSegment | SequenceBreak:
        """Return a straight retract or approach along the tool axis; an approach is not faster than the cut that
        follows.

        Args:
            a: (6 + E,) rad or m, start, true angles.
            b: (6 + E,) rad or m, end, true angles.
            row: planning point at its lower end.
            move: RETRACT or APPROACH.
            height: m along the tool axis.
        """
        rows = np.array([row, row], np.int32)
        up = np.asarray([height, 0.0]) if move is MoveKind.APPROACH else np.asarray([0.0, height])
        position = self.path.position[rows] + up[:, None] * self.path.axis[rows]
        feed = (
            min(self.options.approach_feed, float(self.feed_after[row]))
            if move is MoveKind.APPROACH
            else self.options.approach_feed
        )
        done = self._retime(position, rows, np.array([a[:6], b[:6]]), np.full(2, feed))
        if isinstance(done, RunFailure):
            at = float(self.path.index[row])
            return build_undriven_break(at, at, done.reason)
        n = len(done.q)
        return MotionSegment(
            name="lift",
            q=done.q,
            index=np.full(n, self.path.index[row]),
            move=np.full(n, move, np.int8),
            operation=np.full(n, self._get_operations(rows[:1])[0], np.int32),
            gamma=np.full(n, np.nan),
            waypoints=self._convert_to_encoder_angles(b[None, :6]),
            waypoint_index=self.path.index[rows[:1]],
            waypoint_feed=np.array([feed]),
            external=done.external,
            waypoint_external=b[None, 6:],
        )

    def touch(self, first: int, last: int) -> MotionSegment:
        """Return a leg for points without distance between them: the tool rests there for one sample each.

        Args:
            first: first planning point.
            last: last planning point.
        """
        rows = np.r_[first, first, np.arange(first, last + 1)]
        n = len(rows)
        leg = MotionSegment(
            name="run",
            q=np.repeat(self._convert_to_encoder_angles(self.q[first][None]), n, axis=0),
            index=self.path.index[rows],
            move=self.path.move[rows],
            operation=self._get_operations(rows.astype(np.int32)),
            gamma=np.full(n, np.nan),
            waypoints=self._convert_to_encoder_angles(self.q[[last]]),
            waypoint_index=self.path.index[[last]],
            waypoint_feed=self.path.feed[[last]]
            if self.path.feed[last] > 0
            else np.array([self.options.approach_feed]),
            external=np.repeat(self.path.external[[first]], n, axis=0),
            waypoint_external=self.path.external[[last]],
        )
        for k in range(last - 1, first, -1):  # the file dwells between two of them
            leg = leg.standing(2 + k - first, self.samples_at(k))
        return leg

    def run(self, first: int, last: int) -> MotionSegment | SequenceBreak:
        """Return a run at the feed, or the break where it cannot be driven.

        Args:
            first: first planning point.
            last: last planning point.
        """
        rows = np.arange(first, last + 1, dtype=np.int32)
        feed = np.where(self.path.feed[rows] > 0, self.path.feed[rows], self.options.approach_feed)
        index = self.path.index[rows]
        rests = [
            n for n in np.searchsorted(index, np.array(sorted(self.rests)) - 1e-9).tolist() if 0 < n < len(rows) - 1
        ]
        rests = [n for n in rests if round(float(index[n])) in self.rests and self.path.is_point[rows[n]]]
        tip_feed = feed * compute_tip_speed_share(self.path, rows, self.plan.setup.ball_radius)
        done = self._retime(self.path.position[rows], rows, self.q[rows], tip_feed, tuple(rests))
        if isinstance(done, RunFailure):
            at = float(np.interp(done.point, np.arange(len(rows)), index))
            return build_undriven_break(at, at, done.reason)
        local = done.point
        segment = np.clip(np.ceil(local - 1e-9).astype(int), 1, len(rows) - 1)  # segment of each sample
        move = self.path.move[rows][segment]
        below = np.clip(np.floor(local + 1e-9).astype(int), 0, len(rows) - 1)
        move = label_cut_samples(move, local, index, rows, self.path)
        gamma = done.phi + self.path.offset[rows][below]
        self.phi[rows] = np.interp(np.arange(len(rows)), local, done.phi)
        phi = self.plan.chosen.assignment.phi[rows]
        is_target = select_program_points(
            phi, self.path.is_point[rows], index, self.path.position[rows], self.path.axis[rows]
        )
        if np.ptp(self.path.external[rows], axis=0).any():
            is_target[:] = True  # between two targets the controller interpolates linearly
        is_target[0] = False  # the move starts there
        cutting = move == MoveKind.CUT
        self.cut_time += float(cutting.sum()) * self.options.sample
        self.held_time += float((cutting & done.held).sum()) * self.options.sample
        self.dips += [dip.at(np.interp([dip.first, dip.last], np.arange(len(rows)), index)) for dip in done.dips]
        leg = MotionSegment(
            name="run",
            q=done.q,
            index=np.interp(local, np.arange(len(rows)), index),
            move=move,
            operation=self._get_operations(rows[segment]),
            gamma=gamma,
            waypoints=self._convert_to_encoder_angles(self.q[rows][is_target]),
            waypoint_index=index[is_target],
            waypoint_feed=feed[is_target],
            external=done.external,
            waypoint_external=self.path.external[rows][is_target],
        )
        for n, row in reversed(list(zip(rests, done.rests, strict=True))):
            leg = leg.standing(row, self.samples_at(first + n))
        return leg

    def _retime(
        self, position: Array, rows: NDArray[np.int32], q: Array, feed: Array, rests: tuple[int, ...] = ()
    ) -> RunTrajectory | RunFailure:
        setup = self.plan.setup
        rounding = self.plan.rounding.get(int(self.path.run[rows[0]]), 1.0)
        corner, lean = limit_tilted_rounding(self.options, self.path, setup.ball_radius)
        run = RunInput(
            position=position,
            axis=self.path.axis[rows],
            reference=self.path.reference[rows],
            phi=self.plan.chosen.assignment.phi[rows],
            q=q,
            feed=feed,
            machine=setup.arm.machine,
            external=self.path.external[rows],
            T_flange_tcp=setup.arm.T_flange_tcp,
            robot=setup.robot,
            limits=self.plan.setup.cell.limits,
            sample=self.options.sample,
            path_tolerance=rounding * corner,
            axis_tolerance=rounding * lean,
            spin_tolerance=rounding * SPIN_TOLERANCE,
            limit_scale=self.options.limit_scale,
            correction=setup.correction,
            rests=rests,
        )
        values = tuple(getattr(run, f.name) for f in fields(run))
        return compute_cached("retime", lambda: values, lambda: retime_run(run))

    def samples_at(self, row: int) -> int:
        """Return how many samples the machine rests at a planning point.

        Args:
            row: planning point.
        """
        return self.rests.get(round(float(self.path.index[row])), 0) if self.path.is_point[row] else 0

    def _compute_feed_after(self) -> Array:
        """(P,) m/s of the move to each point, of the next one with a feed where that is a rapid move."""
        feed = np.where(self.path.feed > 0, self.path.feed, np.nan)
        known = np.flatnonzero(np.isfinite(feed))
        if not len(known):
            return np.full(len(feed), self.options.approach_feed)
        return feed[known[np.minimum(np.searchsorted(known, np.arange(len(feed))), len(known) - 1)]]

    def _convert_to_encoder_angles(self, q: Array) -> Array:
        """Return (W, 6 or more) encoder angles of true angles; columns after the arm's joints are unchanged."""
        correction = self.plan.setup.correction
        return q if correction is None else np.hstack([correction.compute_encoder_angles(q[:, :6]), q[:, 6:]])

    def _get_operations(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        return np.asarray(self.toolpath.operation[np.ceil(self.path.index[rows] - 1e-12).astype(int)])

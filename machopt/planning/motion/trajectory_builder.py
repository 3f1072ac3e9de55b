"""The whole motion in time: home → rapid → run → rapid → … → home, one row per control sample.

Runs are retimed at the programmed feed (:mod:`machopt.planning.retiming.run_retiming`). Rapid moves go straight in
joint space (:mod:`machopt.planning.motion.rapid_moves`), round the corners between them where that is free
(:mod:`machopt.planning.motion.rapid_corners`), and are checked for collisions like everything else.
Where points were dropped (``allow_gaps``) the tool lifts along its axis, crosses the gap by a rapid move and
approaches again. Where the CAM file leaves or enters the workpiece in a rapid move (a drill retracted, a cut without
approach), the tool moves straight along its axis at a feed until it is out, and only then in rapid. Where the file
dwells or stops, the machine comes to rest at that point for the programmed time.

Where the cell has kinematic corrections, the plan's configurations are true angles, and the result has the encoder
angles sent to the robot: runs are timed in them, rapid moves are straight in them. Rapid moves were checked
for collisions straight in true angles. The difference is the change of the corrections along the move.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.data_types.trajectory import Trajectory
from machopt.numerics.array_types import Array
from machopt.numerics.identity_cache import IdentityCache
from machopt.planning.motion.blocked_rapid_break import RestPose
from machopt.planning.motion.motion_segment import BEFORE_ALL, MotionSegment
from machopt.planning.motion.rapid_corners import list_rounded_corners, round_rapid_corners
from machopt.planning.motion.retract_moves import RetractMoves, compute_rest_poses
from machopt.planning.motion.segment_planner import SegmentPlanner
from machopt.planning.motion.tilted_motion import SampleTilts, limit_cut_tilts, measure_sample_tilts
from machopt.planning.pipeline.gaps import Stretch, find_driven_stretches, find_uncut_points, is_worth_driving
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment, StageTimings
from machopt.planning.pipeline.sequence_breaks import NO_WAY_FOUND, SequenceBreak
from machopt.planning.retiming.slowdowns import FeedSlowdown

SEARCH = 2000  # extensions of the random tree for a rapid move without a simpler solution
SEARCH_IN_VAIN = 100  # the same after a stretch was given up, or after SEARCHED blocked moves
SEARCHED = 6
BLOCK = 20_000  # samples per block of frames


@dataclass(frozen=True, kw_only=True)
class MotionTimeline:
    """The motion with its slowdowns and obstructions."""

    trajectory: Trajectory | None  # None where something stops it
    dips: tuple[FeedSlowdown, ...]  # with toolpath indices
    obstructions: tuple[SequenceBreak, ...]  # rapid moves without a collision-free path, runs that cannot be driven
    detours: tuple[str, ...]  # rapid moves that could not go straight
    legs: tuple[MotionSegment, ...]
    held_share: float  # of the cutting time at ≥ 95 % of the programmed feed
    phi: Array  # (P,) rad, the rotation as driven: a little smoother than planned
    driven: tuple[Stretch, ...] = ()  # first and last planning point of each stretch driven
    given_up: dict[Stretch, str] = field(default_factory=dict)  # stretches left out (``allow_gaps``) with the reason


_KNOWN: IdentityCache[ScoredAssignment, list[tuple[tuple[object, ...], MotionTimeline]]] = IdentityCache()


def build_timeline(plan: Plan, toolpath: Toolpath, progress: Callable[[float], None] | None = None) -> MotionTimeline:
    """Compute the motion of the chosen assignment from home through every run and back home.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
        progress: called with the completed share, 0 … 1.
    """
    inputs, known = _list_inputs(plan, toolpath), _KNOWN.get(plan.chosen, lambda _: [])
    for own, timeline in known:
        if all(a is b or (isinstance(a, dict) and a == b) for a, b in zip(own, inputs, strict=True)):
            known.clear()
            return timeline
    return _Builder(plan, toolpath, progress or (lambda _: None)).build()


def _list_inputs(plan: Plan, toolpath: Toolpath) -> tuple[object, ...]:
    """Return what a motion depends on."""
    return (toolpath, plan.setup, plan.options, plan.path, plan.begin, plan.end, plan.rounding, plan.breaks)


def plan_motion(plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: StageTimings) -> MotionTimeline | None:
    """Return the motion; None where points are missing without the user's permission.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
        options: plan options with ``allow_gaps``.
        timings: receives the duration of the stages.
    """
    path, missing = plan.path, plan.missing
    cut = path.counted
    needed = missing[path.may_touch[missing] | path.is_point[missing]]  # rapid points may be bypassed
    if (len(needed) or plan.breaks) and not options.allow_gaps:
        return None
    if cut.any() and not np.setdiff1d(np.flatnonzero(cut), missing).size:
        return None
    with timings.stage("retime"):
        return build_timeline(plan, toolpath)


def has_motion(plan: Plan, toolpath: Toolpath) -> bool:
    """Return whether the chosen assignment can be driven; the search ends at the first obstruction.

    A complete motion is stored for :func:`build_timeline`.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
    """
    builder = _Builder(plan, toolpath, lambda _: None)
    builder.first_only = True
    timeline = builder.build()
    if timeline.trajectory is None:
        return False
    _KNOWN.get(plan.chosen, lambda _: [])[:] = [(_list_inputs(plan, toolpath), timeline)]
    return True


class _Builder:
    def __init__(self, plan: Plan, toolpath: Toolpath, progress: Callable[[float], None]) -> None:
        self.plan, self.toolpath, self.progress = plan, toolpath, progress
        self.options, self.path = plan.options, plan.path
        self.x = plan.path.whole(plan.chosen.assignment.q)  # (P, 6 + E) with the external joints
        self.lifts = RetractMoves(plan)
        self.made = SegmentPlanner(plan, toolpath, self.lifts)
        self.legs: list[MotionSegment] = []
        self.obstructions: list[SequenceBreak] = []
        self.withdrawn: list[tuple[float, float]] = []  # toolpath index, m
        self.driven: list[Stretch] = []
        self.run_starts, self.run_ends = {a for a, _ in self.path.runs}, {b for _, b in self.path.runs}
        self.given_up: dict[Stretch, str] = {}
        self.in_the_way: list[SequenceBreak] = []  # causes for which stretches were given up
        self.first_only = False  # end at the first obstruction

    def build(self) -> MotionTimeline:
        here, home = (
            RestPose(rest, float("nan"), -1, encoder_angles is not None)
            for rest, encoder_angles in zip(
                compute_rest_poses(self.plan), (self.plan.begin, self.plan.end), strict=True
            )
        )
        reason, breaks = self.plan.chosen.assignment.reason, self.plan.breaks
        pieces = find_driven_stretches(self.path, reason, breaks)
        self.made.free = self.lifts.free_between(pieces)
        for n, (first, last) in enumerate(pieces):
            here = self._stretch(here, first, last) or here
            if self.first_only and self.obstructions:
                break
            self.progress((n + 1) / max(len(pieces), 1))
        decided = self.first_only and self.obstructions
        back = self.obstructions[0] if decided else self._plan_rapid(here, home)
        if isinstance(back, SequenceBreak):
            self.obstructions.append(back)
        else:
            self.legs.append(back)
        if self.legs:
            self.legs[0] = self.legs[0].standing(0, self.made.rests.get(BEFORE_ALL, 0))
        if self.withdrawn:
            places = ", ".join(f"{index:g}" for index, _ in self.withdrawn[:8]) + (
                " …" if len(self.withdrawn) > 8 else ""
            )
            self.made.detours.append(
                f"in the workpiece at its start or end, at point {places}: there the tool is first drawn straight "
                f"along its axis at a feed, by up to {1e3 * max(height for _, height in self.withdrawn):.0f} mm"
            )
        if not find_uncut_points(self.path, []).sum() > find_uncut_points(self.path, self.driven).sum():
            self.obstructions += [b for b in self.in_the_way if b not in self.obstructions]  # no cut remains
        if not self.obstructions and self.options.rapid_blend > 0.0:
            self.legs = round_rapid_corners(self.legs, self.toolpath, self.made.build_corner_space())
        trajectory = None if self.obstructions else self._join_legs()
        held_share = self.made.held_time / self.made.cut_time if self.made.cut_time > 0 else 1.0
        return MotionTimeline(
            trajectory=trajectory,
            dips=tuple(self.made.dips),
            obstructions=tuple(self.obstructions),
            detours=tuple(self.made.detours),
            legs=tuple(self.legs),
            held_share=held_share,
            phi=self.made.phi,
            driven=tuple(self.driven),
            given_up=self.given_up,
        )

    def _stretch(self, here: RestPose, first: int, last: int) -> RestPose | None:
        """Drive one stretch from ``here``; return its end, None where it cannot be driven.

        After a rapid move without a solution the remaining stretches are driven anyway, so that every obstruction is
        reported.
        """
        requested = (first, last)
        while True:
            found = self._build_legs(here, first, last)
            if not isinstance(found, SequenceBreak):
                break
            if not self.options.allow_gaps:
                self.obstructions.append(found)
                if found.code not in NO_WAY_FOUND:
                    return None
                height = self.lifts.withdrawal(last)  # the next part is checked separately
                end = self.lifts.lifted(last, height) if height else self.x[last]
                return None if end is None else RestPose(end, float(self.path.index[last]), last)
            self.in_the_way.append(found)
            shorter = self._shorten_stretch(found, first, last)
            if shorter is None:
                self.given_up[requested] = f"left out with the stretch it is in: {found.text} ({found.where})"
                return None
            self.given_up[requested] = f"the cut to it is left out: {found.text} ({found.where})"
            first, last = shorter
        legs, end = found
        self.legs += legs
        self.driven.append((first, last))
        return end

    def _shorten_stretch(self, why: SequenceBreak, first: int, last: int) -> Stretch | None:
        """Return the stretch without its first or last toolpath point, if that one blocks it; None where nothing
        remains.
        """
        if why.code != "no_room":
            return None
        points = first + np.flatnonzero(self.path.is_point[first : last + 1])
        inner = points[points > first] if why.after == self.path.index[first] else points[points < last]
        if len(inner) < 2:
            return None
        cut = (int(inner[0]), last) if why.after == self.path.index[first] else (first, int(inner[-1]))
        return cut if is_worth_driving(self.path, *cut) else None

    def _build_legs(
        self, here: RestPose, first: int, last: int
    ) -> tuple[list[MotionSegment], RestPose] | SequenceBreak:
        """The rapid move to a stretch, the stretch itself, and lifts where it starts or ends in the workpiece."""
        index = self.path.index
        lifted = self.path.is_reentry
        gap_in = bool(lifted[first]) or first not in self.run_starts
        gap_out = bool(lifted[last + 1 : last + 2].any()) or last not in self.run_ends
        lift_in = self.lifts.gap(first) if gap_in else self._compute_withdrawal(first)
        lift_out = self.lifts.gap(last) if gap_out else lift_in if first == last else self._compute_withdrawal(last)
        if np.isnan(lift_in):
            return self._build_no_room_break(here.index, float(index[first]))
        if np.isnan(lift_out):
            return self._build_no_room_break(
                float(index[last]), float("nan") if last + 1 == len(index) else float(index[last + 1])
            )
        start = self.lifts.lifted(first, lift_in) if lift_in else self.x[first]
        end = self.lifts.lifted(last, lift_out) if lift_out else self.x[last]
        if start is None or end is None:
            raise AssertionError("a lift that was found is there")
        to = self._plan_rapid(here, RestPose(start, float(index[first]), first))
        if isinstance(to, SequenceBreak):
            return to
        down = self.made.straight(start, self.x[first], first, MoveKind.APPROACH, lift_in) if lift_in else None
        up = self.made.straight(self.x[last], end, last, MoveKind.RETRACT, lift_out) if lift_out else None
        run: MotionSegment | SequenceBreak | None = None
        rapid_leg: MotionSegment | None = None
        if isinstance(down, SequenceBreak) or isinstance(up, SequenceBreak):
            return down if isinstance(down, SequenceBreak) else up  # type: ignore[return-value]  # one of them is a break
        if last > first and np.ptp(self.path.s[first : last + 1]) > 0:
            begin = self._find_last_coincident(first, last)
            rapid_leg = self.made.touch(first, begin) if begin > first else None
            run = self.made.run(begin, last)
        elif last > first or self.path.move[first] != MoveKind.RAPID:
            run = self.made.touch(first, last)
        if isinstance(run, SequenceBreak):
            return run
        legs = [leg for leg in (to, down) if leg is not None]
        if run is not None and last > first:  # the rest at its start is before the run
            legs[-1] = legs[-1].standing(-1, self.made.samples_at(first))
        if rapid_leg is not None:
            legs.append(rapid_leg.standing(-1, self.made.samples_at(begin)))
        legs += [] if run is None else [run]
        legs[-1] = legs[-1].standing(-1, self.made.samples_at(last))
        return legs + ([] if up is None else [up]), RestPose(end, float(index[last]), last)

    def _find_last_coincident(self, first: int, last: int) -> int:
        """Return the last planning point coincident with the start of a stretch, if the file rests there after its
        first one.

        A motion along the path passes such points at once and could not rest at one of them.
        """
        there = first + int(np.searchsorted(self.path.s[first : last + 1] - self.path.s[first], 0.0, side="right")) - 1
        index = self.path.index[first + 1 : there + 1]
        return there if any(round(float(i)) in self.made.rests for i in index) else first

    def _build_no_room_break(self, before: float, after: float) -> SequenceBreak:
        return SequenceBreak(
            before=before,
            after=after,
            code="no_room",
            text="there is not enough free space to retract the tool at the gap",
            help="more free space above the part, or another pose of the part, would help",
        )

    def _plan_rapid(self, a: RestPose, b: RestPose) -> MotionSegment | SequenceBreak:
        return self.made.rapid(
            a, b, SEARCH if len(self.obstructions) < SEARCHED and not self.given_up else SEARCH_IN_VAIN
        )

    def _compute_withdrawal(self, row: int) -> float:
        """Return the retract in m along the tool axis until a rapid move may begin; 0 if it may at once, or never."""
        height = self.lifts.withdrawal(row)
        if height:
            self.withdrawn.append((float(self.path.index[row]), height))
        return height

    def _compute_feed_positions(self, q: Array, external: Array) -> tuple[Array, Array]:
        """Return (S, 3) m, the TCP where the feed is measured: in the workpiece frame where an external joint moves
        it; and (S, 3, 3) its rotation there, (0, 3, 3) where no tool axis is tilted.
        """
        setup, T_flange_tcp = self.plan.setup, self.plan.setup.cell.tool.T_flange_tcp
        is_tilted = self.path.untilted is not None
        out, rotation = np.empty((len(q), 3)), np.empty((len(q) if is_tilted else 0, 3, 3))
        for start in range(0, len(q), BLOCK):  # the frames of all joints need much more memory than the result
            some = slice(start, start + BLOCK)
            if not setup.arm.machine.external_count:
                T = setup.robot.compute_fk(q[some], T_flange_tcp)
            else:
                T = setup.arm.machine.compute_fk(np.hstack([q[some], external[some]]), T_flange_tcp)
            out[some] = T[:, :3, 3]
            if is_tilted:
                rotation[some] = T[:, :3, :3]
        return out, rotation

    def _join_legs(self) -> Trajectory:
        """Join the legs; they share their ends, so the first row of the later one is dropped."""
        first, later = self.legs[0], self.legs[1:]

        def join(name: str) -> NDArray[np.float64]:
            return np.concatenate([getattr(first, name), *(getattr(leg, name)[1:] for leg in later)])

        q = join("q")
        correction = self.plan.setup.correction
        true_angles = q if correction is None else correction.compute_true_angles(q)
        external = join("external")
        place, rotation = self._compute_feed_positions(true_angles, external)
        step = np.diff(place, axis=0)
        move, index, gamma = join("move").astype(np.int8), join("index"), join("gamma")
        operation = join("operation").astype(np.int32)
        lead = side = None
        if self.path.untilted is not None:
            tilts, fixed = self._measure_tilts(index, move, rotation)
            fed = np.isfinite(index) & (move != MoveKind.RAPID)
            step -= np.where((fed[1:] & fed[:-1])[:, None], np.diff(tilts.away @ fixed.T, axis=0), 0.0)
            gamma = np.where(np.isfinite(gamma), tilts.gamma, gamma)
            ranges = [self.options.tilt_range_of(operation.label) for operation in self.toolpath.operations]
            lead, side = limit_cut_tilts((tilts.lead, tilts.side), move, operation, ranges)
        speed = np.r_[0.0, np.linalg.norm(step, axis=1) / self.options.sample]
        self.legs = _share_samples(self.legs, {"q": q, "external": external, "index": index})
        return Trajectory(
            time=np.arange(len(q), dtype=float) * self.options.sample,
            q=q,
            external=external,
            point=index,
            move=move,
            operation=operation,
            gamma=gamma,
            feed=speed,
            lead=lead,
            side=side,
            corners=list_rounded_corners(self.legs),
        )

    def _measure_tilts(self, index: Array, move: NDArray[np.int8], rotation: Array) -> tuple[SampleTilts, Array]:
        """Return the tilts of the samples, and the rotation (3, 3) from the workpiece to where the feed is measured."""
        setup = self.plan.setup
        fixed = np.eye(3) if setup.arm.machine.external_count else setup.arm.machine.T_base_workpiece_zero[:3, :3]
        return measure_sample_tilts(self.path, index, move, fixed.T @ rotation, setup.ball_radius), fixed


def _share_samples(legs: Sequence[MotionSegment], joined: dict[str, Array]) -> list[MotionSegment]:
    """Return the legs with views of the joined samples, so that they are held in memory once.

    A column of a leg that begins with another value than the leg before ended with stays its own.

    Args:
        legs: legs of the motion, each beginning with the last sample of the one before.
        joined: by the name of a column, (S, ...) its joined samples.
    """
    shared, start = [], 0
    for leg in legs:
        rows = slice(start, start + len(leg.q))
        views: dict[str, Any] = {name: values[rows] for name, values in joined.items()}
        same = {
            name: view for name, view in views.items() if np.array_equal(view[0], getattr(leg, name)[0], equal_nan=True)
        }
        shared.append(replace(leg, **same))
        start = rows.stop - 1
    return shared

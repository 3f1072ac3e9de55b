"""The whole motion in time: home → rapid → run → rapid → … → home, one row a control sample.

Runs are retimed at the programmed feed (:mod:`machopt.plan.retime`), rapid moves go from rest to rest in joint
space (:mod:`machopt.plan.rapids`) and are checked for collisions like everything else. Where points were dropped
(``allow_gaps``) the tool lifts along its axis, goes over by a rapid move and comes down again. Where the CAM file
leaves or enters the workpiece in a rapid move (a drill drawn out, a cut without approach), the tool goes straight
along its axis at a feed until it is out, and only then in rapid. Where the file dwells or stops, the machine comes to
rest at that very point and stands there as long as the file says.

Where the cell has kinematic corrections, the plan's configurations are true angles and everything in the result is told
to the robot, so in encoder angles: runs are timed in them, rapid moves are straight in them. Rapid moves were checked
for collisions straight in true angles, which differ by how much the corrections change on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Move, Toolpath
from machopt.domain.trajectory import Trajectory
from machopt.plan.breaks import Break, not_driven, place
from machopt.plan.dips import Dip
from machopt.plan.gaps import Stretch, stretches, uncut, worth
from machopt.plan.kept import recalled
from machopt.plan.legs import BEFORE_ALL, Leg, every_cut_shown, needed, rests
from machopt.plan.lifts import Lifts, rests_of
from machopt.plan.made import Plan
from machopt.plan.path import Path
from machopt.plan.rapids import Blocked, plan_rapid, time_legs
from machopt.plan.retime import RunFailure, RunInput, RunTrajectory, retime_run
from machopt.plan.straight import Way, way_between

SEARCH = 2000  # extensions of the random tree for a rapid move that nothing simpler frees
SEARCH_IN_VAIN = 100  # the same once another move is known to be stuck


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """The motion, what slows it, and what stops it."""

    trajectory: Trajectory | None  # None where something stops it
    dips: tuple[Dip, ...]  # with toolpath indices
    obstructions: tuple[Break, ...]  # rapid moves no free way was found for, runs that cannot be driven
    detours: tuple[str, ...]  # rapid moves that could not go straight
    legs: tuple[Leg, ...]
    held_share: float  # of the cutting time at ≥ 95 % of the programmed feed
    phi: Array  # (P,) rad, the rotation as driven: a little smoother than planned
    driven: tuple[Stretch, ...] = ()  # first and last planning point of each stretch driven
    given_up: dict[Stretch, str] = field(default_factory=dict)  # stretches left out (``allow_gaps``) and why


@dataclass(frozen=True)
class _Place:
    """Where the machine stands between two stretches."""

    x: Array  # (6 + E,) rad or m, true angles
    index: float  # along the toolpath, NaN at home
    row: int  # planning point, −1 at home
    change: bool = False  # tools are changed there

    @property
    def name(self) -> str:
        return "the tool change" if self.change else place(self.index)


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
        self.x = plan.path.whole(self.q)  # (P, 6 + E) with the external joints
        self.feed_after = self._feed_after()
        self.phi = plan.chosen.assignment.phi.copy()
        self.legs: list[Leg] = []
        self.dips: list[Dip] = []
        self.obstructions: list[Break] = []
        self.detours: list[str] = []
        self.withdrawn: list[tuple[float, float]] = []  # toolpath index, m
        self.driven: list[Stretch] = []
        self.given_up: dict[Stretch, str] = {}
        self.in_the_way: list[Break] = []  # what stretches were given up for
        self.cut_time = self.held_time = 0.0
        self.rests = rests(toolpath, self.options.sample)
        self.rng = np.random.default_rng(self.options.seed)
        self.lifts = Lifts(plan)
        self.free: frozenset[Way] = frozenset()  # straight rapid moves known to be free

    def build(self) -> Timeline:
        here, home = (
            _Place(rest, float("nan"), -1, told is not None)
            for rest, told in zip(rests_of(self.plan), (self.plan.begin, self.plan.end), strict=True)
        )
        reason, breaks = self.plan.chosen.assignment.reason, self.plan.breaks
        pieces = stretches(self.path, reason, breaks)
        self.free = self.lifts.free_between(pieces)
        for n, (first, last) in enumerate(pieces):
            here = self._stretch(here, first, last) or here
            self.progress((n + 1) / max(len(pieces), 1))
        back = self._rapid(here, home)
        if isinstance(back, Break):
            self.obstructions.append(back)
        else:
            self.legs.append(back)
        if self.legs:
            self.legs[0] = self.legs[0].standing(0, self.rests.get(BEFORE_ALL, 0))
        if self.withdrawn:
            places = ", ".join(f"{index:g}" for index, _ in self.withdrawn[:8]) + (
                " …" if len(self.withdrawn) > 8 else ""
            )
            self.detours.append(
                f"in the workpiece at its start or end, at point {places}: there the tool is first drawn straight "
                f"along its axis at a feed, by up to {1e3 * max(height for _, height in self.withdrawn):.0f} mm"
            )
        if not uncut(self.path, []).sum() > uncut(self.path, self.driven).sum():
            self.obstructions += [b for b in self.in_the_way if b not in self.obstructions]  # nothing is left to cut
        trajectory = None if self.obstructions else self._joined()
        held = self.held_time / self.cut_time if self.cut_time > 0 else 1.0
        return Timeline(
            trajectory=trajectory,
            dips=tuple(self.dips),
            obstructions=tuple(self.obstructions),
            detours=tuple(self.detours),
            legs=tuple(self.legs),
            held_share=held,
            phi=self.phi,
            driven=tuple(self.driven),
            given_up=self.given_up,
        )

    def _stretch(self, here: _Place, first: int, last: int) -> _Place | None:
        """Drive one stretch from ``here``; returns where it ends, None where it cannot be driven."""
        wanted = (first, last)
        while True:
            found = self._legs(here, first, last)
            if not isinstance(found, Break):
                break
            if not self.options.allow_gaps:
                self.obstructions.append(found)
                return None
            self.in_the_way.append(found)
            shorter = self._shorter(found, first, last)
            if shorter is None:
                self.given_up[wanted] = f"left out with the stretch it is in: {found.text} ({found.where})"
                return None
            self.given_up[wanted] = f"the cut to it is left out: {found.text} ({found.where})"
            first, last = shorter
        legs, end = found
        self.legs += legs
        self.driven.append((first, last))
        return end

    def _shorter(self, why: Break, first: int, last: int) -> Stretch | None:
        """The stretch without its first or last toolpath point, where that stops it; None where nothing is left."""
        if why.code != "no_room":
            return None
        points = first + np.flatnonzero(self.path.is_point[first : last + 1])
        inner = points[points > first] if why.after == self.path.index[first] else points[points < last]
        if len(inner) < 2:
            return None
        cut = (int(inner[0]), last) if why.after == self.path.index[first] else (first, int(inner[-1]))
        return cut if worth(self.path, *cut) else None

    def _legs(self, here: _Place, first: int, last: int) -> tuple[list[Leg], _Place] | Break:
        """The rapid move to a stretch, the stretch itself, and lifts where it starts or ends in the workpiece."""
        index = self.path.index
        gap_in = not any(first == a for a, _ in self.path.runs)
        gap_out = not any(last == b for _, b in self.path.runs)
        lift_in = self.lifts.gap(first) if gap_in else self._withdrawal(first)
        lift_out = self.lifts.gap(last) if gap_out else lift_in if first == last else self._withdrawal(last)
        if np.isnan(lift_in):
            return self._no_room(here.index, float(index[first]))
        if np.isnan(lift_out):
            return self._no_room(float(index[last]), float("nan") if last + 1 == len(index) else float(index[last + 1]))
        start = self.lifts.lifted(first, lift_in) if lift_in else self.x[first]
        end = self.lifts.lifted(last, lift_out) if lift_out else self.x[last]
        if start is None or end is None:
            raise AssertionError("a lift that was found is there")
        to = self._rapid(here, _Place(start, float(index[first]), first))
        if isinstance(to, Break):
            return to
        down = self._straight(start, self.x[first], first, Move.APPROACH, lift_in) if lift_in else None
        up = self._straight(self.x[last], end, last, Move.RETRACT, lift_out) if lift_out else None
        run: Leg | Break | None = None
        held: Leg | None = None
        if isinstance(down, Break) or isinstance(up, Break):
            return down if isinstance(down, Break) else up  # type: ignore[return-value]  # one of them is a break
        if last > first and np.ptp(self.path.s[first : last + 1]) > 0:
            begin = self._stood_until(first, last)
            held = self._touch(first, begin) if begin > first else None
            run = self._run(begin, last)
        elif last > first or self.path.move[first] != Move.RAPID:
            run = self._touch(first, last)
        if isinstance(run, Break):
            return run
        legs = [leg for leg in (to, down) if leg is not None]
        if run is not None and last > first:  # where it begins, the machine stands before
            legs[-1] = legs[-1].standing(-1, self._samples_at(first))
        if held is not None:
            legs.append(held.standing(-1, self._samples_at(begin)))
        legs += [] if run is None else [run]
        legs[-1] = legs[-1].standing(-1, self._samples_at(last))
        return legs + ([] if up is None else [up]), _Place(end, float(index[last]), last)

    def _stood_until(self, first: int, last: int) -> int:
        """The last planning point at the place where a stretch begins, if the file rests there behind its first one.

        A motion along the path passes such points all at once, and could not say where it stands.
        """
        there = first + int(np.searchsorted(self.path.s[first : last + 1] - self.path.s[first], 0.0, side="right")) - 1
        index = self.path.index[first + 1 : there + 1]
        return there if any(round(float(i)) in self.rests for i in index) else first

    def _samples_at(self, row: int) -> int:
        """How many samples the machine stands at a planning point."""
        return self.rests.get(round(float(self.path.index[row])), 0) if self.path.is_point[row] else 0

    def _no_room(self, before: float, after: float) -> Break:
        return Break(
            before=before,
            after=after,
            code="no_room",
            text="there is no room to lift the tool out of the cut at the gap",
            help="more room above the part, or another pose of the part, would help",
        )

    def _feed_after(self) -> Array:
        """(P,) m/s of the move to each point, of the next one with a feed where that is a rapid move."""
        feed = np.where(self.path.feed > 0, self.path.feed, np.nan)
        known = np.flatnonzero(np.isfinite(feed))
        if not len(known):
            return np.full(len(feed), self.options.approach_feed)
        return feed[known[np.minimum(np.searchsorted(known, np.arange(len(feed))), len(known) - 1)]]

    def _rapid(self, a: _Place, b: _Place) -> Leg | Break:
        move = plan_rapid(
            a.x,
            b.x,
            limits=self.plan.setup.driven.limits,
            scale=self.options.rapid_scale,
            sample=self.options.sample,
            collision=self.plan.setup.collision,
            step=self.options.collision_step,
            rng=self.rng,
            detours=lambda: self.lifts.detours(a.row, b.row),
            iterations=SEARCH if not self.obstructions and not self.given_up else SEARCH_IN_VAIN,
            known_free=way_between(a.x, b.x) in self.free,
            per_rad=self.plan.setup.per_rad,
        )
        if isinstance(move, Blocked):
            return _blocked(move, a, b)
        x, waypoints = move.q, move.waypoints
        if self.plan.setup.correction is not None:
            waypoints = self._told(waypoints)
            x = time_legs(waypoints, self.cell.limits, self.options.rapid_scale, self.options.sample)
        if len(x) == 1 and np.isfinite(a.index) and np.isfinite(b.index):
            x = np.repeat(x, 2, axis=0)  # the file names one place twice: a sample for the second, too
        n = len(x)
        if move.kind != "direct":
            via = len(waypoints) - 2
            self.detours.append(f"{a.name} → {b.name}: {move.kind}, {via} way point{'' if via == 1 else 's'}")
        operation = self.toolpath.operation[round(b.index)] if np.isfinite(b.index) else -1
        return Leg(
            name="rapid",
            q=x[:, :6],
            index=np.linspace(a.index, b.index, n) if n > 1 else np.array([b.index]),
            move=np.full(n, Move.RAPID, np.int8),
            operation=np.full(n, operation, np.int32),
            gamma=np.full(n, np.nan),
            waypoints=waypoints[1:, :6],
            waypoint_index=np.full(len(waypoints) - 1, b.index),
            waypoint_feed=np.full(len(waypoints) - 1, np.nan),
            external=x[:, 6:],
            waypoint_external=waypoints[1:, 6:],
        )

    def _withdrawal(self, row: int) -> float:
        """m along the tool axis until a rapid move may begin; 0 where it may at once, or never."""
        height = self.lifts.withdrawal(row)
        if height:
            self.withdrawn.append((float(self.path.index[row]), height))
        return height

    def _straight(self, a: Array, b: Array, row: int, move: Move, height: float) -> Leg | Break:
        """A straight lift or descent along the tool axis; down not faster than the cut that follows."""
        rows = np.array([row, row], np.int32)
        up = np.asarray([height, 0.0]) if move is Move.APPROACH else np.asarray([0.0, height])
        position = self.path.position[rows] + up[:, None] * self.path.axis[rows]
        feed = (
            min(self.options.approach_feed, float(self.feed_after[row]))
            if move is Move.APPROACH
            else self.options.approach_feed
        )
        done = self._retime(position, rows, np.array([a[:6], b[:6]]), np.full(2, feed))
        if isinstance(done, RunFailure):
            at = float(self.path.index[row])
            return not_driven(at, at, done.reason)
        n = len(done.q)
        return Leg(
            name="lift",
            q=done.q,
            index=np.full(n, self.path.index[row]),
            move=np.full(n, move, np.int8),
            operation=np.full(n, self._operation(rows[:1])[0], np.int32),
            gamma=np.full(n, np.nan),
            waypoints=self._told(b[None, :6]),
            waypoint_index=self.path.index[rows[:1]],
            waypoint_feed=np.array([feed]),
            external=done.external,
            waypoint_external=b[None, 6:],
        )

    def _touch(self, first: int, last: int) -> Leg:
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
            waypoint_feed=self.path.feed[[last]]
            if self.path.feed[last] > 0
            else np.array([self.options.approach_feed]),
            external=np.repeat(self.path.external[[first]], n, axis=0),
            waypoint_external=self.path.external[[last]],
        )
        for k in range(last - 1, first, -1):  # the file dwells between two of them
            leg = leg.standing(2 + k - first, self._samples_at(k))
        return leg

    def _run(self, first: int, last: int) -> Leg | Break:
        rows = np.arange(first, last + 1, dtype=np.int32)
        feed = np.where(self.path.feed[rows] > 0, self.path.feed[rows], self.options.approach_feed)
        index = self.path.index[rows]
        rests = [
            n for n in np.searchsorted(index, np.array(sorted(self.rests)) - 1e-9).tolist() if 0 < n < len(rows) - 1
        ]
        rests = [n for n in rests if round(float(index[n])) in self.rests and self.path.is_point[rows[n]]]
        done = self._retime(self.path.position[rows], rows, self.q[rows], feed, tuple(rests))
        if isinstance(done, RunFailure):
            at = float(np.interp(done.point, np.arange(len(rows)), index))
            return not_driven(at, at, done.reason)
        local = done.point
        segment = np.clip(np.ceil(local - 1e-9).astype(int), 1, len(rows) - 1)  # the segment a sample lies on
        move = self.path.move[rows][segment]
        below = np.clip(np.floor(local + 1e-9).astype(int), 0, len(rows) - 1)
        move = every_cut_shown(move, local, index, rows, self.path)
        gamma = done.phi + self.path.offset[rows][below]
        self.phi[rows] = np.interp(np.arange(len(rows)), local, done.phi)
        phi = self.plan.chosen.assignment.phi[rows]
        told = needed(phi, self.path.is_point[rows], index, self.path.position[rows])
        if np.ptp(self.path.external[rows], axis=0).any():
            told[:] = True  # between two targets the controller moves them on the line
        told[0] = False  # the move starts there
        cutting = move == Move.CUT
        self.cut_time += float(cutting.sum()) * self.options.sample
        self.held_time += float((cutting & done.held).sum()) * self.options.sample
        self.dips += [dip.at(np.interp([dip.first, dip.last], np.arange(len(rows)), index)) for dip in done.dips]
        leg = Leg(
            name="run",
            q=done.q,
            index=np.interp(local, np.arange(len(rows)), index),
            move=move,
            operation=self._operation(rows[segment]),
            gamma=gamma,
            waypoints=self._told(self.q[rows][told]),
            waypoint_index=index[told],
            waypoint_feed=feed[told],
            external=done.external,
            waypoint_external=self.path.external[rows][told],
        )
        for n, row in reversed(list(zip(rests, done.rests, strict=True))):
            leg = leg.standing(row, self._samples_at(first + n))
        return leg

    def _retime(
        self, position: Array, rows: NDArray[np.int32], q: Array, feed: Array, rests: tuple[int, ...] = ()
    ) -> RunTrajectory | RunFailure:
        setup = self.plan.setup
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
            limits=self.cell.limits,
            sample=self.options.sample,
            path_tolerance=self.options.path_tolerance,
            axis_tolerance=self.options.axis_tolerance,
            limit_scale=self.options.limit_scale,
            correction=setup.correction,
            rests=rests,
        )
        values = tuple(getattr(run, f.name) for f in fields(run))
        return recalled("retime", lambda: values, lambda: retime_run(run))

    def _told(self, q: Array) -> Array:
        """(W, 6 or more) with encoder angles of true angles; what follows the arm's joints is left as it is."""
        correction = self.plan.setup.correction
        return q if correction is None else np.hstack([correction.encoder_angles(q[:, :6]), q[:, 6:]])

    def _in_part(self, q: Array, external: Array) -> Array:
        """(S, 4, 4) TCP where feed is measured: as the workpiece sees it where anything moves it."""
        setup, T_flange_tcp = self.plan.setup, self.cell.tool.T_flange_tcp
        if not setup.arm.machine.external:
            return setup.robot.fk(q, T_flange_tcp)
        return setup.arm.machine.fk(np.hstack([q, external]), T_flange_tcp)

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
        external = join("external")
        T = self._in_part(stands, external)
        speed = np.r_[0.0, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / self.options.sample]
        return Trajectory(
            time=np.arange(len(q), dtype=float) * self.options.sample,
            q=q,
            external=external,
            point=join("index"),
            move=join("move").astype(np.int8),
            operation=join("operation").astype(np.int32),
            gamma=join("gamma"),
            feed=speed,
        )


def _blocked(move: Blocked, a: _Place, b: _Place) -> Break:
    at = a if move.reason == "start" else b
    name, key = ("tool change", "robot.tool_change_deg") if at.change else ("home", "robot.home_deg")
    if move.reason != "way" and at.row < 0:
        return Break(
            before=a.index,
            after=b.index,
            code="home_collides",
            text=f"{move.pair} touch or come nearer than the clearance at the {name} pose",
            help=f"another {name} pose ({key}), or moving what is there, would help",
            pair=move.pair,
        )
    if move.reason != "way":
        return Break(
            before=a.index,
            after=b.index,
            code="rapid_collides",
            text=f"{move.pair} touch or come nearer than the clearance at the "
            f"{move.reason} of the rapid move, at {place(at.index)}",
            help="an approach or retract to a place clear of the part, or a smaller clearance_mm, would help",
            pair=move.pair,
        )
    return Break(
        before=a.index,
        after=b.index,
        code="rapid_blocked",
        text=f"no free way was found past {move.pair}",
        help="a retract to a place "
        "clear of everything, another home pose, another seed, or moving what is in the way would help",
        pair=move.pair,
    )

"""Exclusions of one search: vertices that collide, and edges that collide or contain no valid pose.

A vertex (station, rotation, branch) is excluded only for a contact of its own pose. An edge (two vertices of
neighbouring stations) is excluded only for a contact or a missing pose between its ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, compute_any_last
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead
from machopt.planning.collision_handling.path_check import PathCollisionChecker, PathCollisions
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions, TransitionCollector
from machopt.planning.sequence_search.search_kernels import compute_joint_jump_limit
from machopt.planning.stations.planning_path import PlanningPath

Rows = NDArray[np.intp]
SWING = np.radians(90.0)  # maximum rotation between two stations that is checked past a known contact
FINE = 65  # number of places on an edge where its contact is searched
AHEAD = 8000  # vertices checked around the contacts of the first round, four times as many in each next one


@dataclass(kw_only=True)
class ExclusionTracker:
    """Exclusions of one path's grid; ``candidates`` loses the colliding vertices, in place."""

    path: PlanningPath
    candidates: CandidateGrid
    checker: PathCollisionChecker
    progress: Callable[[str], None]
    edges: ForbiddenTransitions = field(default_factory=ForbiddenTransitions.none)
    banned: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        S, R, B, T = self.candidates.feasible.shape
        self.shape = (S, R, B, T)
        self.looked = np.zeros((S, R, B), bool)
        model = self.checker.model
        small = model is None or len(model.pairs) <= np.iinfo(np.int16).max
        self.pairs = np.full((S, R, B), -1, np.int16 if small else np.int32)
        self.ahead_of = AHEAD
        self.phi = self.candidates.phi_at()
        self.swept: dict[tuple[int, int, int], dict[float, bool]] = {}  # station, branch, pair: rotations, any touched
        self.ahead = (
            None
            if model is None
            else ContactLookahead(
                candidates=self.candidates,
                model=model,
                may_touch=self.path.may_touch[self.path.stations],
                external=self.path.external[self.path.stations],
                pairs=self.pairs,
            )
        )

    def stations(self, hit: NDArray[np.bool_]) -> Rows:
        """Return the stations at or after the points hit.

        Args:
            hit: (P,) planning points with a contact.
        """
        st = self.path.stations
        return np.unique(np.clip(np.searchsorted(st, np.flatnonzero(hit)), 0, len(st) - 1))

    def gone(self, choice: SequenceChoice) -> bool:
        """Return whether a vertex of the sequence has been excluded.

        Args:
            choice: sequence of the search.
        """
        s = np.flatnonzero(~choice.dropped)
        return not bool(self.candidates.feasible[s, choice.rotation[s], choice.branch[s], choice.turn[s]].all())

    def chosen(self, choice: SequenceChoice, every: int = 1) -> bool:
        """Check the vertices of the sequence and the neighbours of those that collide.

        Args:
            choice: sequence of the search.
            every: only every n-th station is checked.

        Returns:
            Whether any vertex of the sequence has been excluded.
        """
        s = np.flatnonzero(~choice.dropped)[::every]
        return self._check_around(s, choice.rotation[s], choice.branch[s]) > 0

    def along(self, choice: SequenceChoice, a: JointAssignment, check: PathCollisions) -> int:
        """Check the grid vertices on either side of a curve where it collides, and the neighbours of those that
        collide.

        Args:
            choice: sequence of the search that the curve follows.
            a: rotation and joints of the curve at all planning points.
            check: contacts of the curve.

        Returns:
            Number of vertices excluded.
        """
        s = self.stations(check.hit)
        s = s[~choice.dropped[s]]
        grid, (R, phi) = self.phi, (self.shape[1], a.phi[self.path.stations[s]])
        low = np.floor(wrap_angle(phi - grid[s, 0]) / (2 * np.pi / R)).astype(int)
        both, sides = np.tile(s, 2), np.concatenate([low, low + 1]) % R
        return self._check_around(both, sides, choice.branch[both])

    def _check_around(self, s: Rows, r: Rows | NDArray[np.int32], b: NDArray[np.int32]) -> int:
        """Check vertices not checked before, and the neighbours of those that collide; return the number excluded."""
        ahead = self.ahead
        usable = compute_any_last(self.candidates.feasible[s, r, b]) & ~self.looked[s, r, b]
        if ahead is None or not usable.any():
            return 0
        s, r, b = s[usable], r[usable], b[usable]
        self.progress("check")
        found = ahead.model.check_configurations(ahead.whole(s, r, b), ahead.may_touch[s])
        self.looked[s, r, b] = True
        if not found.any:
            return 0
        vertices = np.ravel_multi_index((s[found.hit], r[found.hit], b[found.hit]), self.pairs.shape)
        vertices, first = np.unique(vertices, return_index=True)
        pair = found.pair[found.hit][first]
        ahead.strike(vertices, pair)
        ahead.look(vertices, pair, self.ahead_of)
        self.ahead_of = min(4 * self.ahead_of, self.pairs.size)
        return len(vertices)

    def _select_stations(self, choice: SequenceChoice, stations: Rows, budget: int) -> Rows:
        """Return the stations that have a choice, at most ``budget`` of them, spread evenly."""
        stations = stations[~choice.dropped[stations]]
        if len(stations) > budget:
            stations = stations[np.unique(np.linspace(0, len(stations) - 1, budget).round().astype(int))]
        return stations

    def grid(self, choice: SequenceChoice, plain: JointAssignment, check: PathCollisions, budget: int) -> None:
        """Exclude the vertices and edges of the grid's own sequence that collide or contain no valid pose.

        Args:
            choice: sequence of the search.
            plain: joints of that sequence at all planning points.
            check: contacts of that sequence.
            budget: maximum number of stations that are examined.
        """
        before = int(self.candidates.feasible.sum()), len(self.edges)
        stations = self._select_stations(choice, self.stations(check.hit | check.lost), budget)
        for s in stations:  # a pose exactly on a limit or margin: rounding decides
            why = plain.reason[self.path.stations[s]]
            if why != InfeasibilityReason.OK:
                self._drop(choice, int(s), int(why))
        closing, bans = TransitionCollector(self.edges, self.shape[0]), []
        for at in stations:
            s = int(at)
            joined = s > 0 and s not in choice.broken and not choice.dropped[s - 1]
            if joined and self.path.run[self.path.stations[s]] == self.path.run[self.path.stations[s - 1]]:
                excluded = [
                    not self.candidates.feasible[k, choice.rotation[k], choice.branch[k], choice.turn[k]]
                    for k in (s - 1, s)
                ]
                if not any(excluded):
                    bans += self._exclude_edges(choice, s, closing)
        self.edges = closing.merged()
        self._exclude_ways(bans)
        if (int(self.candidates.feasible.sum()), len(self.edges)) == before:
            for at in stations:  # contacts that only the whole path shows exclude the chosen edges
                bans += self._drop_way(choice, int(at), int(check.pair[self.path.stations[at]]))
            self._exclude_ways(bans)

    def _drop_way(self, choice: SequenceChoice, s: int, pair: int) -> list[tuple[int, int, int]]:
        joined = s > 0 and s not in choice.broken and not choice.dropped[s - 1]
        if not joined or self.path.run[self.path.stations[s]] != self.path.run[self.path.stations[s - 1]]:
            self._drop(choice, s, int(InfeasibilityReason.NO_PATH))
            return []
        _, _, B, T = self.shape
        u, v = ((int(choice.rotation[k]) * B + int(choice.branch[k])) * T for k in (s - 1, s))
        self.banned[s] = pair
        return [(s, u + int(choice.turn[s - 1]), v)]

    def _drop(self, choice: SequenceChoice, s: int, why: int) -> None:
        r, b = choice.rotation[s], choice.branch[s]
        self.candidates.feasible[s, r, b, choice.turn[s]] = False
        if not self.candidates.feasible[s, r, b].any():
            self.candidates.reason[s, r, b] = why

    def _exclude_edges(
        self, choice: SequenceChoice, s: int, closing: TransitionCollector
    ) -> list[tuple[int, int, int]]:
        """Exclude the edges into station s with the same swing as the chosen one that are not free, on either side of
        it
        up to the first free one.

        Returns:
            Edges that are blocked in some turns only, as :meth:`_exclude_ways` takes them.
        """
        _, R, B, T = self.shape
        b, bu = int(choice.branch[s]), int(choice.branch[s - 1])
        here, before = int(choice.rotation[s]), int(choice.rotation[s - 1])
        c, bans, closed, pairs = self.candidates, [], [], []
        for side in (range(R), range(-1, -R, -1)):
            for k in side:
                r, ru = (here + k) % R, (before + k) % R
                if not (c.feasible[s, r, b].any() and c.feasible[s - 1, ru, bu].any()):
                    break
                found = self._list_edge_turns(s, ru, bu, r, b)
                if len(found) == np.count_nonzero(c.feasible[s - 1, ru, bu]):
                    closed.append((ru * B + bu, r * B + b))
                else:
                    bans += [(s, (ru * B + bu) * T + t, (r * B + b) * T) for t, _ in found]
                if not found:
                    break
                pairs.append(found[-1][1])
        if pairs:
            self.banned[s] = pairs[0]  # pair of the chosen edge, if it is one of them
        if closed:
            closing.add(s, *np.array(closed).T)
            if b == bu and self.banned[s] >= 0:
                self._exclude_across_contact(s, before, here, b, closing)
        return bans

    def _exclude_across_contact(self, s: int, before: int, here: int, b: int, closing: TransitionCollector) -> None:
        """Exclude the swings past the contact of the chosen edge: into this station and into its neighbours as long as
        any collide.

        Where a contact blocks a range of rotations over many stations, the search would otherwise choose every swing
        across
        it once.
        """
        ends, pair = self._get_edge_ends(s, np.array([before]), np.array([here]), b), self.banned[s]
        if ends is None:
            return
        phi, q = ((np.repeat(a, FINE, axis=0), np.repeat(z, FINE, axis=0)) for a, z in ends)
        f, at, known = self.checker.on_the_way(int(self.path.stations[s]), phi, q, np.linspace(0.0, 1.0, FINE))
        touching = np.flatnonzero(known & self._find_touching(at, pair))
        for part in np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1):
            if len(part):
                closed_at = float(phi[0][0] + f[part[len(part) // 2]] * (phi[1] - phi[0])[0])
                self._exclude_swings(s, b, closed_at, pair, closing)
                for side in (range(s + 1, self.shape[0]), range(s - 1, 0, -1)):
                    for t in side:
                        if not self._exclude_swings(t, b, closed_at, pair, closing):
                            break

    def _exclude_swings(self, s: int, b: int, phi: float, pair: int, closing: TransitionCollector) -> bool:
        """Exclude the edges into station s that rotate past phi (rad) and collide there; return whether any do."""
        known = self.swept.setdefault((s, b, pair), {})
        if phi not in known:
            known[phi] = self._exclude_swing_over(s, b, phi, pair, closing, any(known.values()))
        return known[phi]

    def _exclude_swing_over(
        self, s: int, b: int, phi: float, pair: int, closing: TransitionCollector, before: bool
    ) -> bool:
        """Do the work of :meth:`_exclude_swings`; if such edges were excluded ``before``, the blocked ones
        count as well.
        """
        c, st, model = self.candidates, self.path.stations, self.checker.model
        if model is None or self.path.run[st[s]] != self.path.run[st[s - 1]]:
            return False
        if model.pairs[pair].unless_cutting and self.path.may_touch[st[s - 1]]:
            return False
        free = [np.flatnonzero(compute_any_last(c.feasible[k, :, b])) for k in (s - 1, s)]
        source, target = (x.ravel() for x in np.meshgrid(*free))
        turn, B = self._turn(s, source, target), self.shape[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = wrap_angle(phi - self.phi[s - 1, source]) / turn
        over = (np.abs(turn) <= SWING) & (share > 0.0) & (share < 1.0)
        step = wrap_angle(c.q[s, target[over], b] - c.q[s - 1, source[over], b])
        over[over] = np.abs(step).max(axis=1, initial=0.0) <= compute_joint_jump_limit(c.stable)
        over[over] = still = closing.open(s, source[over] * B + b, target[over] * B + b)
        source, target, share = source[over], target[over], share[over]
        closed, ends = before and not still.all(), self._get_edge_ends(s, source, target, b)
        if ends is None or not len(source):
            return closed
        _, at, known = self.checker.on_the_way(int(st[s]), *ends, share)
        known[known] = self._find_touching(at[known], pair)
        if known.any():
            closing.add(s, source[known] * B + b, target[known] * B + b)
            self.banned[s] = pair
        return closed or bool(known.any())

    def _turn(self, s: int, source: Rows, target: Rows) -> Array:
        """Return the (n,) rotation in rad along edges into station s."""
        return np.asarray(wrap_angle(self.phi[s, target] - self.phi[s - 1, source]))

    def _get_edge_ends(
        self, s: int, source: Rows, target: Rows, b: int
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]] | None:
        """Return rotation (n,) and joints (n, 6) at both ends of edges into station s in one branch; None where
        planning
        points lie between.
        """
        if self.path.stations[s] - self.path.stations[s - 1] != 1:
            return None
        phi = self.phi[s - 1, source]
        qa, qb = self.candidates.q[s - 1, source, b], self.candidates.q[s, target, b]
        return (phi, phi + self._turn(s, source, target)), (qa, qa + wrap_angle(qb - qa))

    def _find_touching(self, q: Array, pair: int) -> NDArray[np.bool_]:
        model = self.checker.model
        return np.zeros(len(q), bool) if model is None else model.check_single_pairs(q, np.full(len(q), pair))

    def _exclude_ways(self, ways: list[tuple[int, int, int]]) -> None:
        """Exclude edges (station, source, target), and those to the other turns of the targets."""
        if ways:
            s, u, v = (np.repeat(np.array(x, np.int32), self.shape[3]) for x in zip(*ways, strict=True))
            self.edges = self.edges.plus(s, u, v + np.tile(np.arange(self.shape[3], dtype=np.int32), len(ways)))

    def _list_edge_turns(self, s: int, ru: int, bu: int, r: int, b: int) -> list[tuple[int, int]]:
        """Return the turns in which the edge from a vertex of station s − 1 to one of s is blocked, each with its pair.

        The pair is −1 for an edge that has no valid pose in between.
        """
        c, st = self.candidates, self.path.stations
        qa = c.q[s - 1, ru, bu]
        qb = qa + wrap_angle(c.q[s, r, b] - qa)
        if not np.abs(qb - qa).max() <= compute_joint_jump_limit(c.stable):
            return []  # no edge exists here; nothing to exclude
        every = [int(t) for t in np.flatnonzero(c.feasible[s - 1, ru, bu])]
        rows = np.arange(st[s - 1], st[s] + 1)
        grid = self.phi
        phi = grid[s - 1, ru] + np.array([0.0, float(wrap_angle(grid[s, r] - grid[s - 1, ru]))])
        if len(rows) == 2:
            return self._stretch(rows, phi, np.vstack([qa, qb]), every)
        length = self.path.s[rows]
        f = (length - length[0]) / max(float(length[-1] - length[0]), 1e-12)
        turned, seed = np.full(len(self.path.index), np.nan), np.full((len(self.path.index), 6), np.nan)
        turned[rows] = phi[0] + f * (phi[1] - phi[0])
        out: list[tuple[int, int]] = []
        for t in every:  # a joint limit in between may be kept in one turn and violated in another
            seed[rows] = qa + f[:, None] * (qb - qa) + c.turns[t]
            found = solve_joint_path(self.path, self.checker.arm, self.checker.robot, turned, seed)
            if (found.reason[rows] != InfeasibilityReason.OK).any():
                out.append((t, -1))
            else:
                out += self._stretch(rows, turned[rows], found.q[rows], [t])
        return out

    def _stretch(self, rows: Rows, phi: Array, q: Array, turns: list[int]) -> list[tuple[int, int]]:
        hit, pair, lost = self.checker.stretch(rows, phi, q)
        if not hit.any() and not lost.any():
            return []
        what = int(pair[int(np.argmax(hit))]) if hit.any() else -1
        return [(t, what) for t in turns]

"""The best sequence that really is free: choose, look, strike out what itself collides, choose again.

::

    choose ─► smooth ─► check ─► free: done
      ▲                   │
      │                   ▼ a contact
      ├── strike ◄── the grid's own sequence: vertices and edges that collide by themselves
      │                   │ free
      └── strike ◄── vertices near the smooth curve that collide (less room), smooth again, a few times;
                     then the runs whose smooth curve still collides follow the grid

A vertex (station, rotation, branch) is struck out only for a contact of its own pose, an edge (two vertices of
neighbouring stations) only for a contact or a missing pose on its own way. What is struck out is so for good, and
nothing else ever is: the search ends (each round strikes something out), and a station without vertices, or without
an edge that leads on, is infeasible on this grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.plan.candidates import Candidates
from machopt.plan.check import Checker, PathCheck
from machopt.plan.choose import Choice, Edges, choose
from machopt.plan.path import Path
from machopt.plan.realise import Assignment, realise
from machopt.plan.score import Scores
from machopt.plan.sequence import JUMP
from machopt.plan.smooth import Smoothed, follow_grid, smooth
from machopt.se3 import wrap

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
STATIONS = 48  # colliding stations whose whole rotation row is looked at in the first round; twice as many in each next
TOGETHER = 64  # stations looked at in one call; bounds of all pairs are held for every rotation of each
SMOOTHINGS = 4  # with less room each, before a run that collides follows the grid
ROUNDS = 400  # each strikes something out, so the search ends by itself; an answer this far away is not waited for


@dataclass(frozen=True)
class Found:
    """What the search came to."""

    assignment: Assignment
    source: str  # "smooth", "grid" or "smooth and grid"
    choice: Choice
    check: PathCheck
    rounds: int
    pairs: NDArray[np.int32]  # (S, R, B) pair that a vertex was struck out for, −1 else
    banned: dict[int, int]  # station → pair of a way into it that was struck out, −1 where no pose is on it
    edges: Edges
    wide: NDArray[np.bool_]  # (S,) the rotation may turn there while the feed waits
    gave_up: bool  # after ROUNDS: what still collides is not proven to have no answer


@dataclass
class Search:
    """One path's search; ``candidates`` lose what collides, in place."""

    path: Path
    candidates: Candidates
    scores: Scores
    velocity: Array  # (6,) rad/s
    options: PlanOptions
    checker: Checker
    progress: Callable[[str], None] = lambda _: None
    edges: Edges = field(default_factory=Edges.none)
    banned: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        S, R, B, T = self.candidates.feasible.shape
        self.shape = (S, R, B, T)
        self.looked = np.zeros((S, R, B), bool)
        self.pairs = np.full((S, R, B), -1, np.int32)
        self.wide = np.zeros(S, bool)
        self.visits = np.zeros(S, int)
        self.rounds = 0

    def run(self, prefer_grid: Callable[[Choice, Assignment, Assignment], bool]) -> Found:
        """Search to the end.

        Args:
            prefer_grid: told the choice, the smooth and the plain assignment, whether the plain one is better.
        """
        budget, smoothings, grid_is_free = STATIONS, 0, False
        choice = self._choose()
        while True:
            self.rounds += 1
            plain = self._realised(follow_grid(self.path, self.candidates, choice))
            partial = bool(choice.dropped.any() or choice.broken)
            if partial and (not grid_is_free or not self.options.allow_gaps):
                source, found, check = "grid", plain, self._checked(plain, choice)
                if check.free and self.options.allow_gaps and not choice.dropped.all():
                    grid_is_free = True  # what is left is worth smoothing
                    continue
                if check.free:
                    break
            else:
                source, found = "smooth", self._realised(self._smooth(choice))
                check = self._checked(found, choice)
                if check.free:
                    if prefer_grid(choice, found, plain):
                        grid = self._checked(plain, choice)
                        if grid.free:
                            source, found, check = "grid", plain, grid
                    break
                # the whole row of a station that the curve collides at: less room for the next curve
                struck = self._strike_rows(choice, self._stations(check.hit), budget)
                if not self._gone(choice):
                    grid = self._checked(plain, choice)
                    if grid.free:
                        grid_is_free = True
                        if struck and smoothings < SMOOTHINGS:
                            smoothings += 1
                            continue
                        found, check, source = self._mixed(found, check, plain, grid)
                        break
                    source, found, check = "grid", plain, grid
            if self.rounds >= ROUNDS:
                break
            if source == "grid":
                self._strike_grid(choice, found, check, budget)
            budget, grid_is_free = 2 * budget, False
            choice = self._choose()
        return Found(
            self._without_breaks(found, choice), source, choice, check, self.rounds, self.pairs, self.banned,
            self.edges, self.wide, not check.free,
        )  # fmt: skip

    # --- choosing ------------------------------------------------------------------------------------------------

    def _choose(self) -> Choice:
        self.progress("choose")
        choice = self._chosen()
        runs = self.path.run[self.path.stations]
        stuck = np.isin(runs, runs[list(choice.broken)]) & ~self.wide
        if stuck.any():  # the feed may wait for the rotation rather than the job fail
            self.wide |= stuck
            choice = self._chosen()
        return choice

    def _chosen(self) -> Choice:
        return choose(
            self.path, self.candidates, self.scores, self.velocity, self.options, self.edges,
            self.wide if self.wide.any() else None,
        )  # fmt: skip

    def _smooth(self, choice: Choice) -> Smoothed:
        self.progress("smooth")
        return smooth(self.path, self.candidates, self.scores, choice, self.velocity, self.options)

    def _realised(self, smoothed: Smoothed) -> Assignment:
        return realise(self.path, self.checker.arm, self.checker.robot, smoothed.phi, smoothed.seed)

    def _checked(self, a: Assignment, choice: Choice) -> PathCheck:
        """Contacts, and ``lost``: what the choice covers but the assignment does not."""
        self.progress("check")
        cuts = tuple(self.path.stations[list(choice.broken)].tolist())
        known = np.where((a.reason == Reason.OK)[:, None], a.q, np.nan)
        found = self.checker.whole(a.phi, known, cuts)
        return replace(found, lost=found.lost | covered(self.path, choice) & (a.reason != Reason.OK))

    def _without_breaks(self, a: Assignment, choice: Choice) -> Assignment:
        """Points between the stations on either side of a break belong to neither."""
        for s in choice.broken:
            inner = slice(int(self.path.stations[s - 1]) + 1, int(self.path.stations[s]))
            a.q[inner], a.reason[inner] = np.nan, Reason.NO_PATH
        return a

    def _mixed(
        self, curve: Assignment, check: PathCheck, plain: Assignment, grid: PathCheck
    ) -> tuple[Assignment, PathCheck, str]:
        """The smooth curve, and the grid's sequence in the runs where that collides."""
        bad = np.unique(self.path.run[check.hit | check.lost])
        take = np.isin(self.path.run, bad)
        if take.all():
            return plain, grid, "grid"

        mixed = Assignment(**{
            name: np.where(take.reshape(-1, *(1,) * (values.ndim - 1)), values, getattr(curve, name))
            for name, values in vars(plain).items()
        })  # fmt: skip
        checked = PathCheck(
            np.where(take, grid.hit, check.hit), np.where(take, grid.pair, check.pair).astype(np.int32),
            np.where(take, grid.lost, check.lost),
        )  # fmt: skip
        return mixed, checked, "smooth and grid"

    # --- striking out --------------------------------------------------------------------------------------------

    def _stations(self, hit: NDArray[np.bool_]) -> Rows:
        """Stations at or behind the points hit."""
        st = self.path.stations
        return np.unique(np.clip(np.searchsorted(st, np.flatnonzero(hit)), 0, len(st) - 1))

    def _gone(self, choice: Choice) -> bool:
        """A vertex of the choice has been struck out."""
        s = np.flatnonzero(~choice.dropped)
        return not bool(self.candidates.feasible[s, choice.rotation[s], choice.branch[s], choice.turn[s]].all())

    def _strike_rows(self, choice: Choice, stations: Rows, budget: int) -> int:
        """Look at every rotation of the chosen branch at these stations, at every branch where one has failed before.

        Returns:
            how many vertices are struck out.
        """
        stations = self._kept(choice, stations, budget)
        first = self.visits[stations] == 0
        self.visits[stations] += 1
        struck = 0
        for b in range(self.shape[2]):
            asked = stations[~first | (choice.branch[stations] == b)]
            struck += sum(self._strike(asked[k : k + TOGETHER], b) for k in range(0, len(asked), TOGETHER))
        return struck

    def _kept(self, choice: Choice, stations: Rows, budget: int) -> Rows:
        """Stations that have a choice, no more than ``budget`` of them, spread evenly."""
        stations = stations[~choice.dropped[stations]]
        if len(stations) > budget:
            stations = stations[np.unique(np.linspace(0, len(stations) - 1, budget).round().astype(int))]
        return stations

    def _strike(self, stations: Rows, b: int) -> int:
        """Strike out the vertices of some stations in a branch whose own pose collides.

        Looked at rotation by rotation, to and fro along the stations: the next pose is near, and so most distances
        follow from the one before.
        """
        model = self.checker.model
        asked = self.candidates.feasible[stations, :, b].any(axis=-1) & ~self.looked[stations, :, b]  # (n, R)
        if model is None or not asked.any():
            return 0
        r, n = np.nonzero(asked.T)
        order = np.lexsort((np.where(r % 2, -n, n), r))
        r, s = r[order], stations[n[order]]
        found = model.check(self.candidates.q[s, r, b], self.path.may_touch[self.path.stations[s]])
        self.looked[s, r, b] = True
        r, s = r[found.hit], s[found.hit]
        self.candidates.feasible[s, r, b] = False
        self.candidates.reason[s, r, b] = Reason.COLLIDING
        self.pairs[s, r, b] = found.pair[found.hit]
        return len(s)

    def _strike_grid(self, choice: Choice, plain: Assignment, check: PathCheck, budget: int) -> None:
        """Strike out the vertices and edges of the grid's own sequence that collide or lead nowhere."""
        before = int(self.candidates.feasible.sum()), len(self.edges)
        stations = self._kept(choice, self._stations(check.hit | check.lost), budget)
        self._strike_rows(choice, stations, budget)
        for s in stations:  # a pose on the very edge of a limit or margin: rounding decides
            why = plain.reason[self.path.stations[s]]
            if why != Reason.OK:
                self._drop(choice, int(s), int(why))
        for at in stations:
            s = int(at)
            joined = s > 0 and s not in choice.broken and not choice.dropped[s - 1]
            if joined and self.path.run[self.path.stations[s]] == self.path.run[self.path.stations[s - 1]]:
                gone = [not self.candidates.feasible[k, choice.rotation[k], choice.branch[k], choice.turn[k]]
                        for k in (s - 1, s)]  # fmt: skip
                if not any(gone):
                    self._strike_edges(choice, s)
        if (int(self.candidates.feasible.sum()), len(self.edges)) == before:
            for at in stations:  # what only the whole path shows counts against the ways that were chosen
                self._drop_way(choice, int(at), int(check.pair[self.path.stations[at]]))

    def _drop_way(self, choice: Choice, s: int, pair: int) -> None:
        joined = s > 0 and s not in choice.broken and not choice.dropped[s - 1]
        if not joined or self.path.run[self.path.stations[s]] != self.path.run[self.path.stations[s - 1]]:
            self._drop(choice, s, int(Reason.NO_PATH))
            return
        _, _, B, T = self.shape
        u, v = ((int(choice.rotation[k]) * B + int(choice.branch[k])) * T for k in (s - 1, s))
        self._ban([(s, u + int(choice.turn[s - 1]), v)])
        self.banned[s] = pair

    def _drop(self, choice: Choice, s: int, why: int) -> None:
        r, b = choice.rotation[s], choice.branch[s]
        self.candidates.feasible[s, r, b, choice.turn[s]] = False
        if not self.candidates.feasible[s, r, b].any():
            self.candidates.reason[s, r, b] = why

    def _strike_edges(self, choice: Choice, s: int) -> None:
        """Look at every way into station s that turns as far as the chosen one, and strike out those not free."""
        _, R, _, T = self.shape
        b, bu = int(choice.branch[s]), int(choice.branch[s - 1])
        turn = int(choice.rotation[s] - choice.rotation[s - 1])
        c = self.candidates
        every = np.arange(R)
        sources = (every - turn) % R
        usable = c.feasible[s, :, b].any(axis=1) & c.feasible[s - 1, sources, bu].any(axis=1)
        bans = []
        for r in every[usable]:
            ru = int(sources[r])
            for t, pair in self._edge(s, ru, bu, int(r), b):
                bans.append((s, (ru * self.shape[2] + bu) * T + t, (int(r) * self.shape[2] + b) * T))
                self.banned[s] = pair
        self._ban(bans)

    def _ban(self, ways: list[tuple[int, int, int]]) -> None:
        """Strike out ways (station, source, target), and those to the targets' other turns."""
        if ways:
            s, u, v = (np.repeat(np.array(x, np.int32), self.shape[3]) for x in zip(*ways, strict=True))
            self.edges = self.edges.plus(s, u, v + np.tile(np.arange(self.shape[3], dtype=np.int32), len(ways)))

    def _edge(self, s: int, ru: int, bu: int, r: int, b: int) -> list[tuple[int, int]]:
        """Turns in which the way from a vertex of station s − 1 to one of s cannot be gone, each with what it touches.

        −1 stands for a way that has no pose in between.
        """
        c, st = self.candidates, self.path.stations
        qa = c.q[s - 1, ru, bu]
        qb = qa + wrap(c.q[s, r, b] - qa)
        if not np.abs(qb - qa).max() <= JUMP:
            return []  # no way by itself; nothing to strike out
        every = [int(t) for t in np.flatnonzero(c.feasible[s - 1, ru, bu])]
        rows = np.arange(st[s - 1], st[s] + 1)
        grid = c.phi_at()
        phi = grid[s - 1, ru] + np.array([0.0, float(wrap(grid[s, r] - grid[s - 1, ru]))])
        if len(rows) == 2:
            return self._stretch(rows, phi, np.vstack([qa, qb]), every)
        length = self.path.s[rows]
        f = (length - length[0]) / max(float(length[-1] - length[0]), 1e-12)
        turned, seed = np.full(len(self.path.index), np.nan), np.full((len(self.path.index), 6), np.nan)
        turned[rows] = phi[0] + f * (phi[1] - phi[0])
        out: list[tuple[int, int]] = []
        for t in every:  # a limit in between may hold in one turn and not in another
            seed[rows] = qa + f[:, None] * (qb - qa) + c.turns[t]
            found = realise(self.path, self.checker.arm, self.checker.robot, turned, seed)
            if (found.reason[rows] != Reason.OK).any():
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


def covered(path: Path, choice: Choice) -> NDArray[np.bool_]:
    """(P,) points that the choice covers: between kept stations that are joined, and these themselves."""
    st = path.stations
    out = np.zeros(len(path.index), bool)
    kept = ~choice.dropped
    out[st[kept]] = True
    for s in np.flatnonzero(kept[1:] & kept[:-1]) + 1:
        if path.run[st[s]] == path.run[st[s - 1]] and s not in choice.broken:
            out[st[s - 1] : st[s]] = True
    return out

"""The best sequence that really is free: choose, look, strike out what itself collides, choose again.

::

    choose ─► smooth ─► check ─► free: done
      ▲                   │
      │                   ▼ a contact: less room for the next curve, a few times; then its runs follow the grid
      │                   │ the choice's own vertices or ways collide
      └── certify ◄── choose the stretch again ◄─┴─► look at what lies near the contacts

A vertex (station, rotation, branch) is struck out only for a contact of its own pose, an edge (two vertices of
neighbouring stations) only for a contact or a missing pose on its own way. What is struck out is so for good, and
nothing else ever is: the search ends (each round strikes something out), and a station without vertices, or without
an edge that leads on, is infeasible on this grid.

Only the stretch around a contact is chosen again (:mod:`machopt.plan.rechoose`), until what the sequence
takes is free. That loses nothing: then the whole path is chosen once more on what is left of the grid, and the sequence
stays only if it costs no more than the bound of that choice allows, :data:`machopt.plan.caps.GAP`, which is what a
choice of the whole path claims for itself. Else the whole choice takes its place, and is looked at in turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, any_last
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.model.threads import both
from machopt.plan.ahead import Ahead
from machopt.plan.candidates import Candidates
from machopt.plan.caps import GAP
from machopt.plan.check import Checker, PathCheck
from machopt.plan.choose import Choice
from machopt.plan.edges import Edges
from machopt.plan.path import Path
from machopt.plan.realise import Assignment, realise
from machopt.plan.rechoose import Chooser
from machopt.plan.score import Scores
from machopt.plan.sequence import jump
from machopt.plan.smooth import Smoothed, follow_grid, smooth
from machopt.se3 import wrap

Rows = NDArray[np.intp]
AHEAD = 8000  # vertices looked at around the contacts of the first round, and four times as many in each next
EVERY = 16  # of the first choice's stations is looked at before anything else
STATIONS = 48  # whose ways are looked at in the first round; twice as many in each next
SMOOTHINGS = 4  # with less room each, before a run that collides follows the grid
ROUNDS = 1000  # each strikes something out, so the search ends by itself; an answer this far away is not waited for


@dataclass(frozen=True, kw_only=True)
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
    looked: NDArray[np.bool_]  # (S, R, B) vertices whose own pose was looked at, but for those struck out ahead


@dataclass(kw_only=True)
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
    first: Choice | None = None  # of all the grid, where it was made ahead (:meth:`begin`)
    meanwhile: Callable[[], None] | None = None  # compiled work to be done beside a smoothing, where a core is idle

    def __post_init__(self) -> None:
        S, R, B, T = self.candidates.feasible.shape
        self.shape = (S, R, B, T)
        self.looked = np.zeros((S, R, B), bool)
        self.pairs = np.full((S, R, B), -1, np.int32)
        self.rounds = 0
        self.ahead_of = AHEAD
        model = self.checker.model
        touch = self.path.may_touch[self.path.stations]
        self.ahead = (
            None
            if model is None
            else Ahead(
                candidates=self.candidates,
                model=model,
                may_touch=touch,
                external=self.path.external[self.path.stations],
                pairs=self.pairs,
            )
        )
        self.chooser = Chooser(
            path=self.path,
            candidates=self.candidates,
            scores=self.scores,
            velocity=self.velocity,
            options=self.options,
            wide=np.zeros(S, bool),
        )

    def resume(self, found: Found) -> None:
        """Begin with what an earlier search over the same candidates found out."""
        self.pairs[:], self.looked[:], self.chooser.wide[:] = found.pairs, found.looked, found.wide
        self.edges, self.banned = found.edges, dict(found.banned)

    def begin(self) -> None:
        """Make the first choice, which asks for no contacts: :meth:`run` then begins with it."""
        self.first = self.chooser.whole(self.edges)

    def run(self, prefer_grid: Callable[[Choice, Assignment, Assignment], bool]) -> Found:
        """Search to the end.

        Args:
            prefer_grid: told the choice, the smooth and the plain assignment, whether the plain one is better.
        """
        budget, smoothings, grid_is_free = STATIONS, 0, False
        choice, self.first = self.first or self._choose(), None
        if self._strike_chosen(choice, EVERY):  # a curve through contacts is not worth its time
            choice = self._again(choice)
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
                struck = self._strike_along(choice, found, check)  # less room for the next curve
                if not self._strike_chosen(choice) and not self._gone(choice):
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
            if source == "grid" and not self._strike_chosen(choice):
                self._strike_grid(choice, found, check, budget)
            budget, grid_is_free = 2 * budget, False
            choice = self._again(choice)
        return Found(
            assignment=self._without_breaks(found, choice),
            source=source,
            choice=choice,
            check=check,
            rounds=self.rounds,
            pairs=self.pairs,
            banned=self.banned,
            edges=self.edges,
            wide=self.chooser.wide,
            looked=self.looked,
        )

    # --- choosing ------------------------------------------------------------------------------------------------

    def _again(self, choice: Choice) -> Choice:
        """A choice in place of one that has lost vertices or ways, with vertices that are free by themselves."""
        while self.rounds < ROUNDS:
            local = self.chooser.around(choice, self.edges)
            if local is None:
                choice = self._choose()
                if not self._strike_chosen(choice):
                    return choice
            else:
                choice = local
                if not self._strike_chosen(choice):
                    whole = self._choose()
                    if choice.total * (1.0 - GAP) <= whole.bound * (1.0 + 1e-12):
                        return replace(choice, bound=min(choice.total, whole.bound), reached=whole.reached)
                    choice = whole
                    if not self._strike_chosen(choice):
                        return choice
            self.rounds += 1
        return self._choose()

    def _choose(self) -> Choice:
        self.progress("choose")
        return self.chooser.whole(self.edges)

    def _smooth(self, choice: Choice) -> Smoothed:
        self.progress("smooth")

        def curve() -> Smoothed:
            return smooth(self.path, self.candidates, self.scores, choice, self.velocity, self.options)

        return curve() if self.meanwhile is None else both(curve, self.meanwhile)[0]

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

        mixed = Assignment(
            **{
                name: np.where(take.reshape(-1, *(1,) * (values.ndim - 1)), values, getattr(curve, name))
                for name, values in vars(plain).items()
            }
        )
        checked = PathCheck(
            np.where(take, grid.hit, check.hit),
            np.where(take, grid.pair, check.pair).astype(np.int32),
            np.where(take, grid.lost, check.lost),
        )
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

    def _strike_chosen(self, choice: Choice, every: int = 1) -> bool:
        """Look at the choice's own vertices, and from those that collide on; whether it has lost any."""
        s = np.flatnonzero(~choice.dropped)[::every]
        return self._look(s, choice.rotation[s], choice.branch[s]) > 0

    def _strike_along(self, choice: Choice, a: Assignment, check: PathCheck) -> int:
        """Look at the vertices on either side of a curve where it collides, and from those that do on.

        Returns:
            how many vertices are struck out.
        """
        s = self._stations(check.hit)
        s = s[~choice.dropped[s]]
        grid, (R, phi) = self.candidates.phi_at(), (self.shape[1], a.phi[self.path.stations[s]])
        low = np.floor(wrap(phi - grid[s, 0]) / (2 * np.pi / R)).astype(int)
        both, sides = np.tile(s, 2), np.concatenate([low, low + 1]) % R
        return self._look(both, sides, choice.branch[both])

    def _look(self, s: Rows, r: Rows | NDArray[np.int32], b: NDArray[np.int32]) -> int:
        """Look at vertices not looked at before, and ahead from those that collide; how many are struck out."""
        ahead = self.ahead
        usable = any_last(self.candidates.feasible[s, r, b]) & ~self.looked[s, r, b]
        if ahead is None or not usable.any():
            return 0
        s, r, b = s[usable], r[usable], b[usable]
        self.progress("check")
        found = ahead.model.check(ahead.whole(s, r, b), ahead.may_touch[s])
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

    def _kept(self, choice: Choice, stations: Rows, budget: int) -> Rows:
        """Stations that have a choice, no more than ``budget`` of them, spread evenly."""
        stations = stations[~choice.dropped[stations]]
        if len(stations) > budget:
            stations = stations[np.unique(np.linspace(0, len(stations) - 1, budget).round().astype(int))]
        return stations

    def _strike_grid(self, choice: Choice, plain: Assignment, check: PathCheck, budget: int) -> None:
        """Strike out the vertices and edges of the grid's own sequence that collide or lead nowhere."""
        before = int(self.candidates.feasible.sum()), len(self.edges)
        stations = self._kept(choice, self._stations(check.hit | check.lost), budget)
        for s in stations:  # a pose on the very edge of a limit or margin: rounding decides
            why = plain.reason[self.path.stations[s]]
            if why != Reason.OK:
                self._drop(choice, int(s), int(why))
        for at in stations:
            s = int(at)
            joined = s > 0 and s not in choice.broken and not choice.dropped[s - 1]
            if joined and self.path.run[self.path.stations[s]] == self.path.run[self.path.stations[s - 1]]:
                gone = [
                    not self.candidates.feasible[k, choice.rotation[k], choice.branch[k], choice.turn[k]]
                    for k in (s - 1, s)
                ]
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
        """Strike out the ways into station s that turn as far as the chosen one and are not free, on either side of it
        up to the first that is."""
        _, R, B, T = self.shape
        b, bu = int(choice.branch[s]), int(choice.branch[s - 1])
        here, before = int(choice.rotation[s]), int(choice.rotation[s - 1])
        c, bans = self.candidates, []
        for side in (range(R), range(-1, -R, -1)):
            for k in side:
                r, ru = (here + k) % R, (before + k) % R
                if not (c.feasible[s, r, b].any() and c.feasible[s - 1, ru, bu].any()):
                    break
                found = self._edge(s, ru, bu, r, b)
                for t, pair in found:
                    bans.append((s, (ru * B + bu) * T + t, (r * B + b) * T))
                    self.banned[s] = pair
                if not found:
                    break
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
        if not np.abs(qb - qa).max() <= jump(c.stable):
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

"""Lookahead from contacts: excluded edges are in contact; the search budget is respected."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead

S, R, B = 30, 12, 2


@dataclass
class Bodies:
    """A stub with contacts at given vertices; the joint values of a vertex are its indices."""

    truth: Bools  # (P, S, R, B)
    asked: list[tuple[int, int, int, int]] = field(default_factory=list)
    pairs: list[Any] = field(default_factory=lambda: [SimpleNamespace(unless_cutting=k == 1) for k in range(2)])

    def check_single_pairs(self, q: Array, pair: Any) -> Bools:
        s, r, b = q[:, :3].astype(int).T
        self.asked += list(zip(pair.tolist(), s.tolist(), r.tolist(), b.tolist(), strict=True))
        return self.truth[pair, s, r, b]


def ahead_of(truth: Bools, may_touch: Bools | None = None) -> ContactLookahead:
    q = np.stack(np.meshgrid(np.arange(S), np.arange(R), np.arange(B), indexing="ij"), axis=-1).astype(float)
    candidates = SimpleNamespace(
        q=np.concatenate([q, np.zeros((S, R, B, 3))], axis=-1),
        feasible=np.ones((S, R, B, 1), bool),
        reason=np.full((S, R, B), InfeasibilityReason.OK, np.int8),
    )
    touch = np.zeros(S, bool) if may_touch is None else may_touch
    pairs = np.full((S, R, B), -1, np.int32)
    return ContactLookahead(
        candidates=candidates, model=Bodies(truth), may_touch=touch, external=np.zeros((S, 0)), pairs=pairs
    )  # type: ignore[arg-type]


def block(pair: int = 0) -> Bools:
    truth = np.zeros((2, S, R, B), bool)
    truth[pair, 5:15, [11, 0, 1, 2], 0] = True  # across the 0°/360° limit of the rotation
    truth[pair, 25:28, 6, 0] = True  # a second contact region that is not connected to the first
    return truth


def start_lookahead(ahead: ContactLookahead, s: int, r: int, b: int, pair: int, budget: int) -> int:
    vertex = np.array([np.ravel_multi_index((s, r, b), (S, R, B))])
    pairs = np.array([pair], np.int32)
    ahead.strike(vertex, pairs)
    return ahead.look(vertex, pairs, budget)


def test_every_contact_around_a_contact_is_excluded_and_nothing_else() -> None:
    ahead = ahead_of(block())
    start_lookahead(ahead, 8, 0, 0, 0, 10_000)
    gone = ~ahead.candidates.feasible[..., 0]
    assert gone[5:15][:, [11, 0, 1, 2], 0].all()
    assert gone.sum() == 40
    assert (ahead.pairs[gone] == 0).all()
    assert (ahead.candidates.reason[gone] == InfeasibilityReason.COLLIDING).all()
    assert (ahead.pairs[~gone] == -1).all()
    requested = ahead.model.asked  # type: ignore[attr-defined]
    assert len(set(requested)) == len(requested)  # no vertex is checked twice


def test_nothing_is_checked_without_a_contact() -> None:
    ahead = ahead_of(block())
    none = np.zeros(0, np.intp)
    # and no warning of a division by zero, as earlier with --map-collisions full
    assert ahead.look(none, none.astype(np.int32), 100) == 0
    assert ahead.candidates.feasible.all()


def test_no_ring_starts_beyond_the_budget() -> None:
    """The next call continues from the end of this one, with a larger budget."""
    ahead = ahead_of(np.ones((2, S, R, B), bool))
    looked = start_lookahead(ahead, 15, 6, 0, 0, 20)
    widest = 4 * R + 2 * S  # maximum length of a ring around one vertex
    assert 20 <= looked < 20 + widest
    assert (~ahead.candidates.feasible).sum() == looked + 1
    assert start_lookahead(ahead_of(np.ones((2, S, R, B), bool)), 15, 6, 0, 0, 10_000) == S * R * B - 1


def test_pairs_share_the_budget_in_proportion_to_their_contacts() -> None:
    ahead = ahead_of(np.ones((2, S, R, B), bool))
    vertices = np.array([np.ravel_multi_index((s, 6, 0), (S, R, B)) for s in (2, 4, 6, 8, 27)])
    pair = np.array([0, 0, 0, 0, 1], np.int32)
    ahead.strike(vertices, pair)
    ahead.look(vertices, pair, 40)
    values = [sum(p == which for p, *_ in ahead.model.asked) for which in (0, 1)]  # type: ignore[attr-defined]
    assert values[0] >= 32
    assert values[0] > 2 * values[1] > 0


def test_cutter_may_touch_what_it_cuts() -> None:
    may = np.zeros(S, bool)
    may[10:] = True
    ahead = ahead_of(block(1), may)
    start_lookahead(ahead, 8, 0, 0, 1, 10_000)
    gone = ~ahead.candidates.feasible[..., 0]
    assert gone[5:10][:, [11, 0, 1, 2], 0].all()
    assert not gone[10:].any()

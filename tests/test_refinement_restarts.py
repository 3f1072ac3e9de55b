"""Restarts of the external axis refinement after it stops improving."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from machopt.planning.external_axis_optimization import refinement_restarts
from machopt.planning.external_axis_optimization.refinement_restarts import has_stalled, refine_other_starts


def plan(total: float, sequence: float | None, why: str = "") -> Any:
    """Return a stand-in for a plan: its J and the J of the best sequence that is known near it."""
    over = None if sequence is None else SimpleNamespace(why=why, sequence=sequence, plan=total)
    return SimpleNamespace(total=total, over_external=over)


@pytest.mark.parametrize(
    ("total", "sequence", "why", "stalled"),
    [(1.0, 0.97, "", True), (1.0, 0.995, "", False), (1.0, None, "", False), (1.0, 0.9, "too many poses", False)],
)
def test_plan_has_stalled_where_a_sequence_one_percent_better_is_known(
    total: float, sequence: float | None, why: str, stalled: bool
) -> None:
    assert has_stalled(plan(total, sequence, why)) is stalled


@pytest.mark.parametrize(("sequences", "refined"), [([0.9, 0.9, 0.9], 2), ([0.999, 0.9, 0.9], 1)])
def test_other_starts_are_refined_until_one_has_not_stalled(
    sequences: list[float], refined: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refinement_restarts, "OTHERS", 2)
    monkeypatch.setattr(refinement_restarts, "refine_plan", lambda start, job, trust: start)
    monkeypatch.setattr(refinement_restarts, "leap_to_better_sequences", lambda start, job: [start])
    starts = [plan(1.0, s) for s in sequences]
    assert refine_other_starts(starts, job=None, trust=0.2) == starts[:refined]  # type: ignore[arg-type]


@pytest.mark.parametrize(("points", "tried"), [(80, 2), (1000, 1)])
def test_short_path_is_refined_near_the_sequence_after_a_failure(
    points: int, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    trusts: list[float] = []

    def refine(one: Any, job: None, *, trust: float, start: None) -> Any:
        trusts.append(trust)
        return one

    monkeypatch.setattr(refinement_restarts, "refine_plan", refine)
    one: Any = SimpleNamespace(path=SimpleNamespace(index=range(points)))
    assert refinement_restarts._refine_from_sequence(one, None, None) is one  # type: ignore[arg-type]
    assert trusts == sorted(refinement_restarts.TRUSTS, reverse=True)[:tried]

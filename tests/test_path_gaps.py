"""Executed runs around unreachable points, computed by hand on two short passes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from test_sequence_search import line

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.planning.pipeline.gaps import find_driven_stretches, find_uncut_points, mark_gaps
from machopt.planning.pipeline.sequence_breaks import SequenceBreak, find_configuration_jumps
from machopt.planning.stations.planning_path import PlanningPath


@dataclass
class Assignment:
    """The part of the planner's assignment that is read here."""

    reason: np.ndarray
    q: np.ndarray = field(default_factory=lambda: np.zeros((9, 6)))


@dataclass
class Chosen:
    assignment: Assignment
    cost: np.ndarray = field(default_factory=lambda: np.ones(9))


@dataclass
class Planned:
    path: PlanningPath
    chosen: Chosen
    breaks: tuple[SequenceBreak, ...] = ()
    notes: dict[int, str] = field(default_factory=dict)


@pytest.fixture(scope="module")
def path() -> PlanningPath:
    """Points 0 … 3 and 4 … 8; a rapid move leads to 0 and to 4, cuts lead to the others."""
    found = line(9, rapid=(0, 4))
    assert found.runs == ((0, 3), (4, 8))
    return found


def reasons(*unreachable: int) -> np.ndarray:
    out = np.full(9, InfeasibilityReason.OK, np.uint8)
    out[list(unreachable)] = InfeasibilityReason.LIMIT
    return out


def jump_between(before: float, after: float) -> SequenceBreak:
    return SequenceBreak(
        before=before, after=after, code="joint_jump", text="joint 4 jumps", help="", joint=4, value=150.0, limit=120.0
    )


@pytest.mark.parametrize(
    ("unreachable", "breaks", "driven", "left"),
    [
        ((), (), [(0, 3), (4, 8)], []),
        ((6,), (), [(0, 3), (4, 5), (7, 8)], [6, 7]),  # the cut to the point and the cut from it
        ((1, 3), (), [(4, 8)], [1, 2, 3]),  # 0 and 2 alone contain no complete cut
        ((5, 7), (), [(0, 3)], [5, 6, 7, 8]),
        ((4,), (), [(0, 3), (5, 8)], [5]),  # a rapid point: the cut from it is omitted
        ((), (jump_between(1, 2),), [(0, 1), (2, 3), (4, 8)], [2]),
    ],
)
def test_runs_and_omitted_cuts(
    path: PlanningPath,
    unreachable: tuple[int, ...],
    breaks: tuple[SequenceBreak, ...],
    driven: list[tuple[int, int]],
    left: list[int],
) -> None:
    found = find_driven_stretches(path, reasons(*unreachable), breaks)
    assert found == driven
    assert np.flatnonzero(find_uncut_points(path, found)).tolist() == left


def mark_unreachable(
    path: PlanningPath, unreachable: tuple[int, ...], given_up: Any = None, breaks: tuple[SequenceBreak, ...] = ()
) -> Any:
    plan: Any = Planned(path, Chosen(Assignment(reasons(*unreachable))), breaks)
    driven = find_driven_stretches(path, plan.chosen.assignment.reason, breaks)
    if given_up:
        driven = [s for s in driven if s not in given_up]
    return mark_gaps(plan, driven, given_up or {})


def test_every_omitted_cut_states_a_reason(path: PlanningPath) -> None:
    plan = mark_unreachable(path, (6,))
    assert plan.chosen.assignment.reason[[5, 6, 7, 8]].tolist() == [
        InfeasibilityReason.OK,
        InfeasibilityReason.LIMIT,
        InfeasibilityReason.GAP,
        InfeasibilityReason.OK,
    ]
    assert np.flatnonzero(np.isnan(plan.chosen.cost)).tolist() == [7]
    assert plan.notes[7].startswith("the cut to it is left out: point 6 cannot be reached")

    plan = mark_unreachable(path, (), breaks=(jump_between(1, 2),))
    assert plan.notes == {2: "the cut to it is left out: joint 4 jumps; the tool is lifted there"}

    plan = mark_unreachable(path, (), {(4, 8): "no way to it is free"})
    assert plan.notes == dict.fromkeys((5, 6, 7, 8), "no way to it is free")


def test_complete_path_has_no_marks(path: PlanningPath) -> None:
    plan = mark_unreachable(path, ())
    assert plan.notes == {}
    assert np.isfinite(plan.chosen.cost).all()


def test_unsearched_jump_of_a_sequence_is_a_break(path: PlanningPath) -> None:
    """130° at joint 4 on the way to point 6 is a break; 130° on the rapid move to 4, or 110° anywhere, is not."""
    q = np.zeros((9, 6))
    q[4:, 1] += np.radians(130.0)
    q[6:, 3] -= np.radians(130.0)
    q[8:, 5] += np.radians(110.0)
    scored: Any = Chosen(Assignment(reasons(), q))
    (found,) = find_configuration_jumps(path, scored)
    assert (found.before, found.after, found.code, found.joint) == (5.0, 6.0, "joint_jump", 4)
    assert found.value == pytest.approx(130.0)
    assert "joint 4 would have to jump by 130.0°" in found.text
    for unknown in (5, 6):  # no configuration is known at this point, so there is no jump
        scored = Chosen(Assignment(reasons(unknown), q))
        assert find_configuration_jumps(path, scored) == ()

"""Blend zones of a written program, compared with the rule of its post."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from machopt.data_types.robot_program import RobotController
from machopt.programs.writing.blend_zones import HALF, SHORTEST, BlendZones
from machopt.verification.folder.programs.blend_zones import check_blend_zones


@dataclass(frozen=True)
class Moves:
    blend: float  # m, tolerance
    count: int

    def __len__(self) -> int:
        return self.count


def is_stop_a_fault(room: float, turn: float = 1e-4) -> bool:
    """Return whether an exact stop is a fault if ``room`` m are available for a blend zone and the lines are almost
    straight."""
    n = 3
    law = BlendZones(np.full(n, SHORTEST), np.ones(n, bool), np.full(n, turn), np.full(n, room))
    parsed = SimpleNamespace(dialect="krl", blend=np.zeros(n), line=np.arange(n))
    program = Moves(5e-5, n)
    (check,) = check_blend_zones("a.src", parsed, program, law, RobotController(), zones=True, own=False)  # type: ignore[arg-type]
    return not check.passed


@pytest.mark.parametrize("beyond", [0.0, 1e-9, 5e-7])
def test_exact_stop_without_room_for_the_smallest_blend_zone_is_accepted(beyond: float) -> None:
    """Points 0.051 mm apart: post and verifier differ by the printed digits of the coordinates.

    A correct plan with 300,000 points failed because of three such moves.
    """
    assert not is_stop_a_fault(SHORTEST + HALF * beyond)


def test_exact_stop_with_room_is_timed_with_braking() -> None:
    assert is_stop_a_fault(2 * SHORTEST)
    assert is_stop_a_fault(SHORTEST + 1e-5)

"""Position error of measured poses in result.json, recomputed from cell file and joint angles."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machopt.data_types.documents.optimize_document import PositionErrorSection
from machopt.data_types.stiffness import PositionError
from machopt.verification.folder.result_json.position_error import check_position_error

KNOWN = PositionError(3e-5, 9e-4, 2e-5, 60, np.radians(np.tile([-90.0, 90.0], (6, 1))))
RIGHT: dict[str, Any] = {
    "std_mm": 0.03,
    "beyond_mm": 0.9,
    "outside_percent": 40.0,
    "outside_joints": (3,),
    "corrected": True,
    "noise_mm": 0.02,
    "poses": 60,
}


class Columns:
    """points.csv of four points; joint 3 is outside its range at two of them, and the last has no configuration."""

    def __contains__(self, name: str) -> bool:
        return True

    def read_words(self, name: str) -> list[str]:
        return ["ok", "ok", "ok", "unreachable"]

    def read_numbers(self, name: str, *, empty: bool) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([10.0, 95.0, 120.0, np.nan] if name == "q3_deg" else [10.0, 20.0, 90.5, np.nan])


def check_stated_error(
    told: dict[str, Any] | None, known: PositionError | None = KNOWN, kinematics: object = "some"
) -> list[str]:
    result = SimpleNamespace(position_error=None if told is None else PositionErrorSection(**told))
    path = type("Path", (), {"__len__": lambda _: 4, "cutting": np.ones(4, bool)})()
    stiffness = None if known is None else SimpleNamespace(position=known)
    cell = SimpleNamespace(stiffness=stiffness, kinematics=kinematics)
    return list(check_position_error(SimpleNamespace(result=result, cell=cell, toolpath=path, points=Columns())))  # type: ignore[arg-type]


def test_values_that_follow_from_cell_and_points_pass() -> None:
    assert check_stated_error(RIGHT) == []
    assert check_stated_error(None, known=None) == []
    assert check_stated_error(RIGHT | {"std_mm": 0.9, "corrected": False}, kinematics=None) == []


@pytest.mark.parametrize(
    "changed",
    [
        {"std_mm": 0.015},
        {"beyond_mm": 0.03},
        {"noise_mm": 0.03},
        {"poses": 600},
        {"corrected": False},
        {"outside_joints": (), "outside_percent": 0.0},
        {"outside_percent": 0.0},
        {"outside_percent": 140.0},
    ],
)
def test_inconsistent_values_are_reported(changed: dict[str, Any]) -> None:
    wrong = check_stated_error(RIGHT | changed)
    assert wrong
    assert all(w.startswith(f"position_error.{next(iter(changed))}") or "outside" in w for w in wrong)


def test_unfounded_and_missing_errors_are_reported() -> None:
    assert check_stated_error(RIGHT, known=None)
    assert check_stated_error(None)

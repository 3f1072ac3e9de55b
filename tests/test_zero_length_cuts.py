"""Cuts without length, and feeds at which a path would take weeks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_cli import KR500, optimize

QUICK = ("--set", "rotation_step_deg=45", "--set", "collision=false")


def table(folder: Path, *rows: tuple[float, float], feed: float = 1000.0) -> Path:
    """Return cuts to (x, y) mm with an upright tool; the first row is a cut."""
    lines = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", *(f"{x},{y},0,0,0,1,cut,{feed}" for x, y in rows)]
    file = folder / "cuts.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.mark.parametrize(
    "rows",
    [
        [(0, 0), (0, 0), (0, 0), (0, 0), (0, 0)],
        [(0, 0), (0, 0), (50, 0)],
        [(0, 0), (0, 0), (50, 0), (50, 0), (50, 0), (50, 40), (50, 40)],
    ],
    ids=["nowhere", "doubled at its begin", "doubled everywhere"],
)
def test_points_given_more_than_once_are_planned_and_verified(tmp_path: Path, rows: list[tuple[float, float]]) -> None:
    assert optimize(KR500, table(tmp_path, *rows), tmp_path / "out", *QUICK) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["verification"]["passed"]
    assert result["feed_held_share"] > 0.5


def test_a_feed_of_micrometres_is_refused_by_its_duration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path, (0, 0), (10, 0), (50, 0), feed=0.001)
    assert optimize(KR500, file, tmp_path / "out", *QUICK) == 2
    message = capsys.readouterr().err
    assert "cuts.csv" in message
    assert "line 4" in message
    assert "0.001 mm/min" in message
    assert not (tmp_path / "out").exists()


def test_moves_without_a_feed_of_their_own_count_at_that_of_the_approach(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cuts.csv"
    file.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n0,0,50,0,0,1,rapid,\n0,0,0,0,0,1,approach,\n50,0,0,0,0,1,cut,500\n"
    )
    assert optimize(KR500, file, tmp_path / "out", *QUICK, "--set", "approach_feed_mm_min=0.001") == 2
    assert "to point 1, has 0.001 mm/min" in capsys.readouterr().err
    assert optimize(KR500, file, tmp_path / "out", *QUICK) == 0

"""A path read in the wrong unit is refused with the option for the correct one."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_cli import KR500, optimize

ROWS = ((-0.1, 0.0, 0.04, "rapid"), (-0.1, 0.0, 0.0, "cut"), (0.1, 0.0, 0.0, "cut"), (0.1, 0.1, 0.0, "cut"))


def table(folder: Path, per_metre: float) -> Path:
    """The same corner of 200 mm × 100 mm, with numbers in any unit."""
    lines = ["x,y,z,i,j,k,move"]
    for x, y, z, move in ROWS:
        numbers = ",".join(f"{v * per_metre:.9f}" for v in (x, y, z))
        lines.append(f"{numbers},0,0,1,{move}")
    file = folder / "corner.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.mark.parametrize(
    ("per_metre", "unit", "says"),
    [
        (2.5e3, "inch", "inches that are mm"),  # half a metre becomes 12.7 m
        (1e6, "mm", "thousandths"),
    ],
)
def test_other_unit_is_suggested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], per_metre: float, unit: str, says: str
) -> None:
    options = ("--unit", unit, "--feed", "1000", "--max-extent", "1e6")
    assert optimize(KR500, table(tmp_path, per_metre), tmp_path / "out", *options) == 2
    message = capsys.readouterr().err
    assert "--unit" in message
    assert says in message
    assert not (tmp_path / "out").exists()


def test_path_partly_in_reach_is_planned_with_a_question(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A large part is possible: here 5 m, of which the arm reaches a part."""
    options = ("--unit", "inch", "--feed", "1000", "--set", "rotation_step_deg=45", "--set", "collision=false")
    assert optimize(KR500, table(tmp_path, 1e3), tmp_path / "out", *options) == 3
    assert "is another --unit needed?" in capsys.readouterr().err


def test_correct_unit_is_planned(tmp_path: Path) -> None:
    options = ("--unit", "mm", "--feed", "1000", "--set", "rotation_step_deg=30")
    assert optimize(KR500, table(tmp_path, 1e3), tmp_path / "out", *options) == 0


def test_path_of_a_fifth_of_a_millimetre_is_questioned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path, 1.0)
    file.write_text(file.read_text().replace("x,y,z", "x_mm,y_mm,z_mm"))
    assert optimize(KR500, file, tmp_path / "out", "--feed", "1000") == 2
    message = capsys.readouterr().err
    assert "--unit mm" in message
    assert "metres" in message


def test_far_part_in_a_stated_unit_is_out_of_reach_with_its_distance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In inches it would be within reach; with the option mm the part is far away."""
    file = table(tmp_path, 1e3)
    rows = file.read_text().replace("-100.000000000,", "20000,").replace("\n100.000000000,", "\n20200,")
    file.write_text(rows)
    options = ("--feed", "1000", "--set", "rotation_step_deg=45", "--set", "collision=false")
    assert optimize(KR500, file, tmp_path / "out", "--unit", "mm", *options) == 3
    message = capsys.readouterr().err
    assert "out of reach" in message
    assert "mm outside the workspace" in message
    file.write_text(rows.replace("x,y,z", "x_mm,y_mm,z_mm"))  # the file itself states mm, which may be wrong
    assert optimize(KR500, file, tmp_path / "again", *options) == 2
    assert "--unit" in capsys.readouterr().err

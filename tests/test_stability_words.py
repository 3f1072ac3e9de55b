"""Stability columns at low speeds, with tool modes, and without stated damping."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from output_damage.damage_case import CELLS, HEADER, PASS

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from machopt.verification.tables.csv_columns import read_columns

TOOL_MODES = "modes: [{f_Hz: 900, zeta: 0.03, k_N_um: 20, direction: [1, 0, 0]}]"


def plan_wall(folder: Path, changes: dict[str, tuple[str, str]]) -> tuple[int, dict[str, list[str]]]:
    """Plan a finished wall in the milling cell with replaced texts in its files;
    return the exit code and points.csv."""
    toolpath = folder / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS))
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    cell = folder / "cell" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + "process: process.yaml\n", encoding="utf-8")
    for name, (old, new) in changes.items():
        file = folder / "cell" / name
        text = file.read_text(encoding="utf-8")
        assert old in text
        file.write_text(text.replace(old, new), encoding="utf-8")
    request = OptimizeRequest(
        cell=folder / "cell", toolpath=toolpath, out=folder / "out", overrides=("rotation_step_deg=15",)
    )
    code = run_optimize(request).exit_code
    return code, read_columns(folder / "out" / "points.csv")


@pytest.mark.slow
@pytest.mark.parametrize("rpm", [900, 2500])
def test_poles_of_the_delay_are_no_limit(rpm: int, tmp_path: Path) -> None:
    """Poles of the verifier's own law: a correct plan at a low speed passes."""
    code, table = plan_wall(tmp_path, {"process.yaml": ("spindle_rpm: 12000", f"spindle_rpm: {rpm}")})
    assert code == 0
    assert any(float(v) > 0.5 for v in table["a_lim_mm"] if v)


@pytest.mark.slow
@pytest.mark.parametrize("damping", ["", "modes: {damping_percent: [3, 3], source: assumed}"])
def test_modes_of_the_tool_alone_leave_nothing_stable(damping: str, tmp_path: Path) -> None:
    changes = {
        "process.yaml": ("modes: {damping_percent: 3, source: assumed}", damping),
        "cell.yaml": ("helix_deg: 30}", f"helix_deg: 30, {TOOL_MODES}}}"),
    }
    code, table = plan_wall(tmp_path, changes)
    assert code == 0
    words = {word for word in table["chatter"] if word}
    assert words
    assert "stable" not in words

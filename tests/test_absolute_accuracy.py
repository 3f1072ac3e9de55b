"""``controller.absolute_accuracy``: corrections of the controller are not applied twice; verify agrees."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_cli import PASS, changed_cell, optimize, toolpath
from test_kinematics_file import ALL, joints

from machopt.cell.absolute_accuracy import KEY
from machopt.cell.cell_reader import load_cell
from machopt.cell.kinematics_file import write_kinematics
from machopt.cli import main

STATES = ("on", "off", "unknown", "")


def plan_milling_pass(
    folder: Path, state: str, *, kinematics: bool, compensate: bool = False
) -> tuple[Path, Path, Path]:
    """Plan one milling pass and return (cell, toolpath, out)."""
    folder.mkdir()
    cell = changed_cell(folder)
    if kinematics:
        write_kinematics(cell / "kinematics.yaml", ALL)
    text = (cell / "cell.yaml").read_text()
    if kinematics:
        text = text.replace("stiffness: stiffness.yaml", "stiffness: stiffness.yaml\nkinematics: kinematics.yaml", 1)
    if state:
        lines = text.splitlines()
        n = next(k for k, line in enumerate(lines) if line.startswith("controller:"))
        inline = lines[n].strip() != "controller:"
        if inline:
            lines[n] = lines[n].replace("{", "{absolute_accuracy: " + state + ", ", 1)
        else:
            lines.insert(n + 1, f"  absolute_accuracy: {state}")
        text = "\n".join(lines) + "\n"
    (cell / "cell.yaml").write_text(text)
    table, out = toolpath(folder, PASS), folder / "out"
    words = ["--set", "rotation_step_deg=15", *(["--compensate", "--set", "force_N=FORCE"] if compensate else [])]
    force = "{travel: 120, normal: 250, axial: 80}"
    assert optimize(cell, table, out, *(w.replace("FORCE", force) for w in words)) == 0
    return cell, table, out


def read_messages(out: Path) -> tuple[list[str], list[str], str]:
    """Return the warnings and notes that contain the key, and the text of the program."""
    result = json.loads((out / "result.json").read_text())
    program = next(out.rglob("*.src")).read_text()
    return (*([w for w in result[k] if w.startswith(KEY)] for k in ("warnings", "notes")), program)  # type: ignore[return-value]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    _, _, out = plan_milling_pass(tmp_path_factory.mktemp("plain") / "job", "off", kinematics=False)
    return joints(out / "points.csv")


@pytest.mark.parametrize("state", STATES)
def test_kinematics_file_is_applied_only_without_controller_correction(
    state: str, plain: np.ndarray, tmp_path: Path
) -> None:
    cell, table, out = plan_milling_pass(tmp_path / "job", state, kinematics=True)
    same = np.abs(joints(out / "points.csv") - plain).max() < 1e-9
    warnings, notes, program = read_messages(out)
    assert same == (state == "on")
    assert bool(notes) == (state == "on")
    assert bool(warnings) == (state in ("unknown", ""))
    assert ("absolute accuracy on" in program) == (state == "on")
    assert (f"{KEY[0].upper()}{KEY[1:]} is unknown" in (out / "report.html").read_text()) == bool(warnings)
    assert main(["verify", str(cell), str(table), str(out), "--quiet"]) == 0
    assert load_cell(cell).kinematics is not None  # measurements still use the kinematics file


@pytest.mark.parametrize("state", STATES)
def test_compensation_covers_only_the_process_force(state: str, tmp_path: Path) -> None:
    cell, table, out = plan_milling_pass(tmp_path / "job", state, kinematics=state == "on", compensate=True)
    warnings, notes, program = read_messages(out)
    assert bool(warnings) == (state in ("unknown", ""))
    assert len(notes) == (2 if state == "on" else 0)
    assert ("process force alone" in program) == (state == "on")
    assert main(["verify", str(cell), str(table), str(out), "--quiet"]) == 0


def test_no_message_without_a_correction(tmp_path: Path) -> None:
    _, _, out = plan_milling_pass(tmp_path / "job", "", kinematics=False)
    assert read_messages(out)[:2] == ([], [])


@pytest.mark.parametrize("word", ["yes", "true", "ON", "1", "maybe"])
def test_unknown_values_are_refused(word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = changed_cell(tmp_path, ("controller:\n", f"controller:\n  absolute_accuracy: {word}\n"))
    assert main(["validate", str(cell), "--quiet"]) == 2
    assert "absolute_accuracy" in capsys.readouterr().err

"""``--dry-run``: a recording is described and compared with the model of the cell; nothing is written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from machopt.cli import main
from machopt.commands.recording_preview import preview_recording
from machopt.measurement.estimation.cell_residuals import align_points
from machopt.measurement.recording import load_recording

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "irb6700_drilling"
RECORDING = CELL / "recordings" / "zhang2025_table2"


def run(*words: str | Path) -> int:
    return int(main([str(word) for word in words]) or 0)


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_dry_run_needs_no_output_folder(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, CELL, RECORDING, "--dry-run", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "deflection"
    assert found["readings"] == 30
    assert found["poses"] == 10
    assert [c["name"] for c in found["columns"]][:2] == ["pose", "q1_deg"]
    recording = load_recording(RECORDING)
    assert recording.displacement is not None
    rms = 1e3 * float(np.sqrt(np.mean(recording.displacement[:, :3] ** 2)))
    assert found["rms_mm"] == pytest.approx(rms, rel=1e-9)


def test_output_folder_is_required_without_dry_run(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        run("diagnose", CELL, RECORDING)
    assert stop.value.code == 2
    assert "--out" in capsys.readouterr().err


def test_factors_and_unused_columns_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(RECORDING, tmp_path / "recording")
    data = tmp_path / "recording" / "data.csv"
    lines = data.read_text(encoding="utf-8").splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("pose"))
    header = lines[at].replace("q1_deg", "A1 [rad]") + ",remark"
    body = []
    for line in lines[at + 1 :]:
        cells = line.split(",")
        cells[1] = repr(float(np.radians(float(cells[1]))))
        body.append(",".join([*cells, "ok"]))
    data.write_text("\n".join([header, *body]) + "\n", encoding="utf-8")
    keys = tmp_path / "recording" / "recording.yaml"
    keys.write_text(keys.read_text(encoding="utf-8") + '\ncolumns: {q1_deg: "A1 [rad]"}\n', encoding="utf-8")
    preview = preview_recording(CELL, [tmp_path / "recording"])
    by_name = {c.column: c for c in preview.columns}
    assert by_name["A1 [rad]"].name == "q1_deg"
    assert by_name["A1 [rad]"].factor == pytest.approx(180.0 / np.pi)
    assert by_name["remark"].name == ""
    np.testing.assert_allclose(preview.recording.q, load_recording(RECORDING).q, atol=1e-9)
    assert run("diagnose", CELL, tmp_path / "recording", "--dry-run") == 0
    assert "57.29578" in capsys.readouterr().out


def test_points_are_aligned_by_a_proper_rotation() -> None:
    rng = np.random.default_rng(5)
    points = rng.standard_normal((12, 3))
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    R = q * np.sign(np.linalg.det(q))
    np.testing.assert_allclose(align_points(points @ R.T + [1.0, 2.0, 3.0], points), points, atol=1e-12)
    mirrored = points * [1.0, 1.0, -1.0]
    assert np.abs(align_points(mirrored, points) - points).max() > 0.1  # no reflection

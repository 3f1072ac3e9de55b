"""Written files equal the assessed model: another process recomputes both stated errors from the output folder."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from simulated_hidden_effects import (
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    load_tests,
    plan_load_tests,
    solve_equilibrium,
)

from machopt.cell.cell_reader import load_cell
from machopt.cli import main
from machopt.commands.diagnose.model_files import check_written_errors, read_assessment
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import LEAST_STIFFNESS, ArmStiffness
from machopt.errors import MachoptError
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.outputs import model_assessment
from machopt.measurement.diagnosis.outputs.written_model_error import (
    WrittenModel,
    WrittenResidual,
    compute_written_residual,
)
from machopt.measurement.recording import load_recording, write_recording
from machopt.numerics.array_types import Array

CELL = CELLS / "kr240_drilling"
SCRIPT = Path(__file__).resolve().parents[1] / "benchmarks" / "recompute_diagnosis_errors.py"


def measured_poses(folder: Path, wobble: float = 0.0) -> None:
    """Simulate poses of an arm with a zero offset and with an axis wobble of a joint that no model file can
    describe."""
    rng = np.random.default_rng(5)
    a = arm(CELL.name)
    zero = np.zeros(6)
    zero[2] = 3e-4
    plan = plan_load_tests(a, rng, poses=50, sessions=2, loads=1, directions=1, force=1e-6)
    plan = replace(plan, loaded=~plan.loaded)
    p, _, _, _ = solve_equilibrium(a, HiddenEffects(a.nominal * 1.1, zero=zero), plan)
    keep = plan.loaded
    q, N = plan.q[keep], int(keep.sum())
    nods = wobble * np.stack([np.zeros(N), np.cos(2 * q[:, 0]), np.sin(2 * q[:, 0])], axis=1)
    write_recording(
        folder,
        Recording(
            kind="absolute",
            source="made up",
            q=q,
            pose=plan.pose[keep],
            cycle=plan.cycle[keep],
            session=plan.session[keep],
            line=np.arange(2, N + 2),
            position=p[keep] + nods + 20e-6 * rng.standard_normal((N, 3)),
            time=plan.time[keep],
            registration="fit",
            stated_labels=frozenset({"pose", "cycle", "session"}),
        ),
    )


def loads(folder: Path) -> None:
    """Simulate load tests with a force sensor whose y axis reads 8 % too high."""
    rng = np.random.default_rng(8)
    a = arm(CELL.name)
    plan = plan_load_tests(a, rng, poses=14, sessions=2, loads=3, directions=3, force=1500.0)
    recording = load_tests(a, HiddenEffects(a.nominal * rng.uniform(0.8, 1.25, 6)), plan, rng)
    assert recording.wrench is not None
    wrench: Array = recording.wrench.copy()
    wrench[:, 1] *= 1.08
    write_recording(folder, replace(recording, wrench=wrench))


def move_first_reading(recording: Recording) -> Recording:
    """Return the recording with 5 mm added to the first reading."""
    name = "position" if recording.position is not None else "displacement"
    values = getattr(recording, name).copy()
    values[0, 0] += 5e-3
    return replace(recording, **{name: values})


@pytest.fixture(scope="module", params=[measured_poses, loads], ids=lambda f: f.__name__)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("case")
    request.param(folder / "recording")
    assert main(["diagnose", str(CELL), str(folder / "recording"), "-o", str(folder / "out"), "--quiet"]) == 0
    return folder


def test_errors_are_recomputed_in_another_process(case: Path) -> None:
    command = [sys.executable, str(SCRIPT), str(CELL), str(case / "out"), str(case / "recording")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_corrected_readings_are_a_valid_recording(case: Path) -> None:
    again = load_recording(case / "out" / "readings_corrected.yaml")
    recorded = load_recording(case / "recording")
    assert len(again) == len(recorded)
    assert again.used is not None
    assert again.used.sum() > 0.9 * len(recorded)


def test_folds_hold_out_every_pose_once(case: Path) -> None:
    assessed = read_assessment(case / "out", load_cell(CELL))
    unseen = np.concatenate([f.unseen_poses for f in assessed.folds])
    assert sorted(unseen.tolist()) == sorted(set(assessed.recording.pose.tolist()))


def test_changed_number_in_any_file_is_detected(case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For the model, one fold and the readings: the check and the script both fail.

    The errors of the folds are recomputed only where a file differs from the one they were computed from.
    """
    cell = load_cell(CELL)
    stated = json.loads((case / "out" / "diagnosis.json").read_text(encoding="utf-8"))["final"]
    d = cast(
        "DiagnosisResult",
        SimpleNamespace(rmse=stated["rmse"], heldout_after=stated["heldout_rmse"], findings=()),
    )
    check_written_errors(case / "out", cell, d)
    known = read_assessment(case / "out", cell)
    runs: list[int] = []
    compute = model_assessment.compute_written_residual

    def count(*given: Any) -> WrittenResidual:
        runs.append(1)
        return compute(*given)

    monkeypatch.setattr(model_assessment, "compute_written_residual", count)
    check_written_errors(case / "out", cell, d, known)
    assert len(runs) == 1
    wrong = replace(known, heldout=1.01 * known.heldout)
    with pytest.raises(MachoptError, match=r"internal error: final.heldout_rmse"):
        check_written_errors(case / "out", cell, d, wrong)
    model = "kinematics.yaml" if (case / "out" / "kinematics.yaml").exists() else "stiffness.yaml"
    for name in (model, f"folds/3/{model}", "readings_corrected.csv"):
        shutil.copytree(case / "out", tmp_path / "out")
        file = tmp_path / "out" / name
        text = file.read_text(encoding="utf-8")
        if name.endswith(".csv"):
            write_recording(tmp_path / "moved", move_first_reading(load_recording(file.with_suffix(".yaml"))))
            changed = (tmp_path / "moved" / "data.csv").read_text(encoding="utf-8")
        elif model == "kinematics.yaml":
            changed = text.replace("offset_deg: 0.0", "offset_deg: 0.9")
        else:
            changed = text.replace("joints_Nm_per_rad: [", "joints_Nm_per_rad: [1")
        assert changed != text
        file.write_text(changed, encoding="utf-8")
        with pytest.raises(MachoptError, match="internal error: final"):
            check_written_errors(tmp_path / "out", cell, d, known)
        shutil.rmtree(tmp_path / "out")


def test_written_spring_softer_than_the_range_of_fits_counts_as_written() -> None:
    rng = np.random.default_rng(9)
    a, cell = arm(CELL.name), load_cell(CELL)
    stiffness = np.where(np.arange(6) < 4, a.nominal, LEAST_STIFFNESS / 2)
    plan = plan_load_tests(a, rng, poses=8, sessions=1, loads=2, force=150.0)
    recording = load_tests(a, HiddenEffects(stiffness), plan, rng, NoiseLevels(0, 0, 0, 0, 0, 0))
    every = np.ones(len(recording), bool)
    model = WrittenModel(ArmStiffness(joints=stiffness), None)
    residual = compute_written_residual(cell, model, recording, every, every).values
    assert recording.displacement is not None
    # large deflections: second-order error
    assert np.linalg.norm(residual) < 0.002 * np.linalg.norm(recording.displacement)


@pytest.mark.proof
def test_unstated_form_does_not_lower_the_stated_error(tmp_path: Path) -> None:
    """The named effects are refitted without the unnamed form, and the files alone give the stated error."""
    measured_poses(tmp_path / "recording", wobble=2e-4)
    assert main(["diagnose", str(CELL), str(tmp_path / "recording"), "-o", str(tmp_path / "out"), "--quiet"]) == 0
    final = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["final"]
    rmse, heldout = read_assessment(tmp_path / "out", load_cell(CELL)).errors_mm
    assert rmse == pytest.approx(final["rmse"], rel=1e-3)
    assert heldout == pytest.approx(final["heldout_rmse"], rel=1e-3)

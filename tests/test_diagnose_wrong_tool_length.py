"""Wrong tool length: corrected, diagnosed again, and no other effect named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_hidden_effects import CELLS, HiddenEffects, NoiseLevels, arm, load_tests, plan_load_tests

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, Finding
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording, diagnose_static_recording
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import tcp_offset
from machopt.numerics.rigid_transforms import build_transform

CELL = "kr240_drilling"
OFFSET = np.array([0.0, 0.02, 0.16])  # m in tool axes, from the cell's TCP to the true one


@cache
def simulate_load_tests() -> Recording:
    rng = np.random.default_rng(8)
    a = arm(CELL)
    plan = plan_load_tests(a, rng, poses=14, loads=3, sessions=2, moment=300.0)
    return load_tests(
        a, HiddenEffects(a.nominal * rng.uniform(0.8, 1.2, 6)), plan, rng, NoiseLevels(outliers=0.0), rotations=True
    )


def diagnose_wrong_length(offset: np.ndarray) -> DiagnosedRecording:
    cell = load_cell(CELLS / CELL)
    # the recording was made with the original TCP of the cell
    wrong = cell.tool.T_flange_tcp @ build_transform(np.eye(3), -offset)
    cell = replace(cell, tool=replace(cell.tool, T_flange_tcp=wrong))
    return diagnose_static_recording(
        cell, simulate_load_tests(), selection_pipeline.DiagnosisOptions(), [], accept=(), seed=0
    )


def test_tool_length_is_corrected_and_nothing_else_is_named() -> None:
    d = diagnose_wrong_length(OFFSET).diagnosis
    (finding,) = (f for f in d.findings if f.effect != "geometric_stiffness")
    assert (finding.effect, finding.location, finding.record) == ("load_geometry", "sensor:force", True)
    for name, true in zip("xyz", OFFSET, strict=True):
        output = finding.parameters[f"offset_{name}"]
        assert output.ci95[0] - 0.5 < 1e3 * true < output.ci95[1] + 0.5
    assert finding.after < 1.3 * d.noise_floor
    true = load_cell(CELLS / CELL).tool.T_flange_tcp[:3, 3]
    (words,) = (w for w in d.warnings if "tool.tcp.xyz_mm" in w)
    said_mm = [float(v) for v in words.split("[")[1].split("]")[0].split(",")]
    assert np.abs(np.array(said_mm) - 1e3 * true).max() < 4.0
    assert d.verdict in ("consistent", "explained")


@pytest.mark.parametrize("never", [True, False])
def test_tcp_correction_without_improvement_or_convergence_is_rejected(never: bool) -> None:
    """The law remains a normal finding."""
    first = diagnose_wrong_length(OFFSET * 0.1).diagnosis  # small enough that the law is named by the search
    law = Finding(
        effect="load_geometry",
        location="sensor:force",
        law="TCP elsewhere in the tool",
        equation="",
        note="",
        one_of=(("load_geometry", "sensor:force"),),
        parameters={
            n: EstimatedValue(1.0, "mm", (0.5, 1.5), (0.4, 1.6)) for n in ("offset", "offset_x", "offset_y", "offset_z")
        },
        before=1.0,
        after=0.5,
        p_value=0.01,
    )
    named = replace(first, findings=(law,), heldout_after=0.03, noise_floor=0.02, verdict="explained")
    worse = replace(first, findings=(replace(law, law="another"),), heldout_after=0.04, verdict="partly_explained")
    looks = []

    def look(T: np.ndarray) -> tuple[DiagnosisResult, None]:
        looks.append(T)
        return (named if never or len(looks) == 1 else worse), None

    (d, _), finding = tcp_offset.diagnose_about_found_tcp(np.eye(4), look)
    assert d is named
    assert finding is None
    assert len(looks) == (4 if never else 2)


def test_correct_tool_is_diagnosed_once() -> None:
    d = diagnose_wrong_length(np.zeros(3)).diagnosis
    assert not [w for w in d.warnings if "tool.tcp" in w]
    assert not [f for f in d.findings if f.effect != "geometric_stiffness"]

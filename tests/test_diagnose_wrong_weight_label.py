"""Wrong weight label: a record fault, always reported, and absent in correct records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    build_rough_backlash,
    load_tests,
    plan_load_tests,
)

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.sensor_errors import GAIN
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_quality import wrong_weight_label
from machopt.measurement.diagnosis.diagnosis_pipeline import diagnose_static_recording
from machopt.measurement.diagnosis.model_selection import selection_pipeline

CELL = "kr240_drilling"


def simulate_weights(*, concealed: bool = False, loads: int = 4, sessions: int = 2) -> Recording:
    rng = np.random.default_rng(8)
    a = arm(CELL)
    truth = HiddenEffects(
        a.nominal * rng.uniform(0.75, 1.3, 6), {2: build_rough_backlash(0.7 * ARCMIN, 80.0)} if concealed else {}
    )
    plan = plan_load_tests(a, rng, poses=10, loads=loads, sessions=sessions)
    return load_tests(a, truth, plan, rng, NoiseLevels(outliers=0.01))


def of_size(r: Recording, share: float) -> np.ndarray:
    assert r.wrench is not None
    size = np.linalg.norm(r.wrench[:, :3], axis=1)
    return np.abs(size - share * size.max()) < 0.05 * size.max()


def mislabel_weights(r: Recording, rows: np.ndarray, factor: float) -> Recording:
    assert r.wrench is not None
    return replace(r, wrench=np.where(rows[:, None], factor * r.wrench, r.wrench))


def correct_labels(r: Recording) -> tuple[Recording, list]:
    cell = load_cell(CELLS / CELL)
    return wrong_weight_label.correct_wrong_weight_labels(r, load_robot(cell), cell.tool.T_flange_tcp)


@pytest.mark.parametrize(("share", "factor"), [(0.75, 0.8), (1.0, 1.15), (0.25, 0.8), (0.5, 1.12)])
def test_weight_mislabelled_in_one_session_is_corrected(share: float, factor: float) -> None:
    """These rows were reported as ``outliers``, with the verdict consistent."""
    r = simulate_weights()
    bad = mislabel_weights(r, of_size(r, share) & (r.session == r.session.max()), factor)
    out, findings = correct_labels(bad)
    assert [(f.effect, f.location, f.record) for f in findings] == [("columns", "column:fx_N", True)]
    assert findings[0].parameters["gain"].value == pytest.approx(100.0 * (factor - 1.0), abs=1.5)
    assert findings[0].parameters["session"].value == r.session.max()
    assert np.allclose(out.wrench, r.wrench, rtol=0.02)
    assert "wrong label" in findings[0].note


def test_weight_mislabelled_everywhere_is_reported_where_others_agree() -> None:
    r = simulate_weights()
    out, findings = correct_labels(mislabel_weights(r, of_size(r, 0.5), 1.12))
    assert len(findings) == 2  # one per session
    assert np.allclose(out.wrench, r.wrench, rtol=0.02)
    once, one = correct_labels(
        mislabel_weights(r, of_size(r, 1.0), 1.12)
    )  # the largest weight: a softer gear would have the same effect
    assert one == []
    assert once.wrench is not r.wrench


@pytest.mark.parametrize("concealed", [False, True])
@pytest.mark.parametrize("loads", [2, 4])
def test_correct_weights_remain_unchanged(concealed: bool, loads: int) -> None:
    r = simulate_weights(concealed=concealed, loads=loads)
    out, findings = correct_labels(r)
    assert (findings, out) == ([], r)
    whole = mislabel_weights(r, r.session == r.session.max(), 1.12)  # a gain error of the session, not of one weight
    assert correct_labels(whole)[1] == []


def test_continuous_load_sizes_have_no_labels() -> None:
    r = simulate_weights()
    rng = np.random.default_rng(1)
    assert r.wrench is not None
    assert r.displacement is not None
    any_size = rng.uniform(0.2, 1.0, len(r))[:, None]
    assert correct_labels(replace(r, wrench=any_size * r.wrench, displacement=any_size * r.displacement))[1] == []


def test_diagnosis_names_the_weight_and_nothing_else() -> None:
    r = simulate_weights()
    bad = mislabel_weights(r, of_size(r, 0.75) & (r.session == r.session.max()), 0.8)
    d = diagnose_static_recording(
        load_cell(CELLS / CELL), bad, selection_pipeline.DiagnosisOptions(), [], accept=(), seed=0
    ).diagnosis
    assert [f.effect for f in d.findings] == ["columns"]
    assert GAIN.name not in {f.effect for f in d.findings}
    assert d.verdict == "consistent"

"""Drift of the tracker during a load test is relative to the unloaded state of each cycle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_effects import build_posed_problem, load_test

from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import sensor_errors, thermal_drift
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.numerics.array_types import Array


def build_timed_readings() -> tuple[StaticReadings, Array, Array]:
    """Return four readings per cycle at intervals of 20 s, the time (N,) of each reading and that of the unloaded
    state of its cycle."""
    r, _ = load_test()
    cycle = np.arange(len(r)) // 4
    zero = 170.0 * cycle + 50_000.0 * (cycle >= cycle.max() // 2 + 1)
    time = zero + 20.0 * (1 + np.arange(len(r)) % 4)
    recording = replace(r.recording, time=time, cycle=cycle)
    return replace(r, recording=recording, cycle=cycle, histories={}), time, zero


def test_drifting_tracker_is_named_and_not_an_instrument() -> None:
    r, time, zero = build_timed_readings()
    start = np.where(r.session == 0, 0.0, zero[r.session == 1].min())
    way = np.array([0.4, -0.2, 0.9, 0.0, 0.0, 0.0])
    drift = 2e-4 * (np.exp(-(zero - start) / 1500.0) - np.exp(-(time - start) / 1500.0))[:, None] * way
    tried = HypothesisCatalogue(
        (*thermal_drift.build_thermal_hypotheses(r), *sensor_errors.build_load_test_sensor_hypotheses(r))
    )
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, drift), tried, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert [(f.effect, f.location) for f in found.findings] == [("thermal_drift", "environment")]
    # was named thermal growth of the arm by 10 µm per minute
    assert found.findings[0].law.startswith("the stand shifts")
    low, high = found.findings[0].parameters["drift"].ci95
    assert low < 1e3 * float(np.linalg.norm(drift, axis=1).max()) < high
    louder = selection_pipeline.diagnose_problem(
        build_posed_problem(r, 3.0 * drift), tried, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    size = louder.findings[0].parameters["drift"].value
    assert 0.8 < size / (3e3 * float(np.linalg.norm(drift, axis=1).max())) < 1.25
    still = selection_pipeline.diagnose_problem(
        build_posed_problem(r, 0.0 * drift), tried, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert not still.findings


def test_drift_is_relative_to_the_unloaded_state_and_requires_time() -> None:
    r, time, zero = build_timed_readings()
    even = next(
        h for h in thermal_drift.build_thermal_hypotheses(r) if h.law == "the stand shifts evenly over a session"
    )
    start = np.where(r.session == 0, 0.0, zero[r.session == 1].min())
    longest = (time - start).max()
    columns = even.columns(())
    np.testing.assert_allclose(columns[:, :3], np.eye(3) * ((time - zero) / longest)[:, None, None], rtol=1e-9)
    assert not columns[:, 3:].any()
    assert not thermal_drift.build_thermal_hypotheses(
        replace(r, recording=replace(r.recording, time=None), histories={})
    )


def test_thermal_growth_needs_more_than_a_minute() -> None:
    r, time, _zero = build_timed_readings()
    values = {h.law for h in thermal_drift.build_thermal_hypotheses(r)}
    assert any("stand" in law for law in values)
    assert not any("grow" in law for law in values)
    slow = replace(r.recording, time=time + 900.0 * (np.arange(len(r)) % 4) + 3600.0 * (np.arange(len(r)) // 4))
    assert any(
        "grow" in h.law for h in thermal_drift.build_thermal_hypotheses(replace(r, recording=slow, histories={}))
    )

"""Effects that only one of several sessions shows are not attributed to robot or instrument."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_diagnose_load_test_drift import build_timed_readings
from test_effects import build_posed_problem

from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.effect_columns import sensor_errors
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.screening.session_transfer import compute_session_transfer
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_whitened_model

DAYS, VISITS, READINGS = 2, 10, 6


@pytest.mark.parametrize("days", [(0, 1), (1,)])
def test_effect_present_in_every_session_is_named(days: tuple[int, ...]) -> None:
    r, _, _ = build_timed_readings()
    laws = tuple(
        h
        for h in sensor_errors.build_load_test_sensor_hypotheses(r)
        if h.effect in ("force_sensor_frame", "force_sensor_offset")
    )
    turned = next(h for h in laws if h.effect == "force_sensor_frame")
    moved = turned.columns(turned.shapes[0]) @ np.full(3, 0.01)
    moved[~np.isin(r.session, days)] = 0.0
    found = selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved),
        HypothesisCatalogue(laws),
        selection_pipeline.DiagnosisOptions(),
        np.random.default_rng(0),
    )
    contradicted = [n for n in found.notes if "sessions differ" in n]
    if len(days) > 1:
        assert [f.effect for f in found.findings] == ["force_sensor_frame"]
        assert not contradicted
    else:
        assert not found.findings
        assert found.verdict == "unexplained"
        assert len(contradicted) == 1


def share(*, days_with_it: int, moved: bool) -> float:
    """Return the session transfer of a law fitted with a frame (a shift and a slope) that is the same on all days or
    differs from day to day (``moved``)."""
    rng = np.random.default_rng(3)
    rows = DAYS * VISITS * READINGS
    day = np.repeat(np.arange(DAYS), VISITS * READINGS)
    u = rng.normal(size=rows)
    law = (u + 0.5 * rng.normal(size=rows))[:, None]
    frame = np.column_stack([np.ones(rows), u])
    X = np.hstack([frame * (day == d)[:, None] for d in range(DAYS)]) if moved else frame
    y = 3.0 * law[:, 0] * (day < days_with_it) + 0.01 * rng.normal(size=rows)
    y -= X @ np.linalg.lstsq(X, y, rcond=None)[0]  # residual after a first fit of the frames
    whitening: Any = SimpleNamespace(
        session=np.repeat(np.arange(DAYS), VISITS),
        group_of_visit=np.tile(np.arange(VISITS), DAYS),
        visit_starts=np.arange(0, rows + 1, READINGS),
    )
    fold = np.tile(np.arange(VISITS), DAYS)
    of = np.repeat(fold, READINGS)
    base = build_whitened_model(
        whitening, X, y, fold, np.zeros(X.shape[1]), tuple(np.flatnonzero(of == f) for f in range(VISITS))
    )
    gain = base.rss - base.with_columns(law).rss
    scored: Any = SimpleNamespace(gain=gain, shape=0, whitened=SimpleNamespace(columns_at=lambda _: law))
    return compute_session_transfer(base, scored)


@pytest.mark.parametrize("moved", [False, True])
def test_effect_in_both_sessions_is_repeatable_after_a_tracker_move(moved: bool) -> None:
    """The tracker frame of each day is fitted to that day, with and without the law, because the other day has no
    information about it."""
    assert share(days_with_it=2, moved=moved) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("moved", [False, True])
def test_effect_in_one_session_only_is_not_named(moved: bool) -> None:
    assert share(days_with_it=1, moved=moved) < 0.4

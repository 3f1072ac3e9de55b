"""The verdict never contradicts the values: random results, and every document of the tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_diagnoses import explained, frame, hysteresis, link, recording, zero_offset

from machopt.cell.cell_reader import load_cell
from machopt.data_types.documents.diagnosis_document import DiagnosisDocument
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_record_finding
from machopt.measurement.diagnosis.outputs.diagnosis_document import build_diagnosis_document
from machopt.measurement.diagnosis.verdict.verdict_rules import apply_verdict_rules, find_contradictions

CELL = load_cell(Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling")
VERDICTS = ("consistent", "explained", "partly_explained", "unexplained")


def document(d: DiagnosisResult) -> DiagnosisDocument:
    return build_diagnosis_document(CELL, recording(), d)


def units() -> Finding:
    return build_record_finding("units", "column:dx_mm", "read as inches", 5.0, 0.2, 0.001)


def uncertain(f: Finding) -> Finding:
    """A finding whose parameters do not differ significantly from zero."""
    wide = {n: EstimatedValue(e.value, e.unit, (-9e9, 9e9), (-9e9, 9e9)) for n, e in f.parameters.items()}
    return replace(f, parameters=wide)


def small_gain(f: Finding) -> Finding:
    return replace(f, before=1.0001 * f.after)


NAMED = (hysteresis(), link(), zero_offset())
EVERY = (*NAMED, frame(), units(), uncertain(zero_offset()), small_gain(zero_offset()))
ERROR = st.floats(1e-3, 10.0)


@settings(max_examples=300, deadline=None)
@given(
    verdict=st.sampled_from(VERDICTS),
    chosen=st.sets(st.integers(0, len(EVERY) - 1), max_size=4),
    before=ERROR,
    after=ERROR,
    noise=st.one_of(st.just(float("nan")), ERROR),
    closed=st.floats(0.0, 1.0),
    left=st.floats(0.0, 1.0),
    repeats=st.booleans(),
)
def test_no_result_contradicts_itself(
    verdict: str,
    chosen: set[int],
    before: float,
    after: float,
    noise: float,
    closed: float,
    left: float,
    repeats: bool,
) -> None:
    findings = [EVERY[k] for k in sorted(chosen)]
    if verdict == "consistent":  # the search finds no effect of the arm then
        findings = [f for f in findings if f.record]
    d = replace(
        explained(),
        verdict=verdict,
        findings=tuple(findings),
        heldout_before=before,
        heldout_after=after,
        measured_noise=noise,
        explained=closed,
        repeatable_after=left,
        mismatch_p=0.001 if repeats else float("nan"),
    )
    judged = apply_verdict_rules(d)
    assert find_contradictions(document(judged)) == ()
    again = apply_verdict_rules(judged)
    assert (again.verdict, again.sentence) == (judged.verdict, judged.sentence)


def test_violated_rules_are_detected() -> None:
    """A document with an unjustified claim has a contradiction, for any claim."""
    right = replace(explained(), measured_noise=0.024, heldout_after=0.025, heldout_before=0.06, explained=0.8)
    right = apply_verdict_rules(right)
    assert right.verdict == "explained"
    assert find_contradictions(document(right)) == ()
    wrong = (
        replace(right, findings=(units(),)),
        replace(right, explained=0.3),
        replace(right, heldout_after=0.05),
        replace(right, measured_noise=float("nan")),
        replace(right, heldout_before=0.02),
        replace(right, verdict="partly_explained"),
        replace(right, verdict="consistent", sentence="Consistent: all is well"),
        replace(right, verdict="unexplained", sentence="Unexplained: nothing"),
        replace(right, findings=(uncertain(hysteresis()),)),
        replace(right, sentence="Not explained, though the record is put right"),
    )
    for d in wrong:
        assert find_contradictions(document(d)), d.verdict


@pytest.mark.parametrize("change", [uncertain, small_gain])
def test_unnamed_correction_is_written_but_not_listed(change) -> None:
    d = replace(
        explained(),
        findings=(hysteresis(), change(zero_offset())),
        heldout_before=0.06,
        heldout_after=0.025,
    )
    judged = apply_verdict_rules(replace(d, measured_noise=0.024))
    assert [f.effect for f in judged.findings] == ["joint_hysteresis"]
    (written,) = document(judged).unnamed_corrections
    assert written.of == "kinematics"
    assert isinstance(judged.unnamed[0].correction, KinematicCorrection)


@pytest.mark.parametrize(
    ("after", "noise", "named"), [(0.025, 0.024, True), (0.04, 0.024, False), (0.025, np.nan, False)]
)
def test_torque_over_the_angle_is_named_only_where_it_leaves_noise(after: float, noise: float, named: bool) -> None:
    """Any smooth error of joint 2 resembles a gravity compensator, whose rotation kinematics.yaml states."""
    slow = KinematicCorrection(
        "transmission_error",
        "joint:2",
        {"per_turn": [1.0], "cos_arcsec": [90.0], "sin_arcsec": [20.0], "range_deg": [-60.0, 40.0]},
    )
    spring = replace(zero_offset(), effect="gravity_compensator", location="joint:2", correction=slow)
    d = replace(explained(), findings=(hysteresis(), spring), heldout_before=0.06, heldout_after=after)
    judged = apply_verdict_rules(replace(d, measured_noise=noise))
    assert ("gravity_compensator" in {f.effect for f in judged.findings}) is named
    assert bool(judged.unnamed) is not named


def test_noise_of_the_residual_explains_nothing() -> None:
    d = replace(explained(), measured_noise=float("nan"), heldout_before=0.06, heldout_after=0.025)
    judged = apply_verdict_rules(d)
    assert judged.verdict == "partly_explained"
    assert document(judged).baseline.measured_noise is None
    assert np.isnan(judged.measured_noise)

"""Confidence intervals of findings, including the uncertainty of the law."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

import machopt
from machopt.effects.law_interfaces.law_parameters import DEFAULT_FORM_UNCERTAINTY
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantity
from machopt.measurement.diagnosis.model_selection.evaluation import finding_estimates

if TYPE_CHECKING:
    from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect
    from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "diagnosis_chain_benchmark"))
import generate_cases

LENGTH = EffectHypothesis(
    effect="geometry",  # an effect whose law adds no model uncertainty
    location="sensor:force",
    law="a vector",
    equation="",
    columns=lambda _: np.zeros((1, 1, 3)),
    quantities=lambda x, _: {},
    is_exact=True,
)


def test_unobservable_law_does_not_widen_the_interval_of_a_certain_one(tmp_path: Path) -> None:
    """A full matrix at the tool fits as well as an axially symmetric body; its interval was −131 … 131 µm/N at 0.04
    µm/N."""
    ((name, case, seed),) = generate_cases.chosen("dev", ["deflection/tool_compliance.9/medium"], False, 1)
    generate_cases.generate((name, case, seed, "dev", tmp_path, True))
    found = machopt.diagnose(tmp_path / name / "cell", tmp_path / name / "recording")
    finding = next(f for f in found.result.findings if f.effect == "tool_compliance")
    true = json.loads((tmp_path / f"{name}.truth.json").read_text(encoding="utf-8"))["effects"][0]["size"]["value"]
    low, high = finding.parameters["lateral_compliance"].ci95
    assert 0.0 < low < true < high < 3.0 * true


@pytest.mark.parametrize("across", [0.1, 0.2])
def test_interval_of_a_vector_length_accounts_for_noise_bias(across: float) -> None:
    """For a vector of length 1 and 300 noise draws, intervals above the true length are as rare as intervals below
    it."""
    rng, sigma = np.random.default_rng(1), np.array([0.05, across, across])
    law = replace(LENGTH, quantities=lambda x, _: {"length": Quantity(float(np.linalg.norm(x)), "N")})
    high = low = 0
    for x in np.array([1.0, 0.0, 0.0]) + sigma * rng.normal(size=(300, 3)):
        fitted = cast("WhitenedHypothesis", SimpleNamespace(hypothesis=law, shapes=((),), unit=np.ones((1, 3))))
        ends = finding_estimates._compute_quantity_intervals(fitted, 0, x, np.diag(sigma**2), 1e6)["length"][1]
        high, low = high + (ends[0] > 1.0), low + (ends[1] < 1.0)
    assert high <= 8  # 12 and 9 with the linearized interval
    assert low <= 8
    assert high + low >= 2  # an interval that always contains the true value is too wide


def test_sensor_error_interval_accounts_for_body_compliances(tmp_path: Path) -> None:
    """Offset of the force sensor in an arm with a compliant link: with joint springs alone the estimate was 16 % too
    large."""
    ((name, case, seed),) = generate_cases.chosen("dev", ["pair/force_sensor_offset+link_compliance.6"], False, 1, 441)
    generate_cases.generate((name, case, seed, "dev", tmp_path, False))
    found = machopt.diagnose(tmp_path / name / "cell", tmp_path / name / "recording")
    truth = json.loads((tmp_path / f"{name}.truth.json").read_text(encoding="utf-8"))["effects"]
    offset = next(e for e in truth if e["effect"] == "force_sensor_offset")["parameters"]["offset"]["value"]
    output = next(f for f in found.result.findings if f.effect == "force_sensor_offset").parameters["offset"]
    assert output.value == pytest.approx(offset, rel=0.06)
    assert output.ci95[0] < offset < output.ci95[1]


def _build_selected_effects(*effects: str) -> list[SelectedEffect]:
    return [
        cast("SelectedEffect", SimpleNamespace(whitened=SimpleNamespace(hypothesis=replace(LENGTH, effect=e))))
        for e in effects
    ]


def test_exact_law_has_the_certainty_of_the_laws_beside_it() -> None:
    """The residual of an approximate gear or body law biases an offset or frame that is fitted together with it;
    exact laws leave no residual."""
    assert (
        finding_estimates._compute_model_uncertainty(
            _build_selected_effects("force_sensor_offset", "displacement_frame"), 0
        )
        == 0.0
    )
    assert (
        finding_estimates._compute_model_uncertainty(
            _build_selected_effects("force_sensor_offset", "base_compliance"), 0
        )
        == DEFAULT_FORM_UNCERTAINTY
    )
    assert (
        finding_estimates._compute_model_uncertainty(
            _build_selected_effects("joint_hysteresis", "force_sensor_offset"), 0
        )
        == 0.0
    )
    x, sigma = np.array([1.0, 0.0, 0.0]), np.full(3, 0.01)
    law = replace(LENGTH, quantities=lambda x, _: {"length": Quantity(float(np.linalg.norm(x)), "N")})
    fitted = cast("WhitenedHypothesis", SimpleNamespace(hypothesis=law, shapes=((),), unit=np.ones((1, 3))))
    alone, additional = (
        np.ptp(finding_estimates._compute_quantity_intervals(fitted, 0, x, np.diag(sigma**2), 1e6, doubt)["length"][1])
        for doubt in (0.0, DEFAULT_FORM_UNCERTAINTY)
    )
    assert alone == pytest.approx(2 * 1.96 * 0.01, rel=1e-3)
    assert additional == pytest.approx(2 * 1.96 * np.hypot(0.01, DEFAULT_FORM_UNCERTAINTY), rel=1e-3)

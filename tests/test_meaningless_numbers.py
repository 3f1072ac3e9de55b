"""Uninformative numbers are not shown: rounding errors, and parameters with too wide intervals."""

from __future__ import annotations

from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import drop_meaningless_estimates


def estimate(value: float, low: float, high: float, unit: str = "%") -> EstimatedValue:
    return EstimatedValue(value, unit, (low, high), (low, high))


def test_undetermined_share_is_left_out() -> None:
    found = {"time_constant": estimate(30.0, 20.0, 45.0, "s"), "share": estimate(60.0, -20652.0, 12754.0)}
    assert list(drop_meaningless_estimates(found)) == ["time_constant"]


def test_rounding_error_is_zero_and_components_remain() -> None:
    found = {
        "mass": estimate(2.1, 1.9, 2.3, "kg"),
        "moment_x": estimate(1e-25, -0.02, 0.02, "kg·m"),
        "moment_y": estimate(0.4, 0.3, 0.5, "kg·m"),
    }
    out = drop_meaningless_estimates(found)
    assert list(out) == list(found)
    assert out["moment_x"].value == 0.0
    assert out["moment_y"].value == 0.4


def test_size_and_certain_numbers_remain() -> None:
    found = {"size": estimate(1e-3, -5.0, 5.0, "mm"), "turn": estimate(0.2, 0.1, 40.0, "mrad")}
    assert drop_meaningless_estimates(found) == found

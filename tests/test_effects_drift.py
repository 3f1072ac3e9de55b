"""Contract of every drift effect, and one added by one file and one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_load_test_drift import build_timed_readings

from machopt.effects import parameter_conversion, registry
from machopt.effects.protocol import DriftLaw, Effect, LawParameter, Quantity, ThermalState
from machopt.effects.structure.heat_courses import LinearTimeCourse
from machopt.effects.structure.thermal_drift import ThermalDrift
from machopt.measurement.diagnosis.effect_columns import thermal_drift
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.numerics.array_types import Array

LAWS = [
    pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.select_drift_effects() for law in e.drift_laws
]


def build_thermal_state(*, counted: bool = False) -> ThermalState:
    rng = np.random.default_rng(0)
    since = np.sort(rng.uniform(0.0, 4000.0, 7))
    before = since - 50.0 if counted else None
    return ThermalState(
        time_since_start=since,
        unloaded_time_since_start=before,
        temperature_rise=rng.uniform(0, 4, 7),
        casting_columns=rng.normal(size=(7, 6, 3)),
        stand_columns=rng.normal(size=(7, 6, 6)),
        is_relative=counted,
    )


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_law_has_one_column_per_reading_and_growing_size(effect: Effect, law: DriftLaw) -> None:
    for whole in (build_thermal_state(), build_thermal_state(counted=True)):
        for shape in (np.array(s) for s in law.grid(whole)):
            columns = law.columns(shape, whole)
            assert columns.shape == (7, 6, len(law.coefficients))
            # a linear drift is scaled by the longest session: the last reading must remain
            part = replace(
                whole,
                time_since_start=None if whole.time_since_start is None else whole.time_since_start[3:],
                unloaded_time_since_start=None
                if whole.unloaded_time_since_start is None
                else whole.unloaded_time_since_start[3:],
                temperature_rise=None if whole.temperature_rise is None else whole.temperature_rise[3:],
                casting_columns=whole.casting_columns[3:],
                stand_columns=whole.stand_columns[3:],
            )
            np.testing.assert_allclose(law.columns(shape, part), columns[3:], rtol=1e-14)
            values = 1e-5 * np.arange(1.0, len(law.coefficients) + 1.0)
            one, two = (next(iter(law.sizes(k * values, shape, whole).values())) for k in (1.0, 2.0))
            assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
            assert one.unit == "mm"
            assert parameter_conversion.write_law_parameters(law, values, shape)
    assert law.equation


def test_reference_reading_gives_the_difference() -> None:
    whole, apart = build_thermal_state(counted=True), build_thermal_state()
    assert whole.unloaded_time_since_start is not None
    earlier = replace(apart, time_since_start=whole.unloaded_time_since_start)
    for law in (law for e in registry.select_drift_effects() for law in e.drift_laws):
        for shape in (np.array(s) for s in law.grid(whole)):
            if law.shape:  # a linear drift is scaled by the longest of its own times
                difference = law.columns(shape, apart) - law.columns(shape, earlier)
                np.testing.assert_allclose(law.columns(shape, whole), difference, rtol=1e-9, atol=1e-12)


def test_unobservable_laws_are_not_offered() -> None:
    laws = [law for e in registry.select_drift_effects() for law in e.drift_laws]
    bare = replace(build_thermal_state(), time_since_start=None, temperature_rise=None)
    assert not any(law.grid(bare) for law in laws)
    short = replace(build_thermal_state(), time_since_start=np.linspace(0.0, 200.0, 7), temperature_rise=None)
    assert not any(law.grid(short) for law in laws)
    warm = replace(build_thermal_state(), time_since_start=None)
    assert {law.name for law in laws if law.grid(warm)} == {
        "the arm grows with the temperature",
        "links grow each by itself with the temperature",
        "the stand shifts and tilts with the temperature",
        "the stand shifts and tilts, and the arm grows with the temperature",
    }


class Sinks:
    """The floor sinks vertically."""

    words = "the floor sinks"
    penalty = 0.0

    def coefficients(self, least: float) -> tuple[LawParameter, ...]:
        return (LawParameter(key="sunk_m", unit="m"),)

    def patterns(self, seen: ThermalState) -> Array:
        return seen.stand_columns[:, :, 2:3]

    def is_testable(self, seen: ThermalState) -> bool:
        return True

    def estimate_temperature_rise(self, values: Array, course: Array) -> dict[str, Quantity]:
        return {}


def test_drift_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    toy = replace(
        registry.EFFECTS["thermal_drift"], name="floor", drift_laws=(ThermalDrift(Sinks(), LinearTimeCourse()),)
    )
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    r, *_ = build_timed_readings()
    (h,) = (h for h in thermal_drift.build_thermal_hypotheses(r) if h.effect == toy.name)
    assert h.name in {other.name for other in load_test_channel.build_load_test_catalogue(r, None).hypotheses}
    assert h.columns(()).shape == (len(r), r.dimensions, 1)
    assert h.quantities(np.array([1e-5]), ())["drift"].unit == "mm"

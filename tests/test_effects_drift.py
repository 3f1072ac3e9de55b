"""The contract of every law of what drifts, and one that is added by one file and one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_drift import timed

from machopt.arrays import Array
from machopt.diagnose.laws import at_heat
from machopt.diagnose.resting import deflection
from machopt.effects import files, registry
from machopt.effects.protocol import DriftLaw, Effect, Parameter, Quantity, Warming
from machopt.effects.thermal import Drift, Evenly

LAWS = [pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.of_drifts() for law in e.drifts]


def seen(*, counted: bool = False) -> Warming:
    rng = np.random.default_rng(0)
    since = np.sort(rng.uniform(0.0, 4000.0, 7))
    before = since - 50.0 if counted else None
    return Warming(
        since=since,
        before=before,
        rise=rng.uniform(0, 4, 7),
        castings=rng.normal(size=(7, 6, 3)),
        stand=rng.normal(size=(7, 6, 6)),
        counted=counted,
    )


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_a_law_counts_each_reading_by_itself_and_its_size_grows(effect: Effect, law: DriftLaw) -> None:
    for whole in (seen(), seen(counted=True)):
        for shape in (np.array(s) for s in law.grid(whole)):
            columns = law.columns(shape, whole)
            assert columns.shape == (7, 6, len(law.coefficients))
            # the longest session is what an even drift is per unit of: the last reading stays
            part = replace(
                whole,
                since=None if whole.since is None else whole.since[3:],
                before=None if whole.before is None else whole.before[3:],
                rise=None if whole.rise is None else whole.rise[3:],
                castings=whole.castings[3:],
                stand=whole.stand[3:],
            )
            np.testing.assert_allclose(law.columns(shape, part), columns[3:], rtol=1e-14)
            values = 1e-5 * np.arange(1.0, len(law.coefficients) + 1.0)
            one, two = (next(iter(law.sizes(k * values, shape, whole).values())) for k in (1.0, 2.0))
            assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
            assert one.unit == "mm"
            assert files.write(law, values, shape)
    assert law.equation


def test_a_reading_that_counts_from_another_shows_the_difference() -> None:
    whole, apart = seen(counted=True), seen()
    assert whole.before is not None
    earlier = replace(apart, since=whole.before)
    for law in (law for e in registry.of_drifts() for law in e.drifts):
        for shape in (np.array(s) for s in law.grid(whole)):
            if law.shape:  # an even drift is per the longest of its own times
                difference = law.columns(shape, apart) - law.columns(shape, earlier)
                np.testing.assert_allclose(law.columns(shape, whole), difference, rtol=1e-9, atol=1e-12)


def test_what_a_recording_cannot_show_is_not_offered() -> None:
    laws = [law for e in registry.of_drifts() for law in e.drifts]
    bare = replace(seen(), since=None, rise=None)
    assert not any(law.grid(bare) for law in laws)
    short = replace(seen(), since=np.linspace(0.0, 200.0, 7), rise=None)
    assert not any(law.grid(short) for law in laws)
    warm = replace(seen(), since=None)
    assert {law.name for law in laws if law.grid(warm)} == {
        "the arm grows with the temperature",
        "links grow each by itself with the temperature",
        "the stand shifts and tilts with the temperature",
        "the stand shifts and tilts, and the arm grows with the temperature",
    }


class Sinks:
    """The floor gives way straight down."""

    words = "the floor sinks"
    penalty = 0.0

    def coefficients(self, least: float) -> tuple[Parameter, ...]:
        return (Parameter(key="sunk_m", unit="m"),)

    def patterns(self, seen: Warming) -> Array:
        return seen.stand[:, :, 2:3]

    def shown(self, seen: Warming) -> bool:
        return True

    def warmed(self, values: Array, course: Array) -> dict[str, Quantity]:
        return {}


def test_one_file_and_one_line_add_a_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    toy = replace(registry.EFFECTS["thermal_drift"], name="floor", drifts=(Drift(Sinks(), Evenly()),))
    monkeypatch.setattr(registry, "EFFECTS", registry.registry((*registry.LISTED, toy)))
    r, *_ = timed()
    (h,) = (h for h in at_heat.hypotheses(r) if h.effect == toy.name)
    assert h.name in {other.name for other in deflection.catalogue(r, None).hypotheses}
    assert h.columns(()).shape == (len(r), r.dimensions, 1)
    assert h.quantities(np.array([1e-5]), ())["drift"].unit == "mm"

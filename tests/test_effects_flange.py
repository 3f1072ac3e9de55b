"""The contract of every law of what the tool side carries, in both channels that see it, and one that is added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from test_effects import ROOT, load_test

from machopt.arrays import Array
from machopt.diagnose.laws import at_flange
from machopt.diagnose.laws.motion_frame import Scene
from machopt.diagnose.nouns.readings import Readings
from machopt.effects import registry
from machopt.effects.payload import Heavier
from machopt.effects.protocol import Carried, CarriedLaw, Effect, Parameter, Quantity
from machopt.formats.cell import load_cell
from machopt.model.rigid import Dynamics, load_dynamics

LAWS = [pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.of_flange() for law in e.carries]


def seen(mass: float = 8.0) -> Carried:
    rng = np.random.default_rng(0)
    return Carried(mass, np.array([0.1, 0.0, 0.2]), np.array([0.0, 0.0, 0.1]), rng.normal(size=(5, 6, 4)))


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_sizes_grow_and_are_the_load_s(effect: Effect, law: CarriedLaw) -> None:
    whole = seen()
    columns, values = law.columns(whole), np.arange(1.0, len(law.coefficients) + 1.0)
    assert columns.shape == (5, 6, len(values))
    assert law.grid(whole) == ((),)
    one, two = (law.sizes(k * values, whole) for k in (1.0, 2.0))
    assert next(iter(two.values())).value == pytest.approx(2.0 * next(iter(one.values())).value)
    # what it says of mass and moments about the flange's origin is what acts
    said = {k: q.value for k, q in one.items()}
    mass, moment = said.get("mass", 0.0), np.array([said[f"moment_{a}"] for a in "xyz"])
    acting = whole.columns @ np.r_[mass, moment - mass * whole.about]
    np.testing.assert_allclose(columns @ values, acting, rtol=1e-12)
    assert law.equation
    assert effect.places == ("tool",)


def test_nothing_cannot_hang_elsewhere() -> None:
    laws = [law for e in registry.of_flange() for law in e.carries]
    assert [law.name for law in laws if not law.grid(seen(0.0))] == ["the stated mass at another place"]


def both() -> tuple[Readings, Scene, Dynamics]:
    """An arm at rest, as a load test's state and as a motion that stands still."""
    r, _ = load_test()
    dynamics = load_dynamics(load_cell(ROOT / "cells" / "kr240_drilling"))
    return r, cast("Scene", type("Still", (), {"dynamics": dynamics})), dynamics


def test_both_channels_see_one_load() -> None:
    """Weight through the springs, and what the joints' torques have to hold: J c (−τ)."""
    r, scene, dynamics = both()
    still = np.zeros_like(r.state.q)
    torque, _, _ = dynamics.regressors(r.state.q, still, still)
    resting, moving = at_flange.at_rest(r), at_flange.in_motion(scene, torque)
    assert {h.law for h in resting} == {h.law for h in moving}
    for one in resting:
        x = np.arange(1.0, one.columns(()).shape[2] + 1.0)
        two = next(h for h in moving if h.law == one.law)
        said = {k: q.value for k, q in one.quantities(x, ()).items()}
        # the same load in both: mass and first moments about the flange's origin
        load = np.array([said.get("mass", 0.0), *(said[f"moment_{a}"] for a in "xyz")])
        held = torque @ np.r_[load[0], load[1:] - load[0] * dynamics.tool_com]
        np.testing.assert_allclose(
            one.columns(()) @ x, -np.einsum("nci,ni->nc", r.state.J, r.compliance * held), rtol=1e-6, atol=1e-12
        )
        assert two.columns(()).shape == one.columns(()).shape


@dataclass(frozen=True)
class Water(Heavier):
    """A tank above the flange that fills: its centre is where the water stands."""

    name = "a tank that fills"
    coefficients = (Parameter(key="filled_kg", unit="kg"),)

    def columns(self, seen: Carried) -> Array:
        return np.asarray(seen.columns @ np.r_[1.0, np.array([0.0, 0.0, -0.3]) - seen.about][:, None])

    def sizes(self, values: Array, seen: Carried) -> Mapping[str, Quantity]:
        return {"filled": Quantity(float(values[0]), "kg")}


def test_one_file_and_one_line_add_a_load(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen in both channels."""
    toy = replace(registry.EFFECTS["payload"], name="tank", carries=(Water(),))
    monkeypatch.setattr(registry, "EFFECTS", registry.registry((*registry.LISTED, toy)))
    r, scene, dynamics = both()
    still = np.zeros_like(r.state.q)
    torque, _, _ = dynamics.regressors(r.state.q, still, still)
    for offered in (at_flange.at_rest(r), at_flange.in_motion(scene, torque)):
        (h,) = (h for h in offered if h.effect == toy.name)
        assert h.quantities(np.array([3.0]), ()) == {"filled": Quantity(3.0, "kg")}

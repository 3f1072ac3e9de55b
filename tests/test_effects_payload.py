"""Contract of every payload effect in both channels, and one added by one file and one line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from test_effects import ROOT, load_test

from machopt.cell.cell_reader import load_cell
from machopt.dynamics.rigid_body import RigidBodyDynamics, load_dynamics
from machopt.effects import registry
from machopt.effects.protocol import Effect, LawParameter, PayloadLaw, Quantity, ToolSideLoad
from machopt.effects.structure.payload import MassDeviation
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import payload
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel
from machopt.numerics.array_types import Array

LAWS = [
    pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.select_payload_effects() for law in e.payload_laws
]


def build_tool_side_load(mass: float = 8.0) -> ToolSideLoad:
    rng = np.random.default_rng(0)
    return ToolSideLoad(mass, np.array([0.1, 0.0, 0.2]), np.array([0.0, 0.0, 0.1]), rng.normal(size=(5, 6, 4)))


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_sizes_grow_and_equal_those_of_the_load(effect: Effect, law: PayloadLaw) -> None:
    whole = build_tool_side_load()
    columns, values = law.columns(whole), np.arange(1.0, len(law.coefficients) + 1.0)
    assert columns.shape == (5, 6, len(values))
    assert law.grid(whole) == ((),)
    one, two = (law.sizes(k * values, whole) for k in (1.0, 2.0))
    assert next(iter(two.values())).value == pytest.approx(2.0 * next(iter(one.values())).value)
    # the stated mass and moments about the flange origin give the acting load
    result = {k: q.value for k, q in one.items()}
    mass, moment = result.get("mass", 0.0), np.array([result[f"moment_{a}"] for a in "xyz"])
    acting = whole.columns @ np.r_[mass, moment - mass * whole.reference_point]
    np.testing.assert_allclose(columns @ values, acting, rtol=1e-12)
    assert law.equation
    assert effect.places == ("tool",)


def test_massless_payload_has_no_place() -> None:
    laws = [law for e in registry.select_payload_effects() for law in e.payload_laws]
    assert [law.name for law in laws if not law.grid(build_tool_side_load(0.0))] == ["the stated mass at another place"]


def build_both_channels() -> tuple[StaticReadings, MotionModel, RigidBodyDynamics]:
    """Return an arm at rest, as load test readings and as a motion with zero velocity."""
    r, _ = load_test()
    dynamics = load_dynamics(load_cell(ROOT / "cells" / "kr240_drilling"))
    return r, cast("MotionModel", type("Still", (), {"dynamics": dynamics})), dynamics


def test_load_tests_and_torques_show_the_same_payload() -> None:
    """The weight acts through the springs in one channel and as joint torque in the other: J c (−τ)."""
    r, scene, dynamics = build_both_channels()
    still = np.zeros_like(r.state.q)
    torque, _, _ = dynamics.compute_regressors(r.state.q, still, still)
    resting, moving = payload.build_static_payload_hypotheses(r), payload.build_motion_payload_hypotheses(scene, torque)
    assert {h.law for h in resting} == {h.law for h in moving}
    for one in resting:
        x = np.arange(1.0, one.columns(()).shape[2] + 1.0)
        two = next(h for h in moving if h.law == one.law)
        values = {k: q.value for k, q in one.quantities(x, ()).items()}
        # the same load in both channels: mass and first moments about the flange origin
        load = np.array([values.get("mass", 0.0), *(values[f"moment_{a}"] for a in "xyz")])
        fixed = torque @ np.r_[load[0], load[1:] - load[0] * dynamics.tool_com]
        np.testing.assert_allclose(
            one.columns(()) @ x, -np.einsum("nci,ni->nc", r.state.J, r.compliance * fixed), rtol=1e-6, atol=1e-12
        )
        assert two.columns(()).shape == one.columns(()).shape


@dataclass(frozen=True)
class Water(MassDeviation):
    """A tank above the flange that fills with water: the centre of mass is at the water."""

    name = "a tank that fills"
    coefficients = (LawParameter(key="filled_kg", unit="kg"),)

    def columns(self, seen: ToolSideLoad) -> Array:
        return np.asarray(seen.columns @ np.r_[1.0, np.array([0.0, 0.0, -0.3]) - seen.reference_point][:, None])

    def sizes(self, values: Array, seen: ToolSideLoad) -> Mapping[str, Quantity]:
        return {"filled": Quantity(float(values[0]), "kg")}


def test_payload_effect_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """The effect is offered in both channels."""
    toy = replace(registry.EFFECTS["payload"], name="tank", payload_laws=(Water(),))
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    r, scene, dynamics = build_both_channels()
    still = np.zeros_like(r.state.q)
    torque, _, _ = dynamics.compute_regressors(r.state.q, still, still)
    for offered in (payload.build_static_payload_hypotheses(r), payload.build_motion_payload_hypotheses(scene, torque)):
        (h,) = (h for h in offered if h.effect == toy.name)
        assert h.quantities(np.array([3.0]), ()) == {"filled": Quantity(3.0, "kg")}

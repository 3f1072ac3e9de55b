"""Contract of every friction effect, and one added by one file and one line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording

from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.effects.joint import friction
from machopt.effects.protocol import FrictionLaw, FrictionState, JointSpeedRange, LawParameter, Quantity
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.numerics.array_types import Array

LAWS = [pytest.param(law, id=law.name) for e in registry.select_friction_effects() for law in e.friction_laws]
PACES = (JointSpeedRange(1.5, True, (15.0, 60.0)), JointSpeedRange(1.5, False))


def build_friction_state(count: int = 400, *, slides: bool = False) -> FrictionState:
    t = np.arange(count) / 100.0
    v = 1.5 * np.sin(3.0 * t) + 0.2
    first = np.zeros(count, np.int64)
    first[0] = 1
    load = 100.0 + 50.0 * np.cos(t)
    return FrictionState(
        speed=v,
        friction_direction=np.sign(v),
        load=load,
        segment_start=first,
        time_step=0.01,
        warmth=lambda T: 1.0 - np.exp(-t / max(T, 1.0)),
        is_prismatic=slides,
    )


@pytest.mark.parametrize("law", LAWS)
def test_law_has_a_column_per_coefficient_and_growing_sizes(law: FrictionLaw) -> None:
    grids = [law.grid(pace) for pace in PACES]
    assert any(grids)
    whole = build_friction_state()
    for shape in (np.array(grid[-1]) for grid in grids if grid):
        assert len(shape) == len(law.shape)
        columns = law.columns(shape, whole)
        assert columns.shape == (400, len(law.coefficients))
        part = replace(build_friction_state(150), warmth=lambda T: whole.warmth(T)[:150])
        np.testing.assert_allclose(
            law.columns(shape, part), columns[:150], rtol=1e-14
        )  # later samples have no influence
        values = np.arange(1.0, len(law.coefficients) + 1.0)
        one, two = (next(iter(law.sizes(k * values, shape, whole).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
        assert (one.unit, next(iter(law.sizes(values, shape, build_friction_state(slides=True)).values())).unit) == (
            "N·m",
            "N",
        )
        assert law.note
        assert law.equation


def test_unobservable_laws_are_not_offered() -> None:
    bare, warmed = (
        {law.name for law in friction.EFFECT.friction_laws if law.grid(pace)} for pace in (PACES[1], PACES[0])
    )
    assert "load-dependent" in warmed - bare
    assert {"warms up", "Stribeck, load, direction, warmth"} <= warmed - bare
    assert bare - warmed == {"Stribeck, load, direction"}


@dataclass(frozen=True)
class Sticky(friction.CurvedViscousFriction):
    """A friction torque proportional to the cube of the velocity."""

    name = "churns"
    equation = "τ_f += d₃ q̇³"
    coefficients = (LawParameter(key="cube", unit="N·m·s³/rad³"),)

    def columns(self, shape: Array, seen: FrictionState) -> Array:
        return np.asarray(seen.speed**3)[:, None]

    def sizes(self, values: Array, shape: Array, seen: FrictionState) -> dict[str, Quantity]:
        return {"cube": Quantity(float(values[0]), "N·m·s³/rad³")}


def test_friction_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The effect is offered at every moving joint; its column is the law at the velocities of the motion."""
    toy = replace(friction.EFFECT, name="joint_churning", friction_laws=(Sticky(),))
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    cell = arm(tmp_path, 2, tool=5.0)
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(1))
    tau = load_dynamics(cell).compute_torque(q, v, a)
    _, catalogue, *_ = motion_channels.build_motion_problem(
        build_motion_recording(t, q, v, tau), cell, "torque", np.random.default_rng(0)
    )
    found = [h for h in catalogue.hypotheses if h.effect == toy.name]
    assert [h.location for h in found] == ["joint:1", "joint:2"]
    assert found[0].quantities(np.array([0.3]), ())["cube"].value == 0.3
    column = found[1].columns(())[:, :, 0]
    assert not column[:, 0].any()
    assert np.abs(column[:, 1]).max() > 0.0

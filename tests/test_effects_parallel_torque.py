"""Parallel joint torque added by one file and one line, in each channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording
from test_effects import load_test

from machopt.data_types.stiffness import StiffnessTerm
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.effects.protocol import LawParameter, Quantity, Shape
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.diagnosis.effect_columns import gravity_compensator
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class Hose:
    """A hose wound around joint 1: τ = −k q."""

    name = "hose"
    equation = "τ = −k q"
    penalty = 0.0
    word = ""
    has_memory = False
    coefficients = (LawParameter(key="rate_Nm_per_rad", unit="N·m/rad"),)
    shape: tuple[LawParameter, ...] = ()

    def torque(self, shape: Array, angle: Array) -> Array:
        return np.asarray(-angle[..., None])

    def slope(self, shape: Array, angle: Array) -> Array:
        return np.full((*np.shape(angle), 1), -1.0)

    def sizes(self, values: Array) -> Mapping[str, Quantity]:
        return {"rate": Quantity(float(values[0]), "N·m/rad")}

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


def test_parallel_spring_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    toy = replace(
        registry.EFFECTS["gravity_compensator"], name="hose", places=("joint:1",), parallel_torque_laws=(Hose(),)
    )
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    r, _ = load_test()
    ((poses,), (loads,)) = (
        [h for h in of(r) if h.effect == toy.name]
        for of in (gravity_compensator.build_pose_hypotheses, gravity_compensator.build_load_test_hypotheses)
    )
    assert poses.location == loads.location == "joint:1"
    bent = -r.compliance[0] * r.state.q[:, :1] * r.state.J[:, :, 0]
    np.testing.assert_allclose(poses.columns(())[:, :, 0], bent, rtol=1e-14, atol=1e-20)
    assert loads.correction(np.array([50.0]), ()) == StiffnessTerm(toy.name, "joint:1", {"rate_Nm_per_rad": 50.0})
    # a spring parallel to the gear: 1/(k + 1) instead of 1/k under load, and the levers at the deflected rest position
    rate, step, c = 1.0, 1e-4, r.compliance.copy()
    straight = c[0] * r.load_torque[:, 0]
    c[0] = 1.0 / (1.0 / c[0] + rate)
    bent_rest = r.robot.compute_state(r.state.q - step * bent_of(r), r.T_flange_tcp)
    stiffened = (c[0] * r.load_torque[:, 0] - straight)[:, None] * r.state.J[:, :, 0]
    A = [np.einsum("nci,i,nki,nk->nc", s.J, r.compliance, s.J, r.wrench) for s in (bent_rest, r.state)]
    levers = (A[0] - A[1]) / step
    np.testing.assert_allclose(loads.columns(())[:, :, 0], stiffened + levers, rtol=2e-3, atol=1e-12)

    cell = arm(tmp_path, 2, tool=5.0)
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(1))
    record = build_motion_recording(t, q, v, load_dynamics(cell).compute_torque(q, v, a))
    _, catalogue, *_ = motion_channels.build_motion_problem(record, cell, "torque", np.random.default_rng(0))
    (torque,) = (h for h in catalogue.hypotheses if h.effect == toy.name)
    assert np.abs(torque.columns(())[:, 0]).max() > 0.0
    assert not torque.columns(())[:, 1].any()


def bent_of(r: StaticReadings) -> Array:
    """Return the negative rotation (N, 6) in rad of joint 1 by the hose, per N·m/rad."""
    q = r.state.q
    out = np.zeros_like(q)
    out[:, 0] = r.compliance[0] * q[:, 0]
    return out

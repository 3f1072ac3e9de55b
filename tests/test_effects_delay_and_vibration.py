"""Contracts of delays and vibrations, and each added by one file and one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording

from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.effects.joint.joint_vibration import JointVibration
from machopt.effects.protocol import (
    COMPLIANCE,
    DelayedChannel,
    DelayLaw,
    Effect,
    LawParameter,
    Quantity,
    Shape,
    VibrationLaw,
    VibrationLoading,
)
from machopt.effects.recording.time_delay import ChannelDelay
from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.numerics.array_types import Array

LATE = [
    pytest.param(e, law, id=f"{e.name} {law.name}")
    for e in (*registry.select_channel_delay_effects(), *registry.select_command_delay_effects())
    for law in e.delay_laws
]
SWINGS = [
    pytest.param(e, law, id=f"{e.name} {law.name}")
    for e in registry.select_vibration_effects()
    for law in e.vibration_laws
]
RATE = 100.0  # Hz


def wave(late: float) -> Array:
    """Return the signals (N, 2) of a channel at 100 Hz, delayed by ``late`` s."""
    t = np.arange(200) / RATE - late
    return np.stack([np.sin(3.0 * t), np.cos(5.0 * t)], axis=1)


def build_delayed_channel(best: float) -> DelayedChannel:
    followed = (wave(0.004) - wave(0.0))[:, :, None]
    return DelayedChannel(
        compute_change=lambda d: wave(d) - wave(0.0),
        best_delay=best,
        tangent_step=0.25 / RATE,
        sign=1.0,
        following_columns=followed,
        delays=(0.004, 0.0, 0.004),
    )


@pytest.mark.parametrize(("effect", "law"), LATE)
def test_delayed_channel_equals_its_column_times_the_delay(effect: Effect, law: DelayLaw) -> None:
    for best in (4e-3, 0.0):
        whole = build_delayed_channel(best)
        for shape in (np.array(s) for s in law.grid(whole)):
            columns = law.columns(shape, whole)
            assert columns.shape == (200, 2, len(law.coefficients))
            one, two = (law.sizes(np.array([k * 4e-3]), shape, whole) for k in (1.0, 2.0))
            assert next(iter(two.values())).value == pytest.approx(2.0 * next(iter(one.values())).value)
            share = not len(shape)  # the coefficient is a share of the change that the encoders show, here all of it
            late = 4e-3 if best or share else 1e-4
            x = np.array([1.0 if share else late])
            exact = 1e-12 if (best and shape.any()) or share else 2e-2
            np.testing.assert_allclose(columns @ x, wave(late) - wave(0.0), rtol=0.0, atol=exact * 5.0 * late)
            result = law.to_file_parameters(x, whole)
            (value,) = result.values()
            assert 1e3 * late == pytest.approx(value[0] if isinstance(value, list) else value)
    assert effect.note
    assert law.equation


def test_channel_equal_to_its_command_has_no_lag() -> None:
    still = replace(build_delayed_channel(0.0), following_columns=None, delays=())
    offered = [law.name for e in registry.select_command_delay_effects() for law in e.delay_laws if law.grid(still)]
    assert offered == ["one delay of all joints"]


@pytest.mark.parametrize(("effect", "law"), SWINGS)
def test_spring_without_inertia_deflects_immediately(effect: Effect, law: VibrationLaw) -> None:
    load, n = 100.0 * np.sin(np.linspace(0.0, 6.0, 300)), 300
    first = np.zeros(n, np.int64)
    first[[0, 150]] = 1
    inertia = np.linspace(1.0, 2.0, n)
    whole = VibrationLoading(load, inertia, np.full(n, 1.0 / RATE), first)
    for shape in (np.array(s) for s in law.grid(RATE)):
        k, x = law.stiffness(shape, whole), law.deflection(shape, whole)
        assert x[0] == pytest.approx(load[0] / k, abs=1e-15)
        assert x[150] == pytest.approx(load[150] / k)
        # the stiffness of a shape refers to all samples; a single segment vibrates as within the whole
        same = replace(whole, inertia=inertia[::-1].copy())
        assert law.stiffness(shape, same) == pytest.approx(k)
        one, two = (law.sizes(c * 1e-6, shape, whole) for c in (1.0, 2.0))
        assert next(iter(two.values())).value == pytest.approx(2.0 * next(iter(one.values())).value)
    stiff = law.deflection(np.array([30.0, 0.9]), whole) * law.stiffness(np.array([30.0, 0.9]), whole)
    np.testing.assert_allclose(stiff, load, atol=5.0)  # N·m: a lag of half a step of 10 ms
    assert not law.grid(1.0)
    assert not law.grid(1.0, lambda s: 1.0)
    assert effect.note


def test_search_finds_a_peak_between_the_bands() -> None:
    """A peak narrower than the bands is found between them."""
    law = registry.select_vibration_effects()[0].vibration_laws[0]
    found = law.grid(200.0, lambda s: 1.0 / (1.0 + ((s[0] - 7.3) / 0.3) ** 2) - abs(s[1] - 0.045))
    assert found[-1] == pytest.approx((7.3, 0.045), rel=0.01)


# --- example effects ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stuttering(ChannelDelay):
    """A clock delay that acts where the channel changes, with twice the stated size."""

    name = "stutters"
    coefficients = (LawParameter(key="late_ms", unit="s", factor=1e-3),)

    def columns(self, shape: Array, seen: DelayedChannel) -> Array:
        return np.asarray(seen.sign * (seen.compute_change(seen.tangent_step) * 2.0 / seen.tangent_step)[:, :, None])

    def grid(self, seen: DelayedChannel) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class Limps(JointVibration):
    """A spring that vibrates at one fixed frequency, with its compliance as the coefficient."""

    name = "limps"
    coefficients = (LawParameter(key="limp", unit=COMPLIANCE, lower_limit=0.0),)

    def sizes(self, compliance: float, shape: Array, seen: VibrationLoading) -> Mapping[str, Quantity]:
        return {"limp": Quantity(compliance, COMPLIANCE)}

    def grid(self, rate: float, gain: Callable[[Shape], float] | None = None) -> tuple[Shape, ...]:
        return ((4.0, 0.05),)


def test_delay_and_vibration_are_added_by_one_file_and_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The effects are offered in every channel that has a clock or a spring."""
    clock = replace(registry.EFFECTS["time_skew"], name="stutter", delay_laws=(Stuttering(),))
    limp = replace(registry.EFFECTS["joint_elasticity"], name="limp", vibration_laws=(Limps(),))
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, clock, limp)))
    cell = arm(tmp_path, 2, tool=5.0)
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(1))
    tau = load_dynamics(cell).compute_torque(q, v, a)
    record = build_motion_recording(t, q, v, tau, q_secondary=q - tau / 1e6)
    for channel, sensors in (("torque", {"sensor:tau", "sensor:q"}), ("link", {"sensor:qse", "sensor:q"})):
        _, catalogue, *_ = motion_channels.build_motion_problem(record, cell, channel, np.random.default_rng(0))  # type: ignore[arg-type]
        offered = {h.location: h for h in catalogue.hypotheses if h.effect == clock.name}
        assert set(offered) == sensors
        result = offered["sensor:q"].correction(np.array([2e-3]), ())
        assert result == RecordCorrection(clock.name, "sensor:q", {"late_ms": 2.0})
        swinging = [h for h in catalogue.hypotheses if h.effect == limp.name]
        assert {h.location for h in swinging} == {"joint:1", "joint:2"}
        assert all(h.columns(h.shapes[0]).any() for h in swinging)

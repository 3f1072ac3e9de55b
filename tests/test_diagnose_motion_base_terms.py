"""Base terms of a motion are reported where significant; delays do not distort other effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording, diagnose_recording, shaken

from machopt.dynamics.rigid_body import load_dynamics
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.dynamic import joint_torque_channel, motion_channels, torque_delay
from machopt.measurement.diagnosis.statistics import outlier_rejection


@dataclass(frozen=True)
class Labelled:
    """The labels of a problem that identify replicates."""

    channel: str
    replicate: NDArray[np.int64]
    visit: NDArray[np.int64]

    @property
    def replicate_visit(self) -> NDArray[np.int64]:
        return self.visit

    def __len__(self) -> int:
        return len(self.visit)


def test_rotor_inertia_missing_in_the_urdf_is_reported_with_its_joint(tmp_path: Path) -> None:
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    a = np.gradient(v, t, axis=0)
    noise = rng.normal(size=q.shape)
    plain, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau + noise), cell, "torque")
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + noise + np.array([0.0, 4.0]) * a), cell, "torque"
    )
    assert (plain.verdict, found.verdict) == ("consistent", "consistent")
    assert "stated nowhere" not in plain.sentence
    assert "motor inertia" in found.sentence
    assert "(joint 2)" in found.sentence
    assert "(joint 1)" not in found.sentence
    assert any(n.startswith("refitted in any case") for n in found.notes)


def test_gradual_friction_reversal_is_reported(tmp_path: Path) -> None:
    """Smooth reversal over 0.08 rad/s at joint 1, as with viscous grease; samples every 10 ms, in which the velocity
    changes by about 0.01 rad/s."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    tau[:, 0] += 6.0 * (np.tanh(v[:, 0] / 0.08) - np.sign(v[:, 0]))
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + 0.5 * rng.normal(size=q.shape)), cell, "torque"
    )
    assert found.verdict == "consistent"
    assert "turns over gradually" in found.sentence
    assert "(joint 2)" not in found.sentence


@pytest.mark.parametrize("late", [0.0, 0.01])
def test_delay_is_used_only_where_significant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: float) -> None:
    """Some delay always fits slightly better than none by chance; used as a correction, it smoothed the friction
    reversals."""
    observed, clock = [], torque_delay.estimate_torque_delay
    monkeypatch.setattr(
        joint_torque_channel, "estimate_torque_delay", lambda *given: observed.append(clock(*given)) or observed[-1]
    )
    cell = arm(tmp_path, 1, tool=5.0)
    fine, qf, vf, af = build_fourier_motion(1, np.random.default_rng(4), rate=2000.0)
    tau = load_dynamics(cell).compute_torque(qf, vf, af) + 6.0 * np.sign(vf) + 2.0 * vf
    t, q, v, _ = build_fourier_motion(1, np.random.default_rng(4))
    moved = np.stack([np.interp(t - late, fine, x) for x in tau.T], axis=1)
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(size=q.shape)
        motion_channels.build_motion_problem(
            build_motion_recording(t, q, v, moved + noise), cell, "torque", np.random.default_rng(0)
        )
    assert [shared for _, shared, _ in observed] == [late > 0.0] * 6


def test_load_at_twice_its_detection_limit_is_named(tmp_path: Path) -> None:
    """Payload at the position of the tool. Link masses with an uncertainty of 5 % absorb much of it; earlier
    detection limits referred to any mass and moment, of which they absorb little."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 5)
    noise = 3.0 * rng.normal(size=q.shape)
    plain, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau + noise), cell, "torque")
    limit = next(x for x in plain.limits if x.effect == "payload")
    assert limit.unit == "kg"
    heavier = replace(cell, tool=replace(cell.tool, mass=cell.tool.mass + 2.0 * limit.value))
    a = np.gradient(v, t, axis=0)
    more = load_dynamics(heavier).compute_torque(q, v, a) - load_dynamics(cell).compute_torque(q, v, a)
    found, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau + more + noise), cell, "torque")
    assert [(f.effect, f.location) for f in found.findings] == [("payload", "tool")]
    mass = found.findings[0].parameters["mass"]
    assert mass.ci95[0] < 2.0 * limit.value < mass.ci95[1]


def test_torque_repeated_in_every_period_is_no_outlier(tmp_path: Path) -> None:
    """Delayed friction deviates in single samples around each reversal; removed as outliers, they hid delays and
    small backlash."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 5)
    problem, _, _, _ = motion_channels.build_motion_problem(
        build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), cell, "torque", rng
    )
    left = rng.normal(size=problem.y.shape)
    again = problem.replicate == problem.replicate[400]
    assert again.sum() == 5
    left[again, 1] += 30.0
    left[123, 1] += 30.0
    left[321, 1] -= 30.0
    used = outlier_rejection.find_inlier_readings(problem, left)
    assert used[again].all()
    assert np.flatnonzero(~used).tolist() == [123, 321]


@pytest.mark.parametrize("channel", ["torque", "position"])
def test_grouped_and_single_searches_find_the_same_repetitions(channel: str) -> None:
    """Vectorized search by groups; a separate pass over all samples for each deviating sample took seconds per
    iteration."""
    rng = np.random.default_rng(3)
    both, twinless = [0, 0], 0
    for _ in range(60):
        n = int(rng.integers(1, 60))
        replicate, visit = rng.integers(-1, 1 + n // 4, n), 7 * rng.integers(-2, 4, n)
        kinds = rng.normal(size=(n, 6))[replicate] * 10.0 ** rng.uniform(-1.0, 2.0)
        left = kinds + rng.normal(size=(n, 6)) * rng.choice([0.0, 0.3, 3.0], (n, 1))
        off = rng.random(n) < rng.choice([0.0, 0.2, 0.8])
        problem = Labelled(channel, replicate, visit)
        found = outlier_rejection.find_repeated_deviations(problem, left, off)  # type: ignore[arg-type]
        e = left if channel == "torque" else left[:, :3]
        for k in range(n):
            replicates = (replicate == replicate[k]) & (visit != visit[k])
            if not off[k] or replicate[k] < 0 or not replicates.any():
                assert not found[k]
                twinless += 1
                continue
            other = e[replicates].mean(axis=0)
            one, two = np.linalg.norm(e[k]), np.linalg.norm(other)
            again = (
                e[k] @ other > thresholds.SHARES.agreement * one * two and thresholds.RATIOS.stiffness_error * two > one
            )
            assert found[k] == again
            both[int(again)] += 1
    assert min(*both, twinless) > 50


def test_drive_gain_and_payload_are_reported_together(tmp_path: Path) -> None:
    """A drive torque at 50 % of its true value, and 6 kg more at the flange: neither alone explains the recording."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 5)
    a = np.gradient(v, t, axis=0)
    heavier = replace(cell, tool=replace(cell.tool, mass=11.0))
    tau = tau + load_dynamics(heavier).compute_torque(q, v, a) - load_dynamics(cell).compute_torque(q, v, a)
    tau[:, 1] *= 0.5
    found, _, _ = diagnose_recording(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), cell, "torque")
    values = {(f.effect, f.location): next(iter(f.parameters.values())) for f in found.findings}
    assert set(values) == {("payload", "tool"), ("units", "column:tau2_Nm")}
    assert values["payload", "tool"].value == pytest.approx(6.0, rel=0.05)
    assert values["units", "column:tau2_Nm"].value == pytest.approx(-50.0, rel=0.05)
    assert found.heldout_after < 1.05 * found.noise_floor


def test_speed_of_a_friction_peak_has_an_interval(tmp_path: Path) -> None:
    """The interval of a law with several shape parameters was computed on the grid only, and contained one grid
    point."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 6)
    tau[:, 1] += 6.0 * np.sign(v[:, 1]) * np.exp(-np.abs(v[:, 1]) / 0.07) + 0.02 * np.sign(v[:, 1]) * np.abs(tau[:, 1])
    found, _, _ = diagnose_recording(
        build_motion_recording(t, q, v, tau + 0.5 * rng.normal(size=q.shape)), cell, "torque"
    )
    speed = found.findings[0].parameters["stribeck_speed"]
    assert speed.ci95[0] < speed.value < speed.ci95[1]
    assert speed.ci95[0] < np.degrees(0.07) < speed.ci95[1]

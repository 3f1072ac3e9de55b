"""Geometric errors in measured poses: columns are compared with pinocchio; simulated errors are found and removed.

A simulated error is found at its joint. Its correction file removes the mismatch. Noise alone gives no finding.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_diagnose_tcp_poses import arm, measure, poses
from test_diagnose_tcp_poses import readings as readings_of

from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.effect_columns import as_built_joint_frames
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, skew_matrix
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

PLACES = ("base", *(f"joint:{j}" for j in range(1, 7)), "tool")
NOISE = 1e-5  # m
PLANTED = KinematicCorrection("geometry", "joint:3", {"xyz_mm": [0.1, 0.15, 0.0], "turn_mrad": [0.3, 0.0, 0.2]})


def compute_as_built_tcp(found: tuple[KinematicCorrection, ...], q: Array) -> Array:
    """Return the TCP poses (N, 4, 4) of the arm with geometric errors."""
    return np.asarray(
        UrdfKinematics(replace(arm()[0], kinematics=KinematicCorrections(found))).compute_configuration(q).tcp
    )


def angles() -> Array:
    return poses()[:60]


@cache
def laws() -> tuple[Array, tuple[EffectHypothesis, ...]]:
    """Return the base columns (N, 3, 9) of an unknown tracker frame and target, and the geometry hypotheses."""
    q = angles()
    r = replace(readings_of(arm()[2], np.zeros((len(q), 6)), q), dimensions=3)
    T = r.state.T_base_tool
    turned = -skew_matrix(T[:, :3, 3] - T[:, :3, 3].mean(axis=0))
    base = np.concatenate([np.broadcast_to(np.eye(3), (len(q), 3, 3)), turned, T[:, :3, :3]], axis=2)
    return base, tuple(as_built_joint_frames.build_geometry_hypotheses(r, base))


def gains(y: Array) -> dict[str, tuple[float, Array]]:
    """Return for each joint the decrease of the sum of squares in addition to the base (in units of the noise
    variance) and its coefficients."""
    base, offered = laws()
    out = {}
    for h in offered:
        A = np.concatenate([base, h.columns(())], axis=2).reshape(y.size, -1)
        x, left = (np.linalg.lstsq(M, y.reshape(-1), rcond=1e-12)[0] for M in (A, A[:, : base.shape[2]]))
        fall = np.sum((y.reshape(-1) - A[:, : base.shape[2]] @ left) ** 2) - np.sum((y.reshape(-1) - A @ x) ** 2)
        out[h.location] = float(fall) / NOISE**2, x[base.shape[2] :]
    return out


def compute_min_gain(h: EffectHypothesis) -> float:
    return thresholds.LEVELS.min_gain + thresholds.LEVELS.gain_two_sigma * (h.columns(()).shape[2] - 1)


@pytest.mark.parametrize("place", PLACES)
def test_columns_equal_finite_differences_of_the_as_built_arm(place: str) -> None:
    """Central differences over ±0.05 mm and ±0.05 mrad: the cubic truncation error of 1e-13 m and rounding are
    divided by 1e-4."""
    q = angles()[:5]
    columns = as_built_joint_frames.compute_frame_columns(readings_of(arm()[2], np.zeros((len(q), 6)), q), place)
    h = 0.05
    for k in range(6):
        one, two = (
            compute_as_built_tcp((KinematicCorrection("geometry", place, {"xyz_mm": t[:3], "turn_mrad": t[3:]}),), q)
            for t in (-h * np.eye(6)[k], h * np.eye(6)[k])
        )
        moved = (two - one)[:, :3, 3] / (2e-3 * h)
        turned = convert_to_rotation_vector(two[:, :3, :3] @ np.swapaxes(one[:, :3, :3], 1, 2)) / (2e-3 * h)
        np.testing.assert_allclose(columns[:, :3, k], moved, atol=1e-7)
        np.testing.assert_allclose(columns[:, 3:, k], turned, atol=1e-7)


def test_axis_twist_is_found_and_its_file_removes_the_mismatch() -> None:
    q, (base, offered) = angles(), laws()
    rng = np.random.default_rng(2)
    y = (compute_as_built_tcp((PLANTED,), q) - UrdfKinematics(arm()[0]).compute_configuration(q).tcp)[
        :, :3, 3
    ] + NOISE * rng.normal(size=(len(q), 3))
    found = gains(y)
    assert max(found, key=lambda place: found[place][0]) == "joint:3"
    h = next(h for h in offered if h.location == "joint:3")
    assert found["joint:3"][0] > compute_min_gain(h)
    correction = h.correction(found["joint:3"][1], ())
    assert isinstance(correction, KinematicCorrection)
    rest = (compute_as_built_tcp((PLANTED,), q) - compute_as_built_tcp((correction,), q))[
        :, :3, 3
    ]  # may contain at most what frame and target explain
    x = np.linalg.lstsq(base.reshape(rest.size, -1), rest.reshape(-1), rcond=1e-12)[0]
    assert np.sqrt(np.mean((rest - base @ x) ** 2)) < NOISE
    first = next(iter(h.quantities(found["joint:3"][1], ()).values()))
    double = next(iter(h.quantities(2.0 * found["joint:3"][1], ()).values()))
    assert double.value == pytest.approx(2.0 * first.value)  # detection limits are given in this quantity


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_found_in_noise(seed: int) -> None:
    found = gains(NOISE * np.random.default_rng(seed).normal(size=(len(angles()), 3)))
    assert all(found[h.location][0] < compute_min_gain(h) for h in laws()[1])


def test_only_geometry_independent_of_the_base_is_offered() -> None:
    base, offered = laws()
    # the tracker frame absorbs the geometry of joint 1
    assert {h.location for h in offered} == {f"joint:{j}" for j in range(2, 7)}
    Q = np.linalg.qr(base.reshape(-1, base.shape[2]))[0]
    for h in offered:
        A = h.columns(()).reshape(len(Q), -1)
        whole, left = (np.linalg.svd(M, compute_uv=False) for M in (A, A - Q @ (Q.T @ A)))
        assert left[-1] > thresholds.SHARES.negligible * thresholds.SHARES.negligible * whole[0]
    assert as_built_joint_frames.find_observable_directions(base[:, :, :6], base).shape[1] == 0
    r = readings_of(arm()[2], np.zeros((60, 6)), angles())
    fixed = replace(r, recording=measure(registration="fixed"))
    known = {
        h.location: h for h in as_built_joint_frames.build_geometry_hypotheses(fixed, base[:, :, :0].repeat(2, axis=1))
    }  # three coordinates fixed in base_link (D = 6, P = 0 base columns)
    assert set(known) == set(PLACES)
    # a tracker frame, which also moves all points together, is preferred to a displaced robot base
    assert {where for where, h in known.items() if h.penalty > 0.0} == {"base", "joint:1"}
    assert all(h.penalty == 0.0 for h in offered)

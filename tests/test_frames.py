"""Rigid fits, the tracker in the base, wrenches and twists at another point: exactness, noise, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from machopt.errors import InputError
from machopt.identify.frames import (
    displacement_of_targets,
    rigid_fit,
    rotate_wrench,
    transport_twist,
    transport_wrench,
)
from machopt.identify.registration import register_tracker
from machopt.se3 import (
    apply,
    axis_rotation,
    inverse,
    quaternion,
    quaternion_matrix,
    rotation_from_vector,
    rotation_vector,
    transform,
)

Array = np.ndarray
ROUND_OFF = 1e-12  # m, rad: double precision over a few metres
SEEDS = st.integers(0, 2**32 - 1)

PROPERTY = settings(max_examples=60, deadline=None)


def rotations(rng: np.random.Generator, n: int) -> Rotation:
    return Rotation.from_quat(rng.normal(size=(n, 4)))  # uniform


def poses(rng: np.random.Generator, n: int, reach: float = 1.5) -> Array:
    return transform(rotations(rng, n).as_matrix(), rng.uniform(-reach, reach, (n, 3)))


def tracker_data(rng: np.random.Generator, n: int, sigma: float) -> tuple[Array, Array, Array, Array]:
    """Tracker readings, flange poses, true T_base_tracker and true target in the flange."""
    T_base_flange = poses(rng, n)
    T_base_tracker = transform(rotations(rng, 1).as_matrix()[0], np.array([4.0, -2.0, 0.5]))
    target = np.array([0.12, -0.08, 0.25])
    seen = apply(inverse(T_base_tracker), T_base_flange[:, :3, :3] @ target + T_base_flange[:, :3, 3])
    return seen + rng.normal(scale=sigma, size=(n, 3)), T_base_flange, T_base_tracker, target


def error_twist(T: Array, T_true: Array) -> Array:
    """Twist at the origin of the fitted frame that leads from the true to the found transform."""
    return np.concatenate(
        [
            T[..., :3, 3] - T_true[..., :3, 3],
            rotation_vector(T[..., :3, :3] @ np.swapaxes(T_true[..., :3, :3], -1, -2)),
        ],
        axis=-1,
    )


def assert_covariance(samples: Array, covariance: Array) -> None:
    """Sample covariance of n draws against the stated one, in its own units.

    Whitened samples have covariance 1; an entry scatters by √(1/n) off and √(2/n) on the diagonal, so 5 √(2/n)
    is passed by chance less than once in a million.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    white = samples @ root.T
    found = white.T @ white / len(samples)
    assert np.abs(found - np.eye(len(found))).max() < 5 * np.sqrt(2 / len(samples))


# ---------------------------------------------------------------- rotations


@PROPERTY
@given(arrays(float, 3, elements=st.floats(-10, 10)))
def test_rotation_vector_and_back(v: Array) -> None:
    R = rotation_from_vector(v)
    assert np.allclose(R, Rotation.from_rotvec(v).as_matrix(), atol=ROUND_OFF)
    back = rotation_vector(R)
    assert np.linalg.norm(back) <= np.pi + ROUND_OFF
    assert np.allclose(rotation_from_vector(back), R, atol=ROUND_OFF)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-6, 1.0, np.pi - 1e-6, np.pi])
def test_rotation_vector_at_small_and_large_angles(angle: float) -> None:
    for axis in (np.array([0.0, 0.0, 1.0]), np.array([2.0, -1.0, 2.0]) / 3.0):
        found = rotation_vector(axis_rotation(axis, np.float64(angle)))
        assert min(np.abs(found - angle * axis).max(), np.abs(found + angle * axis).max()) < 1e-15 + 1e-15 * angle
        if angle < 3.0:
            assert np.allclose(found, angle * axis, rtol=1e-9, atol=1e-16)  # the sign too, and relative digits


@PROPERTY
@given(SEEDS)
def test_quaternion_agrees_with_scipy(seed: int) -> None:
    R = rotations(np.random.default_rng(seed), 20)
    mine, theirs = quaternion(R.as_matrix()), np.roll(R.as_quat(), 1, axis=1)
    assert np.allclose(np.abs(np.sum(mine * theirs, axis=1)), 1.0, atol=ROUND_OFF)
    assert np.allclose(quaternion_matrix(theirs), R.as_matrix(), atol=ROUND_OFF)


# ---------------------------------------------------------------- rigid fit


@PROPERTY
@given(SEEDS, st.integers(3, 8))
def test_rigid_fit_finds_the_transform(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    T, a = poses(rng, 5), rng.uniform(-0.3, 0.3, (5, n, 3))
    fit = rigid_fit(a, apply(T, a), rng.uniform(0.1, 3.0, n))
    assert np.abs(fit.residuals).max() < ROUND_OFF
    assert np.allclose(fit.T_b_a, T, atol=1e-9)  # a narrow triangle magnifies the round-off
    assert fit.rms.shape == fit.sigma.shape == (5,)


@PROPERTY
@given(SEEDS)
def test_rigid_fit_is_the_same_seen_from_another_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(6, 3))
    b = apply(poses(rng, 1)[0], a) + rng.normal(scale=1e-3, size=a.shape)
    P, Q = poses(rng, 2)
    here, there = rigid_fit(a, b), rigid_fit(apply(P, a), apply(Q, b))
    assert np.allclose(there.T_b_a, Q @ here.T_b_a @ inverse(P), atol=1e-10)
    assert there.rms == pytest.approx(here.rms, rel=1e-9)
    assert np.allclose(there.residuals, here.residuals @ Q[:3, :3].T, atol=1e-10)


def test_rigid_fit_never_reflects() -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(size=(200, 3, 3))  # three points are planar: a reflection would fit as well
    fit = rigid_fit(a, a + rng.normal(scale=0.2, size=a.shape))
    assert np.allclose(np.linalg.det(fit.T_b_a[..., :3, :3]), 1.0)
    solid = rng.normal(size=(6, 3))
    mirrored = rigid_fit(solid, solid * [1, 1, -1])
    assert np.linalg.det(mirrored.T_b_a[:3, :3]) == pytest.approx(1.0)
    assert mirrored.rms > 0.1  # and says that it does not fit


def test_rigid_fit_is_least_squares() -> None:
    rng = np.random.default_rng(2)
    a, w = rng.normal(size=(7, 3)), rng.uniform(0.2, 4.0, 7)
    b = apply(poses(rng, 1)[0], a) + rng.normal(scale=0.05, size=a.shape)
    fit = rigid_fit(a, b, w)

    def cost(T: Array) -> float:
        return float(np.sum(w[:, None] * (b - apply(T, a)) ** 2))

    for step in rng.normal(scale=1e-4, size=(50, 6)):
        assert cost(transform(rotation_from_vector(step[3:]), step[:3]) @ fit.T_b_a) > cost(fit.T_b_a)
    assert fit.rms == pytest.approx(np.sqrt(cost(fit.T_b_a) / w.sum()))
    assert fit.sigma == pytest.approx(np.sqrt(cost(fit.T_b_a) / (3 * 7 - 6)))


def test_rigid_fit_states_its_own_error() -> None:
    rng = np.random.default_rng(3)
    n, sigma = 4000, 2e-5
    w = np.array([1.0, 4.0, 1.0, 0.25, 2.0])
    a = rng.uniform(-0.2, 0.2, (5, 3)) + np.array([1.0, 0.3, 0.0])
    T = poses(rng, 1)[0]
    b = apply(T, a) + rng.normal(size=(n, 5, 3)) * (sigma / np.sqrt(w))[:, None]
    fit = rigid_fit(a, b, w)
    # mean of n draws of σ² with 9 degrees of freedom scatters by √(2/9n) = 0.7 %; four times that
    assert np.mean(fit.sigma**2) == pytest.approx(sigma**2, rel=0.03)
    assert_covariance(error_twist(fit.T_b_a, T), fit.covariance[0] * (sigma / fit.sigma[0]) ** 2)


@pytest.mark.parametrize(
    ("a", "b", "weights", "message"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], None, "found 2 points; a rigid transform needs three or more"),
        (np.outer(np.arange(4), [1, 2, 3]), np.eye(4)[:, :3], None, "points a lie on a line"),
        (np.eye(4)[:, :3], np.outer(np.arange(4), [1, 2, 3]), None, "points b lie on a line"),
        (np.ones((3, 3)), np.ones((3, 3)), None, "points a all coincide"),
        (np.eye(3), np.eye(4)[:, :3], None, r"shapes \(3, 3\) and \(4, 3\)"),
        (np.eye(3), np.full((3, 3), np.nan), None, "not finite; leave out targets"),
        (np.eye(3), np.eye(3), [1, 0, 1], "weight is not above zero"),
        (np.eye(3), np.eye(3), [1, 1], "do not broadcast"),
    ],
)
def test_rigid_fit_refuses(a: Array, b: Array, weights: list[float] | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rigid_fit(a, b, None if weights is None else np.array(weights, float))


def test_a_line_is_judged_by_its_width_and_named_in_a_batch() -> None:
    narrow = np.array([[0, 0, 0], [0.3, 0, 0], [0.15, 1e-4, 0]])
    wide = np.array([[0, 0, 0], [0.3, 0, 0], [0.15, 2e-2, 0]])
    rigid_fit(wide, wide)
    with pytest.raises(InputError, match=r"points a of set 2 lie on a line \(spread 0.0816 mm across 212 mm along\)"):
        rigid_fit(np.stack([wide, narrow]), np.stack([wide, wide]))


# ---------------------------------------------------------------- displacement of targets


@PROPERTY
@given(SEEDS, st.floats(1e-9, 1e-2))
def test_displacement_is_that_of_the_body(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    before = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.05], [0, 0, 0.2]]) + rng.normal(size=3)
    turn, shift, tcp = size * rng.normal(size=(9, 3)), size * rng.normal(size=(9, 3)), rng.normal(size=3)
    R = rotation_from_vector(turn)
    after = np.einsum("nij,kj->nki", R, before - tcp) + tcp + shift[:, None]
    found = displacement_of_targets(before, after, tcp, sigma=1e-5)
    assert np.allclose(found.displacement, shift, atol=ROUND_OFF)
    assert np.allclose(found.rotation, turn, atol=ROUND_OFF)
    assert found.rms.max() < ROUND_OFF


def test_displacement_states_its_own_error_far_from_the_targets() -> None:
    rng = np.random.default_rng(5)
    n, sigma = 5000, 1.5e-5
    body = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.05]]) + np.array([1.8, 0.2, 1.1])
    tcp = np.array([1.9, 0.2, 0.7])
    shift, turn = np.array([2e-4, -1e-4, -6e-4]), np.array([3e-4, 1e-4, -2e-4])
    moved = (body - tcp) @ rotation_from_vector(turn).T + tcp + shift
    before = body + rng.normal(scale=sigma, size=(n, 3, 3))
    after = moved + rng.normal(scale=sigma, size=(n, 3, 3))
    found = displacement_of_targets(before, after, tcp, sigma)
    error = np.concatenate([found.displacement - shift, found.rotation - turn], axis=1)
    assert_covariance(error, found.covariance.mean(axis=0))
    # the lever arm of 0.4 m makes the TCP worse than a target
    assert np.sqrt(found.covariance[0, 0, 0]) > 2 * sigma
    estimated = displacement_of_targets(before, after, tcp)
    # σ² from 3 n degrees of freedom scatters by √(2/3n) = 1.2 %; four times that, halved for σ
    assert estimated.sigma == pytest.approx(sigma, rel=0.025)
    assert np.allclose(estimated.covariance, found.covariance * (estimated.sigma / sigma) ** 2)


def test_displacement_refuses() -> None:
    targets = np.eye(3)
    with pytest.raises(InputError, match="sigma is 0"):
        displacement_of_targets(targets, targets, np.zeros(3), sigma=0)
    with pytest.raises(InputError, match="found 2 points"):
        displacement_of_targets(targets[:2], targets[:2], np.zeros(3))


# ---------------------------------------------------------------- tracker in the base


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(5, 30), st.sampled_from(["joint", "distances"]))
def test_registration_is_exact_without_noise(seed: int, n: int, method: str) -> None:
    seen, T_base_flange, T, target = tracker_data(np.random.default_rng(seed), n, 0.0)
    found = register_tracker(seen, T_base_flange, method=method)  # type: ignore[arg-type]
    # the distances stop where MINPACK's default tolerance of 1e-8 stops them, the refinement at round-off
    assert np.abs(found.residuals).max() < (1e-6 if method == "distances" else 1e-11)
    assert np.allclose(found.target_in_flange, target, atol=1e-5 if method == "distances" else 1e-9)
    assert np.allclose(found.T_base_tracker, T, atol=1e-5 if method == "distances" else 1e-9)


def test_registration_states_its_own_error() -> None:
    rng = np.random.default_rng(7)
    n, sigma = 400, 3e-5
    _, T_base_flange, T, target = tracker_data(rng, 12, 0.0)
    clean = apply(inverse(T), T_base_flange[:, :3, :3] @ target + T_base_flange[:, :3, 3])
    errors, sigmas, first_stage = [], [], []
    for _ in range(n):
        noisy = clean + rng.normal(scale=sigma, size=clean.shape)
        found = register_tracker(noisy, T_base_flange)
        errors.append(np.concatenate([error_twist(found.T_base_tracker, T), found.target_in_flange - target]))
        sigmas.append(found.sigma)
    for _ in range(60):
        noisy = clean + rng.normal(scale=sigma, size=clean.shape)
        found = register_tracker(noisy, T_base_flange, method="distances")
        first_stage.append(found.target_in_flange - target)
    stated = register_tracker(clean, T_base_flange, sigma=sigma)
    assert stated.sigma == sigma
    assert_covariance(np.array(errors), stated.covariance)
    # σ² of 27 degrees of freedom in n draws: √(2/27n) = 1.4 %; four times that
    assert np.mean(np.square(sigmas)) == pytest.approx(sigma**2, rel=0.055)
    # the refinement is no worse than the distances alone (60 draws: within 20 %)
    assert np.std(np.array(errors)[:, 6:]) < 1.2 * np.std(first_stage)


def test_registration_moves_with_the_tracker() -> None:
    rng = np.random.default_rng(8)
    seen, T_base_flange, _, _ = tracker_data(rng, 15, 1e-4)
    M = poses(rng, 1)[0]
    here, there = register_tracker(seen, T_base_flange), register_tracker(apply(M, seen), T_base_flange)
    assert np.allclose(there.T_base_tracker @ M, here.T_base_tracker, atol=1e-9)
    assert np.allclose(there.target_in_flange, here.target_in_flange, atol=1e-9)
    assert there.condition == pytest.approx(here.condition, rel=1e-6)
    assert here.rms == pytest.approx(np.sqrt(np.mean(np.sum(here.residuals**2, axis=1))))
    assert here.rms == pytest.approx(np.sqrt(3) * 1e-4, rel=0.4)


def test_a_wrong_pose_shows_in_its_residual() -> None:
    seen, T_base_flange, _, _ = tracker_data(np.random.default_rng(9), 20, 1e-5)
    seen[13] += [0.0, 0.005, 0.0]
    found = register_tracker(seen, T_base_flange)
    assert int(np.argmax(np.linalg.norm(found.residuals, axis=1))) == 13


def test_many_poses_take_no_more_pairs_than_useful() -> None:
    seen, T_base_flange, _, target = tracker_data(np.random.default_rng(10), 3000, 1e-4)
    found = register_tracker(seen, T_base_flange)
    assert np.abs(found.target_in_flange - target).max() < 5 * np.sqrt(found.covariance.diagonal()[6:].max())


def test_registration_refuses() -> None:
    rng = np.random.default_rng(11)
    seen, T, _, _ = tracker_data(rng, 12, 0.0)
    with pytest.raises(InputError, match="found 3 poses; registration needs four or more"):
        register_tracker(seen[:3], T[:3])
    with pytest.raises(InputError, match=r"found points \(12, 3\) and poses \(11, 4, 4\)"):
        register_tracker(seen, T[:11])
    with pytest.raises(InputError, match="not finite; leave that pose out"):
        register_tracker(np.where(np.arange(12)[:, None] == 4, np.nan, seen), T)
    one = transform(np.broadcast_to(T[0, :3, :3], (12, 3, 3)), T[:, :3, 3])
    with pytest.raises(InputError, match="all 12 poses have the same orientation"):
        register_tracker(seen, one)
    axis = np.array([0.6, 0.0, 0.8])
    about = transform(T[0, :3, :3] @ axis_rotation(axis, rng.uniform(-2, 2, 12)), T[:, :3, 3])
    with pytest.raises(
        InputError, match=r"about one axis, \((0.60, -?0.00, 0.80|-0.60, -?0.00, -0.80)\) in the flange"
    ):
        register_tracker(seen, about)
    with pytest.raises(InputError, match="target positions seen by the tracker lie on a line"):
        register_tracker(np.outer(np.arange(12), [0.1, 0.2, 0.3]), T)


# ---------------------------------------------------------------- wrenches and twists


@PROPERTY
@given(SEEDS)
def test_power_does_not_depend_on_the_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, S = poses(rng, 8), poses(rng, 8)
    wrench, twist = rng.normal(size=(8, 6)) * 100, rng.normal(size=(8, 6))
    power = np.sum(transport_wrench(wrench, T) * transport_twist(twist, T), axis=1)
    assert np.allclose(power, np.sum(wrench * twist, axis=1), atol=1e-9)  # 1e3 W
    for move, six in ((transport_wrench, wrench), (transport_twist, twist)):
        assert np.allclose(move(move(six, T), S), move(six, S @ T), atol=1e-9)
        assert np.allclose(move(move(six, T), inverse(T)), six, atol=1e-9)


def test_a_force_at_a_lever_makes_a_moment() -> None:
    """The sensor sits 0.4 m behind the TCP along z; 100 N along x at the TCP turns about y there."""
    T_tcp_sensor = transform(np.eye(3), np.array([0.0, 0.0, -0.4]))
    at_sensor = np.array([100.0, 0.0, 0.0, 0.0, 40.0, 0.0])  # r × f = (0, 0, 0.4) × (100, 0, 0)
    assert np.allclose(transport_wrench(at_sensor, T_tcp_sensor), [100.0, 0, 0, 0, 0, 0])
    assert np.allclose(rotate_wrench(at_sensor, T_tcp_sensor), at_sensor)  # the plain rotation keeps the moment
    spin = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert np.allclose(transport_twist(spin, T_tcp_sensor), [0.4, 0, 0, 0, 1, 0])  # ω × r = y × 0.4 z


def test_transport_is_the_shift_matrix_of_the_source() -> None:
    """tian2025, eq. 23: F6 = [[Rᵀ, 0], [−Rᵀ S(P), Rᵀ]] Fw with R, P the pose of frame 6 in frame w."""
    rng = np.random.default_rng(12)
    T_w_6 = poses(rng, 1)[0]
    R, (x, y, z) = T_w_6[:3, :3], T_w_6[:3, 3]
    S = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    shift = np.block([[R.T, np.zeros((3, 3))], [-R.T @ S, R.T]])
    wrench = rng.normal(size=6)
    assert np.allclose(transport_wrench(wrench, inverse(T_w_6)), shift @ wrench)


def test_shapes() -> None:
    T = transform(np.eye(3), np.zeros(3))
    assert transport_wrench(np.zeros((4, 5, 6)), T).shape == (4, 5, 6)
    assert transport_twist(np.zeros(6), np.broadcast_to(T, (7, 4, 4))).shape == (7, 6)
    with pytest.raises(InputError, match=r"expected \(..., 6\)"):
        transport_wrench(np.zeros(3), T)

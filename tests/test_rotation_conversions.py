"""Rotations as vectors, quaternions and matrices, compared with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from property_example_count import scale_example_count
from scipy.spatial.transform import Rotation

from machopt.numerics.rigid_transforms import (
    compute_axis_rotation,
    convert_quaternion_to_matrix,
    convert_to_quaternion,
    convert_to_rotation_vector,
    convert_vector_to_rotation,
)

Array = np.ndarray
ROUND_OFF = 1e-12  # m, rad: double precision over a few metres
SEEDS = st.integers(0, 2**32 - 1)

PROPERTY = settings(max_examples=scale_example_count(60), deadline=None)


def rotations(rng: np.random.Generator, n: int) -> Rotation:
    return Rotation.from_quat(rng.normal(size=(n, 4)))  # uniform


@PROPERTY
@given(arrays(float, 3, elements=st.floats(-10, 10)))
def test_rotation_vector_and_back(v: Array) -> None:
    R = convert_vector_to_rotation(v)
    assert np.allclose(R, Rotation.from_rotvec(v).as_matrix(), atol=ROUND_OFF)
    back = convert_to_rotation_vector(R)
    assert np.linalg.norm(back) <= np.pi + ROUND_OFF
    assert np.allclose(convert_vector_to_rotation(back), R, atol=ROUND_OFF)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-6, 1.0, np.pi - 1e-6, np.pi])
def test_rotation_vector_at_small_and_large_angles(angle: float) -> None:
    for axis in (np.array([0.0, 0.0, 1.0]), np.array([2.0, -1.0, 2.0]) / 3.0):
        found = convert_to_rotation_vector(compute_axis_rotation(axis, np.float64(angle)))
        assert min(np.abs(found - angle * axis).max(), np.abs(found + angle * axis).max()) < 1e-15 + 1e-15 * angle
        if angle < 3.0:
            assert np.allclose(found, angle * axis, rtol=1e-9, atol=1e-16)  # includes the sign; relative accuracy


@PROPERTY
@given(SEEDS)
def test_quaternion_agrees_with_scipy(seed: int) -> None:
    R = rotations(np.random.default_rng(seed), 20)
    mine, theirs = convert_to_quaternion(R.as_matrix()), np.roll(R.as_quat(), 1, axis=1)
    assert np.allclose(np.abs(np.sum(mine * theirs, axis=1)), 1.0, atol=ROUND_OFF)
    assert np.allclose(convert_quaternion_to_matrix(theirs), R.as_matrix(), atol=ROUND_OFF)

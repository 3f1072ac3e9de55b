"""Targets dense enough for the controller interpolation to follow the motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from sample_robot_programs import ARM, TOOL
from scipy.spatial.transform import Rotation, Slerp

from machopt.programs.writing.target_insertion import ProgramTolerance, insert_targets, measure_line_deviation

Array = np.ndarray
SAMPLES = 2001
WIDE = float(np.radians(30.0))  # an angle larger than all angles here


def build_smooth_joints(s: Array) -> Array:
    """Return smooth joint motions: the tool tip moves along a curve of about 0.6 m and rotates by about 70°."""
    start = np.radians([0, -80, 95, 20, 50, -30])
    way = np.radians([20, 6, -8, 25, -20, 60])
    wave = np.radians([0, 2, 3, 5, 4, 8])
    return start + s[:, None] * way + np.sin(2 * np.pi * s)[:, None] * wave


MOTION = ARM.compute_fk(build_smooth_joints(np.linspace(0, 1, SAMPLES)), TOOL)
FINER = ARM.compute_fk(build_smooth_joints(np.linspace(0, 1, 4 * (SAMPLES - 1) + 1)), TOOL)


def select_target_rows(ends: Array, tolerance: ProgramTolerance) -> Array:
    """Return the rows of MOTION that become targets."""
    added = insert_targets(MOTION, MOTION[ends], ends.astype(float), np.ones(len(ends), bool), tolerance)
    assert not set(added.tolist()) & set(ends.tolist())
    return np.sort(np.concatenate([ends, added]))


def compute_line_errors(targets: Array) -> tuple[float, float, float]:
    """Return the largest deviation of the finer motion from the lines: distance, tool axis, orientation.

    The slerp is that of another library.
    """
    worst = np.zeros(3)
    for a, b in pairwise(targets.tolist()):
        T0, T1, plan = MOTION[a], MOTION[b], FINER[4 * a : 4 * b + 1]
        share = np.linspace(0, 1, 801)
        line = (1 - share[:, None]) * T0[:3, 3] + share[:, None] * T1[:3, 3]
        turned = Slerp([0, 1], Rotation.from_matrix([T0[:3, :3], T1[:3, :3]]))(share).as_matrix()
        for T in plan:
            d = np.linalg.norm(line - T[:3, 3], axis=1)
            k = int(np.argmin(d))
            axis = np.arccos(np.clip(turned[k, :, 2] @ T[:3, 2], -1, 1))
            whole = 2 * np.arcsin(np.linalg.norm(turned[k] - T[:3, :3]) / np.sqrt(8))
            worst = np.maximum(worst, [d[k], axis, whole])
    return tuple(worst.tolist())


@pytest.mark.parametrize(
    "tolerance",
    [
        ProgramTolerance(2e-4, WIDE, WIDE),
        ProgramTolerance(1.0, np.radians(0.05), WIDE),
        ProgramTolerance(1.0, WIDE, np.radians(0.1)),
    ],
    ids=["place", "tool axis", "orientation"],
)
def test_controller_line_follows_the_motion(tolerance: ProgramTolerance) -> None:
    coarse = np.array([0, 700, 1400, SAMPLES - 1])
    limits = np.array([tolerance.position, tolerance.axis, tolerance.turn])
    assert (compute_line_errors(coarse) / limits).max() > 4  # otherwise the test has no effect
    rows = select_target_rows(coarse, tolerance)
    # checked between the samples, too; the 801 points of a line are initially up to 0.3 mm apart, 0.02° of rotation
    assert (np.array(compute_line_errors(rows)) <= limits + np.array([1e-6, np.radians(0.02), np.radians(0.02)])).all()
    assert 4 < len(rows) < 200
    off = measure_line_deviation(MOTION, MOTION[rows], rows.astype(float), np.ones(len(rows), bool))
    assert off.share(tolerance).max() <= 0.8  # the rest is a reserve for deviations between the samples
    assert off.worst() == pytest.approx(compute_line_errors(rows), rel=0.2, abs=2e-5)


def test_nothing_is_inserted_where_nothing_bends() -> None:
    """Only the last axis moves; it rotates about the flange axis, which is a uniform rotation without translation."""
    q = np.radians([0, -80, 95, 0, 50, 0]) + np.linspace(0, 1, 300)[:, None] ** 3 * np.radians([0, 0, 0, 0, 0, 40])
    T = ARM.compute_fk(q)
    ends = np.array([0.0, 120.5, 299.0])
    targets = ARM.compute_fk(np.array([q[0], (q[120] + q[121]) / 2, q[299]]))
    off = measure_line_deviation(T, targets, ends, np.ones(3, bool))
    assert off.worst() == pytest.approx((0, 0, 0), abs=1e-7)
    assert len(off.sample) == 299  # all except the first, which is not on a line
    assert not len(insert_targets(T, targets, ends, np.ones(3, bool), ProgramTolerance(1e-6, 1e-6, 1e-6)))


def test_joint_moves_are_not_lines() -> None:
    ends, linear = np.array([0.0, 1000.0, 2000.0]), np.array([False, False, True])
    off = measure_line_deviation(MOTION, MOTION[[0, 1000, 2000]], ends, linear)
    assert off.sample.min() == 1001
    assert set(off.move.tolist()) == {2}
    rows = insert_targets(MOTION, MOTION[[0, 1000, 2000]], ends, linear, ProgramTolerance(1e-4, WIDE, WIDE))
    assert rows.min() > 1000


def test_error_decreases_with_the_square_of_the_point_distance() -> None:
    ends = np.array([0, SAMPLES - 1])
    counts = [len(select_target_rows(ends, ProgramTolerance(t, WIDE, WIDE))) for t in (1e-3, 1e-4, 1e-5)]
    assert counts == sorted(counts)
    assert 2 < counts[1] / counts[0] < 5  # √10, as for chords of a curve
    assert 2 < counts[2] / counts[1] < 5


def test_lines_without_samples_between_targets_keep_their_error() -> None:
    """The targets are 1 mm away from the motion: no inserted sample reduces that error, and the search ends."""
    few = MOTION[::500]
    targets = few.copy()
    targets[:, 2, 3] += 1e-3
    at = np.arange(len(few)) + 0.5
    at[0] = 0.0
    rows = insert_targets(few, targets, at, np.ones(len(few), bool), ProgramTolerance(1e-5, WIDE, WIDE))
    assert rows.tolist() == [1, 2, 3, 4]


def test_uneven_external_axis_motion_becomes_targets() -> None:
    """A straight move of 1 m with a cosine motion of the rail: equal segments, as long as the curvature permits."""
    n = 2001
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = np.linspace(0.0, 1.0, n)
    rail = 0.3 * (1.0 - np.cos(np.pi * T[:, :1, 3]))
    ends, linear = np.array([0.0, n - 1.0]), np.ones(2, bool)
    assert len(insert_targets(T, T[[0, -1]], ends, linear, ProgramTolerance())) == 0
    added = insert_targets(T, T[[0, -1]], ends, linear, ProgramTolerance(), (rail, rail[[0, -1]]))
    rows = np.r_[0, added, n - 1]
    off = measure_line_deviation(T, T[rows], rows.astype(float), np.ones(len(rows), bool), None, (rail, rail[rows]))
    assert off.external.max() <= ProgramTolerance().external
    least = np.pi * np.sqrt(
        0.3 / (8 * ProgramTolerance().external)
    )  # number of chords of a curve with a sagitta of at most the tolerance
    assert 0.5 * least <= len(rows) <= 4 * least

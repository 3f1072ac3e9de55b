"""Corners of the commanded path between the samples of the motion, for dense, sparse and reversing points."""

from __future__ import annotations

import numpy as np
import pytest
from test_planning_path import toolpath

from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.verification.motion.path_geometry.motion_polyline import (
    CHORD_TOLERANCE_M,
    CommandedPath,
    MotionPolyline,
    build_motion_polyline,
)
from machopt.verification.tables.exported_tables import ExportedMotion


def build_line(points: Array, place: Array, index: Array) -> MotionPolyline:
    """Return the polyline of a motion without rotation.

    Args:
        points: (N, 3) m, of the toolpath.
        place: (S, 3) m, of the samples.
        index: (S,) toolpath index that the samples state.
    """
    n, samples = len(points), len(place)
    up = np.array([0.0, 0.0, 1.0])
    cut = toolpath([(tuple(point), tuple(up), MoveKind.CUT) for point in points.tolist()])
    motion = ExportedMotion(
        time=0.004 * np.arange(samples),
        point=index,
        move=np.full(samples, MoveKind.CUT, np.int64),
        q=np.zeros((samples, 6)),
        external=np.zeros((samples, 0)),
        operation=("op",) * samples,
        gamma=np.zeros(samples),
        feed=np.full(samples, 0.01),
    )
    tcp = np.zeros((samples, 3, 4))
    tcp[:, :, :3] = np.diag([1.0, -1.0, -1.0])
    tcp[:, :, 3] = place
    path = CommandedPath(
        toolpath=cut,
        index=np.arange(n, dtype=float),
        position=points,
        offset=np.zeros((samples, 3)),
        tilt=np.zeros((samples, 3)),
    )
    return build_motion_polyline(motion, tcp, motion.q, path)


@pytest.mark.parametrize("lag", [-14e-6, -7e-6, 0.0, 6e-6, 10e-6, 14e-6])
@pytest.mark.parametrize("spacing", [8e-6, 11e-6, 30e-6])
def test_dense_points_never_step_back_along_the_path(lag: float, spacing: float) -> None:
    """The samples state an index before or after their position, as where the motion rounds points."""
    rng = np.random.default_rng(4)
    way = spacing * np.arange(120)
    points = np.c_[way, 0.5 * way, rng.uniform(-4e-6, 4e-6, 120)]
    x = np.linspace(0.0, way[-1], 400)
    ahead = lag * np.clip(np.minimum(x, way[-1] - x) / 1e-4, 0.0, 1.0)  # the lag is zero at both ends of the path
    place = np.c_[x, 0.5 * x, np.zeros(400)]
    line = build_line(points, place, np.interp(x + ahead, way, np.arange(120.0)))
    assert (len(line.position) > 400) == (lag != 0.0)  # includes corners at which the noise exceeds that of a chord
    assert np.diff(line.position[:, 0]).min() > -CHORD_TOLERANCE_M


@pytest.mark.parametrize("degrees", [20.0, 90.0, 150.0, 180.0])
def test_corner_between_two_samples_is_a_vertex(degrees: float) -> None:
    turn = np.radians(degrees)
    corner = np.array([0.01, 0.0, 0.0])
    out = np.array([np.cos(turn), np.sin(turn), 0.0])
    points = np.array([[0.0, 0.0, 0.0], corner, corner + 0.01 * out])
    s = np.linspace(0.0, 0.02, 42)  # no sample at the corner
    place = np.where(s[:, None] < 0.01, s[:, None] * np.array([1.0, 0.0, 0.0]), corner + (s[:, None] - 0.01) * out)
    line = build_line(points, place, s / 0.01)
    assert np.linalg.norm(line.position - corner, axis=1).min() < 1e-9
    assert len(line.position) == 43


def test_both_corners_of_a_short_reversal_between_samples_keep_their_order() -> None:
    points = 1e-3 * np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [4.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    # mm along the path; the third and the fourth sample are at x = 4.9 and 4.5 mm
    way = np.array([0.0, 2.5, 4.9, 6.5, 7.5, 12.0])
    place = np.c_[1e-3 * np.interp(way, [0.0, 5.0, 6.0, 12.0], [0.0, 5.0, 4.0, 10.0]), np.zeros((6, 2))]
    line = build_line(points, place, np.interp(way, [0.0, 5.0, 6.0, 12.0], [0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(1e3 * line.position[:, 0], [0.0, 2.5, 4.9, 5.0, 4.0, 4.5, 5.5, 10.0], atol=1e-9)

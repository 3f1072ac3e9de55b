"""Way points so dense that the controller's own interpolation keeps to the plan."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest
from made_up_program import ARM, TOOL

from machopt.formats.posts.densify import Tolerance, densify

Array = np.ndarray


def fk(q: Array) -> Array:
    return ARM.fk(q, TOOL)


def bent(s: Array) -> Array:
    """Joints that turn smoothly: the tool tip draws a curve about 0.6 m long and turns by about 70°."""
    s = np.asarray(s, float)
    start = np.radians([0, -80, 95, 20, 50, -30])
    way = np.radians([20, 6, -8, 25, -20, 60])
    wave = np.radians([0, 2, 3, 5, 4, 8])
    return start + s[:, None] * way + np.sin(2 * np.pi * s)[:, None] * wave


def slerp(T0: Array, T1: Array, share: Array) -> Array:
    """What LIN does, by another library: a straight line, and an even turn."""
    from scipy.spatial.transform import Rotation, Slerp

    out = np.tile(np.eye(4), (len(share), 1, 1))
    out[:, :3, :3] = Slerp([0, 1], Rotation.from_matrix([T0[:3, :3], T1[:3, :3]]))(share).as_matrix()
    out[:, :3, 3] = (1 - share[:, None]) * T0[:3, 3] + share[:, None] * T1[:3, 3]
    return out


def worst(q_of_s: Callable[[Array], Array], s: Array, how: Literal["lin", "joint"]) -> tuple[float, float]:
    """Largest distance of the plan from the controller's lines, and largest angle, probed far more densely."""
    gap = angle = 0.0
    for a, b in pairwise(s.tolist()):
        plan = fk(q_of_s(np.linspace(a, b, 41)))
        if how == "lin":
            ends = fk(q_of_s(np.array([a, b])))
            line = slerp(ends[0], ends[1], np.linspace(0, 1, 401))
        else:
            q = q_of_s(np.array([a, b]))
            line = fk(q[0] + np.linspace(0, 1, 401)[:, None] * (q[1] - q[0]))
        for T in plan:
            d = np.linalg.norm(line[:, :3, 3] - T[:3, 3], axis=1)
            k = int(np.argmin(d))
            gap = max(gap, float(d[k]))
            angle = max(angle, float(2 * np.arcsin(np.linalg.norm(line[k, :3, :3] - T[:3, :3]) / np.sqrt(8))))
    return gap, angle


@pytest.mark.parametrize("how", ["lin", "joint"])
def test_the_controllers_line_keeps_to_the_plan(how: Literal["lin", "joint"]) -> None:
    tolerance = Tolerance(position=2e-4, angle=np.radians(0.3))
    coarse = np.linspace(0, 1, 4)
    before = worst(bent, coarse, how)
    assert before[0] > 5 * tolerance.position  # otherwise the test shows nothing
    done = densify(bent, coarse, fk, tolerance, how)
    gap, angle = worst(bent, done.s, how)
    # the probe line has 401 places, at most 0.1 mm apart: half of that across is negligible, along the angle 0.01°
    assert gap <= tolerance.position
    assert angle <= tolerance.angle + np.radians(0.02)
    assert done.complete
    assert done.position_error <= tolerance.position
    assert set(coarse) <= set(done.s)
    assert (~done.added).sum() == len(coarse)
    assert 4 < len(done.s) < 200


def test_nothing_is_added_where_nothing_bends() -> None:
    q = np.radians([[0, -80, 95, 0, 50, 0], [0, -80, 95, 0, 50, 40]])

    def turning(s: Array) -> Array:  # the last axis only, which turns about the flange's own axis
        return q[0] + np.asarray(s)[:, None] * (q[1] - q[0])

    def flange(x: Array) -> Array:
        return ARM.fk(x)

    done = densify(turning, np.array([0.0, 0.5, 1.0]), flange)
    assert not done.added.any()
    assert done.angle_error < 1e-7
    joint = densify(bent, np.linspace(0, 1, 50), fk, Tolerance(1.0, 3.0))
    assert not joint.added.any()


def test_finer_tolerances_need_more_points_and_error_falls_with_the_square() -> None:
    counts = [len(densify(bent, np.array([0.0, 1.0]), fk, Tolerance(t, 1.0)).s) for t in (1e-3, 1e-4, 1e-5)]
    assert counts == sorted(counts)
    assert 2 < counts[1] / counts[0] < 5  # √10, as chords of a curve do
    assert 2 < counts[2] / counts[1] < 5


def test_a_tolerance_that_cannot_be_had_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("machopt.formats.posts.densify.MOST_HALVINGS", 3)
    done = densify(bent, np.array([0.0, 1.0]), fk, Tolerance(1e-9, 1.0))
    assert not done.complete
    assert len(done.s) == 9  # 2³ stretches
    assert done.position_error > 1e-9
    with pytest.raises(ValueError, match="must rise"):
        densify(bent, np.array([0.0, 0.0, 1.0]), fk)

"""Abrupt rotation changes on short paths are spread."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.planning.pipeline import rotation_spreading
from machopt.planning.pipeline.rotation_spreading import (
    compute_moving_average,
    find_abrupt_runs,
    spread_rotation_steps,
)

STEP = np.radians(5.0)
LIMITS: Any = SimpleNamespace(velocity=np.full(7, 2.0), acceleration=np.full(7, 8.0), jerk=np.full(7, 80.0))


@pytest.mark.parametrize("width", [0.05, 0.4, 3.0])
def test_moving_average_equals_a_fine_sum(width: float) -> None:
    rng = np.random.default_rng(3)
    time = np.sort(np.r_[0.0, rng.uniform(0.0, 1.3, 12), 1.3, 0.7, 0.7])  # a discontinuity at 0.7 s
    values = rng.uniform(-1.0, 1.0, len(time))
    fine = (np.arange(40_000) + 0.5) / 40_000 - 0.5
    expected = [np.interp(t + width * fine, time, values).mean() for t in time]
    np.testing.assert_allclose(compute_moving_average(time, values, width), expected, atol=1e-3)


def make_job(seconds: float) -> tuple[Any, Any]:
    """Return a path of one run of 30 points and its joints; the rotation has a step into the last point."""
    time = np.r_[np.linspace(0.0, 2.0, 29), 2.0 + seconds]
    phi = np.r_[np.zeros(29), STEP]
    path = SimpleNamespace(runs=((0, 29),), time=time, plunge=np.zeros(30, bool))
    q = np.zeros((30, 6))
    q[:, 5] = phi
    return path, SimpleNamespace(phi=phi, q=q, reason=np.full(30, InfeasibilityReason.OK))


@pytest.mark.parametrize(("seconds", "runs"), [(0.0, [(0, 29)]), (0.007, [(0, 29)]), (0.1, [(0, 29)]), (1.0, [])])
def test_step_is_abrupt_where_axes_cannot_start_and_stop_in_time(seconds: float, runs: list[tuple[int, int]]) -> None:
    path, assignment = make_job(seconds)
    assert find_abrupt_runs(path, assignment, LIMITS, 0.97, 0.5 * STEP) == runs
    assert not find_abrupt_runs(path, assignment, LIMITS, 0.97, 1.5 * STEP)


@pytest.mark.parametrize(
    ("better", "is_free", "options", "is_spread"),
    [
        (0.0, True, {}, True),
        (0.1, True, {}, False),  # J increases
        (0.0, False, {}, False),  # a contact
        (0.0, True, {"fixed": ("a rotation",)}, False),
    ],
)
def test_step_is_spread_unless_worse_or_colliding(
    better: float, is_free: bool, options: dict[str, Any], is_spread: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, assignment = make_job(0.007)
    monkeypatch.setattr(
        rotation_spreading, "solve_joint_path", lambda *a: SimpleNamespace(phi=a[3], q=a[4], reason=assignment.reason)
    )
    checker = SimpleNamespace(arm=None, robot=None, whole=lambda phi, q: SimpleNamespace(free=is_free))
    search: Any = SimpleNamespace(
        path=path,
        checker=checker,
        candidates=SimpleNamespace(phi=np.arange(0.0, 2 * np.pi, STEP)),
        options=SimpleNamespace(**{"fixed": (), "steer": (), "limit_scale": 0.97, **options}),
    )
    monkeypatch.setattr(rotation_spreading, "replace", lambda old, **new: SimpleNamespace(**{**vars(old), **new}))
    found: Any = SimpleNamespace(assignment=assignment, check=SimpleNamespace(free=True), source="grid")
    out = spread_rotation_steps(search, found, LIMITS, lambda a: 1.0 + better * (a is not assignment))
    assert (out is not found) == is_spread
    if is_spread:
        assert out.source == "smooth and grid"
        rate = np.abs(np.diff(out.assignment.phi) / np.diff(path.time)).max()
        assert rate <= STEP / rotation_spreading.WIDTHS[0] * (1 + 1e-9)
        assert not find_abrupt_runs(path, out.assignment, LIMITS, 0.97, 0.5 * STEP)

"""What pulls at a joint from an angle on is said with its place, and is no gear's ripple; that keeps its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from test_diagnose_motion import diagnosed, recorded, shaken

from machopt.arrays import Array
from machopt.diagnose.nouns.result import Diagnosis


def left_open(tmp_path: Path, added: Callable[[Array], Array], seed: int) -> Diagnosis:
    """A sound arm of two joints whose first motor gives ``added`` of its angle more, diagnosed."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, seed)
    tau[:, 0] += added(q[:, 0])
    return diagnosed(recorded(t, q, v, tau + 0.5 * rng.normal(size=q.shape)), cell, "torque")[0]


def test_a_hose_that_tightens_is_no_ripple_of_a_gear(tmp_path: Path) -> None:
    """Slack within a third of a radian, then tauter and tauter: two slow waves are near enough and took its place."""
    found = left_open(tmp_path, lambda q: 60.0 * np.sign(q) * np.maximum(np.abs(q) - 0.15, 0.0) ** 1.7, 7)
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "joint:1" in n and "a hose or a cable" in n]


def test_a_ripple_of_two_orders_keeps_its_name(tmp_path: Path) -> None:
    found = left_open(tmp_path, lambda q: 3.0 * np.sin(24.0 * q) + 1.5 * np.cos(57.0 * q), 8)
    assert [(f.effect, f.location) for f in found.findings] == [("transmission_error", "joint:1")]
    assert found.verdict == "explained"

"""Arms with a massless last link."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording, diagnose_recording

from machopt.dynamics.rigid_body import load_dynamics


@pytest.mark.parametrize("tool", [0.0, 5.0])
def test_massless_last_link_causes_no_vibration_and_no_error(tmp_path: Path, tool: float) -> None:
    """A flange link without inertia in the URDF, with and without tool, caused a division by zero."""
    rng = np.random.default_rng(3)
    cell = arm(tmp_path, 3, tool=tool)
    head, last = cell.urdf.read_text(encoding="utf-8").rsplit("<inertial>", 1)
    bare = last.replace('mass value="20.0"', 'mass value="0"').replace('"1.5"', '"0"')
    cell.urdf.write_text(f"{head}<inertial>{bare}", encoding="utf-8")
    t, q, v, a = build_fourier_motion(3, rng, periods=5)
    dynamics = load_dynamics(cell)
    assert (dynamics.compute_own_inertia(q)[:, 2].max() > 0.0) == (tool > 0.0)
    tau = dynamics.compute_torque(q, v, a) + 6.0 * np.sign(v) + 2.0 * v
    found, *_ = diagnose_recording(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), cell, "torque")
    assert found.verdict == "consistent"
    link = q + 1e-6 * (dynamics.compute_torque(q, v, a) + rng.normal(size=q.shape))
    assert diagnose_recording(build_motion_recording(t, q, v, tau, q_secondary=link), cell, "link")[0].verdict in (
        "consistent",
        "explained",
    )

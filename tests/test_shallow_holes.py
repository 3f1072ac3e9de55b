"""Programs of shallow holes: the motion passes a joint target twice while the joints hardly move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.cli import main
from machopt.verification.programs.ordered_matching import match_targets_in_order

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("depth", [0.03, 0.1, 0.2, 0.25])
@pytest.mark.parametrize("short", [0.0, 1e-5, 5e-5])
def test_joint_target_is_matched_at_its_first_arrival(depth: float, short: float) -> None:
    """``depth`` is in deg of joint motion; the sample of the first arrival is ``short`` rad away from the target."""
    far, there, bottom = np.zeros(6), np.full(6, 0.5), np.full(6, 0.5) + np.radians(depth)
    first = there - short
    parts = [np.linspace(a, b, 20) for a, b in ((far, first), (first, bottom), (bottom, there), (there, far))]
    joints = np.concatenate(parts)
    place = joints[:, :3] * 0.8  # m, any function of the joints
    turn = np.broadcast_to(np.eye(3), (len(joints), 3, 3)).copy()
    wanted = np.array([there, bottom, there, far])
    at, _ = match_targets_in_order(
        place,
        turn,
        joints,
        wanted[:, :3] * 0.8,
        np.broadcast_to(np.eye(3), (4, 3, 3)).copy(),
        wanted,
        np.ones(4, bool),
        np.array([[5e-5, np.radians(0.3)], [2.5e-4, np.radians(0.3)]]),
        0.05,
        1e-4,
        25,
        np.zeros(4, bool),
    )
    assert np.isfinite(at).all()
    assert at[0] == pytest.approx(19.5, abs=2.5)  # a target between the samples is a little farther away
    assert at[1] == pytest.approx(39.5, abs=1.1)
    assert at[2] == pytest.approx(59.5, abs=1.1)


@pytest.mark.parametrize(
    ("cell", "depth_mm"), [("kr500_milling", 1.0), ("kr500_milling", 8.0), ("kr240_drilling", 3.0)]
)
def test_inclined_shallow_holes_pass_their_verification(cell: str, depth_mm: float, tmp_path: Path) -> None:
    axis = np.array([0.42, 0.11, 0.9])
    axis /= np.linalg.norm(axis)
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for hole in range(4):
        bottom = np.array([-60.0 + 40.0 * hole, 20.0 * (hole % 2), 250.0])
        steps = ((depth_mm + 40.0, "rapid,"), (5.0, "rapid,"), (0.0, "cut,400"), (5.0, "retract,2000"))
        for height, words in (*steps, (depth_mm + 40.0, "rapid,")):
            point = ",".join(f"{v:.5f}" for v in (*(bottom + height * axis), *axis))
            rows.append(f"{point},{words}")
    table = tmp_path / "holes.csv"
    table.write_text("\n".join(rows) + "\n", encoding="utf-8")
    words = ["optimize", str(ROOT / "cells" / cell), str(table), "-o", str(tmp_path / "out"), "--quiet"]
    assert main([*words, "--set", "rotation_step_deg=15"]) in (0, None)

"""Rigid-body torques of URDFs in other forms, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell, urdf_text
from test_mimic_joints import MASS

from machopt.data_types.cell import Cell
from machopt.dynamics.rigid_body import MissingInertiaError, load_dynamics
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot


def massive(folder: Path, text: str = "", **changes: object) -> Cell:
    folder.mkdir()
    cell = small_cell(folder, **changes)
    text = text or urdf_text()
    for n in range(1, 7):
        text = text.replace(f'<link name="link_{n}">', f'<link name="link_{n}">{MASS}')
    cell.urdf.write_text(text)
    return cell


@pytest.mark.parametrize("limit", ["", '<limit velocity="2" effort="1000"/>'])
def test_continuous_joint_has_an_angle(limit: str, tmp_path: Path) -> None:
    """pinocchio represents it by cosine and sine; its range is then defined by the cell alone."""
    plain = massive(tmp_path / "plain")
    head, last = urdf_text().rsplit('type="revolute"', 1)
    before, after = last.split("<limit", 1)
    endless = massive(tmp_path / "endless", f'{head}type="continuous"{before}{limit}{after.partition("/>")[2]}')
    assert "continuous" in endless.urdf_text
    rng = np.random.default_rng(0)
    q, v, a = rng.uniform(-1.0, 1.0, (3, 5, 6))
    one, other = load_dynamics(plain), load_dynamics(endless)
    np.testing.assert_allclose(
        other.compute_torque(q, v, a), one.compute_torque(q, v, a), atol=1e-9
    )  # of thousands of N·m
    robot = load_robot(endless)
    np.testing.assert_allclose(
        robot.compute_fk(q, endless.tool.T_flange_tcp), load_robot(plain).compute_fk(q, plain.tool.T_flange_tcp)
    )
    assert (robot.lower[5], robot.upper[5]) == (endless.limits.lower[5], endless.limits.upper[5])


def test_joints_without_torques_are_refused(tmp_path: Path) -> None:
    bare = small_cell(tmp_path)
    with pytest.raises(MissingInertiaError, match="no moving link has an <inertial>"):
        load_dynamics(bare)
    names = ("a1", "a2", "a3", "a4", "a5", "a7")
    with pytest.raises(InputError, match="'a7' is not a moving joint of the URDF; it has a1, a2"):
        load_dynamics(massive(tmp_path / "named", arm_joints=names))
    with pytest.raises(InputError, match="are not a chain"):
        load_dynamics(massive(tmp_path / "order", arm_joints=("a2", "a1", "a3", "a4", "a5", "a6")))
    with pytest.raises(InputError, match="link 'nowhere' is not in the URDF"):
        load_dynamics(massive(tmp_path / "linked", flange_link="nowhere"))

"""Kinematic chain from the part to the tool, compared with pinocchio on the whole URDF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from external_axis_cells import external_cell
from small_cell import pose, small_cell

from machopt.data_types.cell import Cell
from machopt.errors import InputError
from machopt.kinematics.machine import Machine, load_machine
from machopt.kinematics.urdf_loading import load_robot

ROUNDING = 1e-12  # m and rad: products of ten matrices over metres
KINDS = [
    {"rail": True},
    {"table": True},
    {"rail": True, "table": True},
    {"table": True, "tilt": True},
    {"rail": True, "table": True, "tilt": True},
]


def machine(cell: Cell) -> Machine:
    return load_machine(cell, load_robot(cell))


def by_pinocchio(cell: Cell, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return T_workpiece_tcp (4, 4), T_base_workpiece (4, 4) and T_world_base (4, 4)."""
    model = pin.buildModelFromXML(cell.urdf_text)
    data, q = model.createData(), pin.neutral(model)
    pin.framesForwardKinematics(model, data, q)
    base = model.getFrameId(cell.base_link)
    T_world_root = cell.T_world_base @ np.linalg.inv(data.oMf[base].homogeneous)
    for name, value in zip((*cell.arm_joints, *cell.external_joints), x, strict=True):
        q[model.idx_qs[model.getJointId(name)]] = value
    pin.framesForwardKinematics(model, data, q)

    def link(name: str) -> np.ndarray:
        return T_world_root @ data.oMf[model.getFrameId(name)].homogeneous

    part = np.eye(4) if cell.workpiece.link == "world" else link(cell.workpiece.link)
    part = part @ cell.workpiece.T_link_workpiece
    tcp = link(cell.flange_link) @ cell.tool.T_flange_tcp
    T_base = link(cell.base_link)
    return np.linalg.inv(part) @ tcp, np.linalg.inv(T_base) @ part, T_base


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_forward_kinematics_equals_pinocchio(tmp_path: Path, kind: dict[str, bool]) -> None:
    cell = replace(external_cell(tmp_path, **kind), T_world_base=pose(0.3, -0.1, 0.2, 0.4))
    m, rng = machine(cell), np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (8, 6 + m.external_count))
    T = m.compute_fk(x, cell.tool.T_flange_tcp)
    base, hall = m.compute_T_base_workpiece(x[:, 6:]), m.compute_T_world_base(x[:, 6:])
    for row, *found in zip(x, T, base, hall, strict=True):
        for ours, theirs in zip(found, by_pinocchio(cell, row), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=ROUNDING)
    np.testing.assert_allclose(
        T, np.linalg.inv(base) @ m.robot.compute_fk(x[:, :6], cell.tool.T_flange_tcp), atol=ROUNDING
    )
    np.testing.assert_allclose(hall @ base, m.compute_T_world_workpiece(x[:, 6:]), atol=ROUNDING)


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_jacobian_is_the_derivative(tmp_path: Path, kind: dict[str, bool]) -> None:
    cell = external_cell(tmp_path, **kind)
    m, rng, h = machine(cell), np.random.default_rng(2), 1e-6
    x = rng.uniform(-1.0, 1.0, (4, 6 + m.external_count))
    T, J = m.compute_fk_jacobian(x, cell.tool.T_flange_tcp)
    np.testing.assert_array_equal(T, m.compute_fk(x, cell.tool.T_flange_tcp))
    for c in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[c] = h
        d = (m.compute_fk(x + step, cell.tool.T_flange_tcp) - m.compute_fk(x - step, cell.tool.T_flange_tcp)) / (2 * h)
        turn = d[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        twist = np.column_stack([d[:, :3, 3], turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]])
        np.testing.assert_allclose(J[:, :, c], twist, atol=1e-8)  # truncation h² f‴ / 6 and rounding over h


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_higher_derivatives_are_correct(tmp_path: Path, kind: dict[str, bool]) -> None:
    m = machine(external_cell(tmp_path, **kind))
    rng, u, h = np.random.default_rng(4), np.linspace(0.0, 1.0, 5), 1e-4
    c = rng.uniform(-0.5, 0.5, (4, m.external_count))

    def way(u: np.ndarray) -> np.ndarray:
        """Return (M, 4, E) a cubic and its derivatives."""
        powers = [[1 + 0 * u, u, u**2, u**3], [0 * u, 1 + 0 * u, 2 * u, 3 * u**2]]
        powers += [[0 * u, 0 * u, 2 + 0 * u, 6 * u], [0 * u, 0 * u, 0 * u, 6 + 0 * u]]
        return np.stack([np.stack(p, axis=1) @ c for p in powers], axis=1)

    jets = m.compute_T_base_workpiece_jets(way(u))
    np.testing.assert_allclose(jets[:, 0], m.compute_T_base_workpiece(way(u)[:, 0]), atol=ROUNDING)
    ahead, behind = (m.compute_T_base_workpiece_jets(way(u + side)) for side in (h, -h))
    for order in range(3):
        slope = (ahead[:, order] - behind[:, order]) / (2 * h)
        np.testing.assert_allclose(jets[:, order + 1], slope, atol=2e-6)  # truncation h² f‴ / 6 and rounding over h


def test_links_of_a_fixed_arm_are_those_of_the_robot(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    m = machine(cell)
    q = np.random.default_rng(3).uniform(-1, 1, (5, 6))
    R, p = m.compute_links(q)
    T = m.robot.compute_link_poses(q)
    np.testing.assert_allclose(R, T[..., :3, :3], atol=ROUNDING)
    np.testing.assert_allclose(p, T[..., :3, 3], atol=ROUNDING)
    assert (m.world_link, m.base_link, m.external_count) == (0, 0, 0)
    np.testing.assert_array_equal(m.compute_T_base_workpiece(np.empty((2, 0)))[1], m.T_base_workpiece_zero)


def test_joint_that_moves_base_and_part_together_is_refused(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, rail=True, table=True)
    cell.urdf.write_text(
        cell.urdf.read_text().replace(
            '<parent link="hall"/><child link="plate"/>', '<parent link="carriage"/><child link="plate"/>'
        )
    )
    with pytest.raises(InputError, match="'rail' moves the robot's base and the workpiece alike"):
        machine(cell)

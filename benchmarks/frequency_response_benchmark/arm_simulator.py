"""Simulated frequency responses of an arm, independent of machopt: pinocchio, YAML and a direct complex solution.

The model is built from the cell's files by pinocchio alone, the tool is one more inertia at the last joint. Each
receptance is the direct solution of (K + iωD − ω²M) θ = Jᵀ d. Masses of the true arm may differ from the files.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml


@dataclass(frozen=True)
class SimulatedArm:
    """Pinocchio model with tool, and the TCP in the last joint's frame."""

    model: pin.Model
    last_tcp: pin.SE3


def build_arm(cell: Path, mass_factors: np.ndarray) -> SimulatedArm:
    """Return the arm of a cell.

    Args:
        cell: cell folder.
        mass_factors: (6,) of mass and inertia of each link, the tool belongs to the last one.
    """
    keys = yaml.safe_load((cell / "cell.yaml").read_text(encoding="utf-8"))
    model = pin.buildModelFromUrdf(str(cell / keys["robot"]["urdf"]))
    assert model.nv == 6
    flange = model.frames[model.getFrameId(keys["robot"]["flange_link"])].placement
    tool = keys["tool"]
    inertia = np.array(tool.get("inertia_kg_m2", np.zeros((3, 3))), float)
    own = pin.Inertia(float(tool["mass_kg"]), np.array(tool["com_mm"]) / 1e3, inertia)
    model.inertias[6] = model.inertias[6] + flange.act(own)
    for joint in range(1, 7):
        found = model.inertias[joint]
        factor = float(mass_factors[joint - 1])
        model.inertias[joint] = pin.Inertia(factor * found.mass, found.lever, factor * found.inertia)
    tcp = tool["tcp"]
    turned = pin.rpy.rpyToMatrix(*np.radians(tcp["rpy_deg"]))
    return SimulatedArm(model, flange * pin.SE3(turned, np.array(tcp["xyz_mm"]) / 1e3))


def simulate_responses(
    arm: SimulatedArm,
    q: np.ndarray,
    pair: tuple[np.ndarray, np.ndarray],
    omega: np.ndarray,
    k: np.ndarray,
    d: np.ndarray,
) -> np.ndarray:
    """Return the receptance at the TCP, (F,) m/N.

    Args:
        arm: model.
        q: (6,) rad.
        pair: directions of force and sensor, in the axes of the model's root.
        omega: (F,) rad/s.
        k: (6,) N·m/rad.
        d: (6,) N·m·s/rad.
    """
    data = arm.model.createData()
    pin.computeJointJacobians(arm.model, data, q)
    local = pin.getJointJacobian(arm.model, data, 6, pin.LOCAL)
    place = data.oMi[6] * arm.last_tcp
    J = place.rotation @ (arm.last_tcp.toActionMatrixInverse() @ local)[:3]
    upper = np.triu(pin.crba(arm.model, data, q))
    M = upper + np.triu(upper, 1).T
    force, sensor = J.T @ pair[0], J.T @ pair[1]
    return np.array([sensor @ np.linalg.solve(np.diag(k + 1j * w * d) - w**2 * M, force) for w in omega])

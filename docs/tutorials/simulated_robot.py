"""Fill in the readings of a measurement plan with those of a simulated robot.

``python docs/tutorials/simulated_robot.py CELL PLAN`` writes displacements into ``PLAN/recording_template/data.csv``.

It stands in for the measuring equipment in the third tutorial. The simulated robot differs from the cell's
``stiffness.yaml`` in two ways: joint 2 is 30 % softer than stated, and the base rocks on its bolts. Both are what a
load test on a real robot often shows. The displacement of the TCP under a wrench w is C w with
C = J K⁻¹ Jᵀ + G_base C_base G_baseᵀ, J by pinocchio, plus 0.01 mm of noise (1 σ).
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pinocchio
import yaml

SOFTER_JOINT, SHARE = 1, 0.7  # joint 2 (counted from zero) has 70 % of the stated stiffness
BASE_ROTATION = 2.5e-7  # rad/(N·m) about x and y of base_link
NOISE_MM = 0.01
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
WRENCH = ["fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"]
DISPLACEMENT = ["dx_mm", "dy_mm", "dz_mm"]


def compute_displacement(
    model: pinocchio.Model, tcp: np.ndarray, stiffness: np.ndarray, q: np.ndarray, wrench: np.ndarray
) -> np.ndarray:
    """Return the displacement of the TCP in base_link axes.

    Args:
        model: the arm, from its URDF.
        tcp: (3,) m, the TCP in the flange frame.
        stiffness: (6,) N·m/rad, the true joint stiffness.
        q: (6,) rad.
        wrench: (6,) N, N·m, at the TCP in base_link axes.

    Returns:
        (3,) m.
    """
    data = model.createData()
    flange = model.nframes - 1
    pinocchio.framesForwardKinematics(model, data, q)
    placement = data.oMf[flange]
    jacobian = pinocchio.computeFrameJacobian(model, data, q, flange, pinocchio.LOCAL_WORLD_ALIGNED)
    lever = placement.rotation @ tcp
    translation = jacobian[:3] - pinocchio.skew(lever) @ jacobian[3:]
    torque = translation.T @ wrench[:3] + jacobian[3:].T @ wrench[3:]
    moment = np.cross(placement.translation + lever, wrench[:3]) + wrench[3:]
    rocking = np.array([BASE_ROTATION * moment[0], BASE_ROTATION * moment[1], 0.0])
    return translation @ (torque / stiffness) + np.cross(rocking, placement.translation + lever)


def main(cell: Path, plan: Path) -> None:
    """Fill in the readings.

    Args:
        cell: the cell folder.
        plan: the output folder of ``machopt plan-poses``.
    """
    keys = yaml.safe_load((cell / "cell.yaml").read_text(encoding="utf-8"))
    model = pinocchio.buildModelFromUrdf(str(cell / "robot.urdf"))
    tcp = np.array(keys["tool"]["tcp"]["xyz_mm"]) / 1000
    stiffness = np.array(
        yaml.safe_load((cell / "stiffness.yaml").read_text(encoding="utf-8"))["joints_Nm_per_rad"], dtype=float
    )
    stiffness[SOFTER_JOINT] *= SHARE
    table = plan / "recording_template" / "data.csv"
    with table.open(encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    rng = np.random.default_rng(1)
    for row in rows:
        q = np.radians([float(row[name]) for name in JOINTS])
        wrench = np.array([float(row[name]) for name in WRENCH])
        moved = 1000 * compute_displacement(model, tcp, stiffness, q, wrench) + rng.normal(0, NOISE_MM, 3)
        row.update({name: f"{value:.4f}" for name, value in zip(DISPLACEMENT, moved, strict=True)})
    with table.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

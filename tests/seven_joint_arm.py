"""Arm with seven joints and its readings, simulated with pinocchio only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]
JOINTS = tuple(f"a{i}" for i in range(1, 8))
SPRINGS = np.array([9e4, 7e4, 6e4, 5e4, 3e4, 2e4, 1.5e4])  # N·m/rad
TCP_M = 0.12
_OFFSETS = ("0 0 0.16", "0 0 0.2", "0 0 0.2", "0 0 0.2", "0 0 0.2", "0 0 0.2", "0 0 0.09")  # m along the arm
_AXES = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
_MASSES = (4.0, 4.2, 3.2, 3.0, 2.0, 1.9, 0.6)  # kg
_LIMITS = (2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 2.9)  # rad


def format_urdf() -> str:
    """Return the URDF of the arm."""
    text = '<robot name="seven"><link name="base_link"/>'
    for i, name in enumerate(JOINTS):
        before = "base_link" if i == 0 else f"link_{i}"
        text += (
            f'<link name="link_{i + 1}"><inertial><origin xyz="0.01 0.02 0.09"/><mass value="{_MASSES[i]}"/>'
            f'<inertia ixx="0.02" iyy="0.02" izz="0.008" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{before}"/><child link="link_{i + 1}"/>'
            f'<origin xyz="{_OFFSETS[i]}"/><axis xyz="{_AXES[i]}"/>'
            f'<limit lower="-{_LIMITS[i]}" upper="{_LIMITS[i]}" velocity="2" effort="200"/></joint>'
        )
    return (
        f'{text}<link name="tool0"/><joint name="tool" type="fixed"><parent link="link_7"/><child link="tool0"/>'
        '<origin xyz="0 0 0.045"/></joint></robot>'
    )


def write_cell(folder: Path, stiffness: bool = True) -> Path:
    """Write a cell of the arm.

    Args:
        folder: New folder.
        stiffness: Whether the cell states joint springs, each 20 % off.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(format_urdf())
    cell = {
        "machopt_cell": 1,
        "name": "seven joints",
        "robot": {
            "urdf": "robot.urdf",
            "base_link": "base_link",
            "flange_link": "tool0",
            "arm_joints": list(JOINTS),
            "home_deg": [0, 20, 0, 60, 0, 60, 0],
            "limits": {"acceleration_deg_s2": [300] * 7, "jerk_deg_s3": [3000] * 7},
            "gravity_compensator": "none",
            "rated_payload_kg": 14,
        },
        "tool": {"tcp": {"xyz_mm": [0, 0, 1e3 * TCP_M], "rpy_deg": [0, 0, 0]}, "mass_kg": 0.0},
        "workpiece": {"pose": {"xyz_mm": [500, 0, 300], "rpy_deg": [0, 0, 0]}},
    }
    if stiffness:
        off = 1.0 + 0.2 * np.array([1, -1, 1, -1, 1, -1, 1])
        text = {"machopt_stiffness": 1, "joints_Nm_per_rad": [float(k) for k in SPRINGS * off]}
        (folder / "stiffness.yaml").write_text(yaml.safe_dump(text))
        cell["stiffness"] = "stiffness.yaml"
    (folder / "cell.yaml").write_text(yaml.safe_dump(cell, sort_keys=False))
    return folder


@dataclass
class SevenJointArm:
    """The real arm: springs, zero offsets (rad) and a payload at the TCP (kg)."""

    springs: Array
    offsets: Array
    payload: float = 0.0

    def __post_init__(self) -> None:
        self.model = pin.buildModelFromXML(format_urdf())
        flange = self.model.getFrameId("tool0")
        parent = self.model.frames[flange].parentJoint
        place = self.model.frames[flange].placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, TCP_M]))
        self.tcp = self.model.addFrame(pin.Frame("tcp", parent, place, pin.FrameType.OP_FRAME))
        if self.payload:
            self.model.appendBodyToJoint(parent, pin.Inertia(self.payload, np.zeros(3), np.zeros((3, 3))), place)
        self.data = self.model.createData()

    def compute_pose(self, q: Array, wrench: Array | None = None) -> pin.SE3:
        """Return the TCP at the equilibrium of springs, weight and a wrench (6,) at the TCP in base axes."""
        encoder = q + self.offsets
        at = encoder.copy()
        for _ in range(30):
            torque = -pin.computeGeneralizedGravity(self.model, self.data, at)
            if wrench is not None:
                pin.computeJointJacobians(self.model, self.data, at)
                pin.updateFramePlacements(self.model, self.data)
                J = pin.getFrameJacobian(self.model, self.data, self.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                torque = torque + J.T @ wrench
            new = encoder + torque / self.springs
            if np.abs(new - at).max() < 1e-13:
                break
            at = new
        pin.forwardKinematics(self.model, self.data, at)
        pin.updateFramePlacements(self.model, self.data)
        return self.data.oMf[self.tcp].copy()

    def compute_torque(self, q: Array, v: Array, a: Array) -> Array:
        """Return the joint torques (N, 7) of a motion with Coulomb and viscous friction."""
        rigid = np.array([pin.rnea(self.model, self.data, *x).copy() for x in zip(q, v, a, strict=True)])
        return rigid + 1.5 * np.tanh(v / 0.02) + 2.0 * v


def draw_postures(count: int, rng: np.random.Generator) -> Array:
    """Return joint angles (count, 7) rad, 0.7 of each range."""
    return rng.uniform(-0.7, 0.7, (count, 7)) * np.array(_LIMITS)


def write_recording(folder: Path, header: dict[str, object], columns: dict[str, Array]) -> Path:
    """Write a recording folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.yaml").write_text(yaml.safe_dump({"machopt_recording": 1, "data": "data.csv", **header}))
    rows = np.column_stack(list(columns.values()))
    np.savetxt(folder / "data.csv", rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return folder


def record_poses(arm: SevenJointArm, folder: Path, rng: np.random.Generator, count: int = 60) -> Path:
    """Write measured poses of the unloaded arm, each visited twice; noise 0.015 mm."""
    q = np.repeat(draw_postures(count, rng), 2, axis=0)
    order = np.argsort(np.tile([0, 1], count), kind="stable")  # all poses once, then all again
    q, pose = q[order], np.repeat(np.arange(count), 2)[order]
    points = np.array([arm.compute_pose(x).translation for x in q]) + rng.normal(0.0, 15e-6, (len(q), 3))
    turn, shift = pin.utils.rpyToMatrix(0.3, -0.2, 1.1), np.array([1.2, -0.4, 0.8])
    points = points @ turn.T + shift
    columns = {"pose": pose, "cycle": np.repeat([1, 2], count)}
    columns |= {f"q{j + 1}_deg": np.degrees(q[:, j]) for j in range(7)}
    columns |= {f"{a}_mm": 1e3 * points[:, k] for k, a in enumerate("xyz")}
    header = {
        "kind": "absolute",
        "registration": "fit",
        "standard_uncertainty": {"displacement_mm": 0.015, "target_mm": 1.0},
    }
    return write_recording(folder, header, columns)


def record_load_tests(arm: SevenJointArm, folder: Path, rng: np.random.Generator, count: int = 30) -> Path:
    """Write load tests: three loads at each posture, two cycles; noise 0.004 mm."""
    rows = []
    for pose, q in enumerate(draw_postures(count, rng)):
        free = arm.compute_pose(q).translation
        for force in rng.normal(size=(3, 3)):
            load = 150.0 * force / np.linalg.norm(force)
            moved = arm.compute_pose(q, np.concatenate([load, np.zeros(3)])).translation - free
            for cycle in (1, 2):
                noise = rng.normal(0.0, 4e-6, 3)
                rows.append([pose, cycle, *np.degrees(q), *load, *(1e3 * (moved + noise))])
    names = ["pose", "cycle", *(f"q{j}_deg" for j in range(1, 8)), "fx_N", "fy_N", "fz_N", "dx_mm", "dy_mm", "dz_mm"]
    columns = dict(zip(names, np.array(rows).T, strict=True))
    header = {
        "kind": "deflection",
        "wrench_frame": "base",
        "displacement_frame": "base",
        "standard_uncertainty": {"displacement_mm": 0.004, "force_N": 0.2},
    }
    return write_recording(folder, header, columns)


def record_motion(arm: SevenJointArm, folder: Path, rng: np.random.Generator, seconds: float = 30.0) -> Path:
    """Write a motion with joint torques: sums of sines at 250 Hz; noise 0.15 N·m."""
    t = np.arange(0.0, seconds, 0.004)
    q, v, a = (np.zeros((len(t), 7)) for _ in range(3))
    for j in range(7):
        for f in rng.uniform(0.08, 0.45, 4):
            size, phase, w = 0.25 * _LIMITS[j], rng.uniform(0.0, 2 * np.pi), 2 * np.pi * f
            q[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w**2 * np.sin(w * t + phase)
    torque = arm.compute_torque(q, v, a) + rng.normal(0.0, 0.15, q.shape)
    columns = {"time_s": t, **{f"q{j + 1}_deg": np.degrees(q[:, j]) for j in range(7)}}
    columns |= {f"tau{j + 1}_Nm": torque[:, j] for j in range(7)}
    return write_recording(folder, {"kind": "motion"}, columns)

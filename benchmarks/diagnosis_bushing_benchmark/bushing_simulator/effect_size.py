"""Size of an effect: r.m.s. of its contribution over σ of a reading, before and after the base model is refitted."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from bushing_simulator.laboratory import DrawnEffect, Laboratory
from bushing_simulator.load_recording import LoadPlan, NoiseLevels, SensorErrors, compute_load_response, observe_loads
from bushing_simulator.pose_recording import (
    PoseErrors,
    PoseNoise,
    PosePlan,
    compute_pose_response,
    list_rotation_columns,
    observe_poses,
)
from bushing_simulator.reference_kinematics import (
    compute_frames,
    compute_gravity_torque,
    compute_jacobian,
    list_body_columns,
    list_spring_columns,
    project_out,
)
from bushing_simulator.robot_descriptions import RobotDescription


@dataclass(frozen=True)
class NoiseFreeRecord:
    """Readings without noise; ``mismatch`` is what the true springs and the recorded load do not explain, in m."""

    readings: np.ndarray  # load tests (C, L, 6); poses (V, T, 3)
    force: np.ndarray | None  # (C, L, 3) recorded
    gauge: np.ndarray | None  # (V,) °C
    mismatch: np.ndarray  # (M,) m
    base: np.ndarray  # (M, k) columns of the refitted base
    residual: float  # N


@dataclass(frozen=True)
class EffectSize:
    """How large an effect is."""

    scale: float
    ratio: float  # r.m.s. over σ of a reading
    visible_ratio: float  # the same after the base is refitted
    noncentrality: float  # √(Σ (visible/σ)²) with shared noise counted once a cycle or visit


def record_without_noise(robot: RobotDescription, lab: Laboratory, plan: LoadPlan | PosePlan) -> NoiseFreeRecord:
    """Return the readings of a laboratory without random errors."""
    lab = copy.deepcopy(lab)
    if isinstance(plan, LoadPlan):
        sensors = SensorErrors(**lab.sensors)
        moved, forces, residual = compute_load_response(robot, lab.hidden, plan, sensors)
        seen, force = observe_loads(robot, plan, moved, forces, sensors)
        J = np.repeat(compute_jacobian(robot, plan.q), force.shape[1], axis=0)
        flat = force.reshape(-1, 3)
        torque = np.einsum("nki,nk->ni", J[:, :3], flat)
        columns = list_spring_columns(J, torque, 3)
        predicted = columns @ (1.0 / lab.hidden.springs)
        mismatch = seen[..., :3].reshape(-1, 3) - predicted
        return NoiseFreeRecord(seen, force, None, mismatch.ravel(), columns.reshape(-1, 6), residual)
    places, gauge, residual = compute_pose_response(robot, lab.hidden, plan, PoseErrors(**lab.errors))
    seen = observe_poses(plan, places)
    torque = compute_gravity_torque(robot, plan.q, robot.masses, robot.tool_mass)
    count = len(plan.targets)
    columns = [
        list_spring_columns(compute_jacobian(robot, plan.q, t), torque, 3) for t in plan.targets
    ]  # base axes; with registration they are turned with the readings
    base = np.stack(columns, axis=1).reshape(-1, 6)
    rigid, turned, _, _ = compute_frames(robot, plan.q)
    nominal = rigid[:, 6, None] + np.einsum("nij,tj->nti", turned[:, 6], plan.targets)
    sag = np.stack(columns, axis=1) @ (1.0 / lab.hidden.springs)
    mismatch = (places - nominal - sag).ravel()
    if plan.fit:
        frames = list_rotation_columns(places).reshape(-1, 6)
        shifts = np.zeros((len(plan.q), count, 3, count, 3))
        for t in range(count):
            shifts[:, t, :, t, :] = turned[:, 6]
        base = np.concatenate([base, frames, shifts.reshape(-1, 3 * count)], axis=1)
    return NoiseFreeRecord(seen, None, gauge, mismatch, base, residual)


def get_noise_sigma(plan: LoadPlan | PosePlan) -> tuple[float, float, int]:
    """Return σ of a reading, its shared part, and the rows that share it."""
    if isinstance(plan, LoadPlan):
        noise = NoiseLevels()
        return float(np.hypot(noise.white, noise.cycle)), noise.cycle, plan.durations.shape[1]
    pose = PoseNoise()
    return float(np.hypot(pose.white, pose.visit)), pose.visit, len(plan.targets)


def compute_size(difference: np.ndarray, base: np.ndarray, plan: LoadPlan | PosePlan, scale: float) -> EffectSize:
    """Return the size of a contribution (M,) in m."""
    sigma, shared, rows = get_noise_sigma(plan)
    white = np.sqrt(sigma**2 - shared**2)
    left = project_out(base, difference)
    groups = left.reshape(-1, rows, 3)
    mean = groups.mean(axis=1, keepdims=True)
    weight = np.sum((groups - mean) ** 2) / white**2 + np.sum(mean**2) * rows / (white**2 + rows * shared**2)
    rms = float(np.sqrt(np.mean(difference**2)))
    return EffectSize(scale, rms / sigma, float(np.sqrt(np.mean(left**2))) / sigma, float(np.sqrt(weight)))


def scale_effect(
    robot: RobotDescription, lab: Laboratory, plan: LoadPlan | PosePlan, effect: DrawnEffect, ratio: float
) -> EffectSize:
    """Return the scale at which the contribution is ``ratio`` times σ, or the largest physical one."""
    plain = record_without_noise(robot, lab, plan)
    scale = 1.0
    for _ in range(5):
        size = measure_effect(robot, lab, plan, effect, scale, plain)
        if abs(size.ratio / ratio - 1.0) < 0.05 or (scale >= effect.largest and size.ratio < ratio):
            return size
        scale = float(np.clip(scale * ratio / max(size.ratio, 1e-9), 1e-4, effect.largest))
    return measure_effect(robot, lab, plan, effect, scale, plain)


def measure_effect(
    robot: RobotDescription,
    lab: Laboratory,
    plan: LoadPlan | PosePlan,
    effect: DrawnEffect,
    scale: float,
    plain: NoiseFreeRecord,
) -> EffectSize:
    """Return the size of an effect at a scale."""
    changed = copy.deepcopy(lab)
    effect.apply(changed, scale)
    record = record_without_noise(robot, changed, plan)
    return compute_size(record.mismatch - plain.mismatch, record.base, plan, scale)


def list_equivalent_bodies(
    robot: RobotDescription, plan: LoadPlan, difference: np.ndarray, record: NoiseFreeRecord
) -> list[tuple[str, str]]:
    """Return the compliances whose 6×6 takes the contribution away to a noncentrality below 2 or 1 %."""
    assert record.force is not None
    most = max(2.0, 0.01 * compute_size(difference, record.base, plan, 1.0).noncentrality)
    q = np.repeat(plan.q, record.force.shape[1], axis=0)
    wrench = np.concatenate([record.force.reshape(-1, 3), np.zeros((len(q), 3))], axis=1)
    found = []
    for body in range(8):
        columns = list_body_columns(robot, q, wrench, body, 3).reshape(-1, 21)
        size = compute_size(difference, np.concatenate([record.base, columns], axis=1), plan, 1.0)
        if size.noncentrality < most:
            name = {0: ("base_compliance", "base"), 7: ("tool_compliance", "tool")}
            found.append(name.get(body, ("link_compliance", f"link:{body}")))
    J = compute_jacobian(robot, q)
    torque = np.einsum("nki,nk->ni", J[:, :3], wrench[:, :3])
    for i in range(6):
        for j in range(i + 1, 6):
            column = (J[:, :3, i] * torque[:, j, None] + J[:, :3, j] * torque[:, i, None]).reshape(-1, 1)
            size = compute_size(difference, np.concatenate([record.base, column], axis=1), plan, 1.0)
            if size.noncentrality < most:
                found.append(("joint_coupling", f"joint:{i + 1}-{j + 1}"))
    return found


def list_equivalent_geometry(
    robot: RobotDescription, plan: PosePlan, difference: np.ndarray, record: NoiseFreeRecord
) -> list[tuple[str, str]]:
    """Return the kinematic corrections whose columns leave a noncentrality below 2 or 1 % in a pose set."""
    most = max(
        2.0, 0.01 * compute_size(difference, record.base, plan, 1.0).noncentrality
    )  # columns are those without sag
    places, rotations, _, axes = compute_frames(robot, plan.q)
    seen = places[:, 6, None] + np.einsum("nij,tj->nti", rotations[:, 6], plan.targets)
    candidates = {}
    for joint in range(8):  # the frame before joint 1 … 6, and the tool
        index = min(max(joint - 1, 0), 6) if joint < 7 else 6
        R = (
            np.broadcast_to(np.eye(3), rotations[:, 0].shape)
            if joint <= 1
            else rotations[:, index if joint == 7 else joint - 2]
        )
        lever = seen - places[:, index][:, None]
        columns = np.zeros((*seen.shape, 6))
        for k in range(3):
            columns[..., k] = R[:, None, :, k]
            columns[..., 3 + k] = np.cross(R[:, None, :, k], lever)
        name = {0: "base", 7: "tool"}.get(joint, f"joint:{joint}")
        candidates[("geometry", name)] = columns.reshape(-1, 6)
        if 1 <= joint <= 6:
            candidates[("joint_zero_offset", name)] = np.cross(axes[:, joint - 1][:, None], lever).reshape(-1, 1)
    return [
        name
        for name, columns in candidates.items()
        if compute_size(difference, np.concatenate([record.base, columns], axis=1), plan, 1.0).noncentrality < most
    ]

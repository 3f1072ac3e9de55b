"""Poses to measure where the arm stands still, unloaded or with a weight hung on it, as cases of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.kinematics.robot import RobotMasses
from machopt.measurement.design.load_cases import LoadCases, LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.stiffness.arm_stiffness import ArmElasticity

NO_LOAD = "nothing hangs on the arm"


def select_weight_loads(offered: bool, ways: Sequence[LoadMethod]) -> tuple[LoadMethod, ...]:
    """No load, then the weights among the ways, hung at the TCP, where weights were offered."""
    none = LoadMethod(
        kind="weight",
        direction=np.array([0.0, 0.0, -1.0]),
        anchor=None,
        arm=np.zeros(3),
        magnitudes=(0.0,),
        words=NO_LOAD,
    )
    hung = tuple(w for w in ways if w.kind == "weight" and not w.arm.any()) if offered else ()
    return (none, *hung)


def build_static_pose_cases(
    pool: PosePool,
    ways: Sequence[LoadMethod],
    prior: ArmElasticity,
    criteria: LoadCriteria,
    noise: ReadingNoise,
    masses: RobotMasses,
) -> LoadCases:
    """Every pose without load, and with each weight that its limits allow.

    Args:
        pool: P poses.
        ways: of :func:`select_weight_loads`.
        prior: stiffness as diagnosed.
        criteria: limits of loads.
        noise: of a reading.
        masses: of links and tool, which bend the arm in any case.
    """
    P, zero = len(pool), np.zeros(len(pool))
    six = np.zeros((P, 6))
    bare = LoadCases(
        pose=np.arange(P),
        way=np.zeros(P, np.int64),
        magnitude=zero,
        wrench=six,
        point=pool.T_base_tcp[:, :3, 3],
        twist=six,
        response=np.zeros((P, noise.dimensions, 6)),
        nu_p=zero,
        nu_r=zero,
        rejected={},
    )
    parts = [bare]
    if len(ways) > 1 and P:
        hung = build_load_cases(pool, ways[1:], prior, (), criteria, noise)
        parts.append(replace(hung, way=hung.way + 1))
    pose = np.concatenate([p.pose for p in parts])
    order = np.argsort(pose, kind="stable")

    def both(name: str) -> Any:  # an array of the field's own type
        return np.asarray(np.concatenate([getattr(p, name) for p in parts])[order])

    tau = compute_gravity_torque(prior.robot, masses, pool.state)[0]
    weight = (pool.state.J * tau[:, None, :])[:, : noise.dimensions]
    return LoadCases(
        pose=both("pose"),
        way=both("way"),
        magnitude=both("magnitude"),
        wrench=both("wrench"),
        point=both("point"),
        twist=both("twist"),
        response=both("response") + weight[pose[order]],
        nu_p=both("nu_p"),
        nu_r=both("nu_r"),
        rejected=parts[-1].rejected,
    )

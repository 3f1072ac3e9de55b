"""Load cases for measured poses of an arm at rest, unloaded or with a hanging weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.kinematics.robot import RobotMasses
from machopt.measurement.design.load_cases import LoadCases, LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.stiffness.arm_stiffness import ArmElasticity

NO_LOAD = "nothing hangs on the arm"


def select_weight_loads(offered: bool, ways: Sequence[LoadMethod]) -> tuple[LoadMethod, ...]:
    """Select the load methods for measured poses: no load, and weights at the TCP if the user offers weights.

    Args:
        offered: Whether the user offers weights.
        ways: Methods of load application.

    Returns:
        The methods, no load first.
    """
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
    """Build every pose without load and with each admissible weight.

    Args:
        pool: Candidate poses.
        ways: Methods of :func:`select_weight_loads`.
        prior: Stiffness as diagnosed.
        criteria: Limits of each load.
        noise: Noise of a reading.
        masses: Link and tool masses, which deflect the arm in any case.

    Returns:
        The load cases.
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

    def both(name: str) -> Any:  # array of the field's type
        return np.asarray(np.concatenate([getattr(p, name) for p in parts])[order])

    tau = compute_weight_torque(prior.robot, masses, pool.state)
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

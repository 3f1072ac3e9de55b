"""Poses to measure where the arm stands still, unloaded or with a weight hung on it, as cases of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machopt.design.candidates import PosePool
from machopt.design.loadcases import LoadCases, LoadCriteria, load_cases
from machopt.design.loads import LoadWay
from machopt.design.measurement import ReadingNoise
from machopt.model.elastic import ArmElasticity
from machopt.model.gravity import gravity_torque
from machopt.model.robot import Masses

NO_LOAD = "nothing hangs on the arm"


def weights_of(offered: bool, ways: Sequence[LoadWay]) -> tuple[LoadWay, ...]:
    """No load, then the weights among the ways, hung at the TCP, where weights were offered."""
    none = LoadWay(
        kind="weight",
        direction=np.array([0.0, 0.0, -1.0]),
        anchor=None,
        arm=np.zeros(3),
        magnitudes=(0.0,),
        words=NO_LOAD,
    )
    hung = tuple(w for w in ways if w.kind == "weight" and not w.arm.any()) if offered else ()
    return (none, *hung)


def cases_at_rest(
    pool: PosePool,
    ways: Sequence[LoadWay],
    prior: ArmElasticity,
    criteria: LoadCriteria,
    noise: ReadingNoise,
    masses: Masses,
) -> LoadCases:
    """Every pose without load, and with each weight that its limits allow.

    Args:
        pool: P poses.
        ways: of :func:`weights_of`.
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
        hung = load_cases(pool, ways[1:], prior, (), criteria, noise)
        parts.append(replace(hung, way=hung.way + 1))
    pose = np.concatenate([p.pose for p in parts])
    order = np.argsort(pose, kind="stable")

    def both(name: str) -> Any:  # an array of the field's own type
        return np.asarray(np.concatenate([getattr(p, name) for p in parts])[order])

    tau = gravity_torque(prior.robot, masses, pool.state)[0]
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

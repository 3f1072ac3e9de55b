"""The channels behind one set of functions: load tests, sets of poses, motions."""

from __future__ import annotations

from typing import Any

import concealed_load
import loadtest
import motion
import numpy as np
import poses
import rig
import tables
from dualquat import Array
from robots import Robot
from scene import Clean, Effect, Scene

DISTURBED = (*rig.DISTURBED, "fit_crude", "fixed_once", "fixed_few", "torque_restless")


def scene(channel: str, lab: str, nominal: Robot, built: Robot, rng: np.random.Generator) -> Scene:
    """An experiment by its channel and the lab's habits."""
    if channel == "motion":
        return motion.Motion(nominal, built, motion.MOTION_LABS[lab], rng)
    if channel == "poses":
        return poses.PoseSet(nominal, built, poses.POSE_LABS[lab], rng)
    return loadtest.LoadTest(nominal, built, rig.LABS[lab], rng)


def draw(of: Scene, name: str, rng: np.random.Generator, loud: float) -> list[Effect]:
    """Places an effect may have."""
    if isinstance(of, poses.PoseSet):
        return poses.draw(name, of, rng, loud)
    if isinstance(of, motion.Motion):
        return motion.draw(name, of, rng, loud)
    assert isinstance(of, loadtest.LoadTest)
    return concealed_load.draw(name, of, rng, loud)


def table(of: Scene, clean: Clean, rng: np.random.Generator) -> tables.Table:
    """The recording with its noise."""
    if isinstance(of, poses.PoseSet):
        return poses.pose_table(of, clean, rng)
    if isinstance(of, motion.Motion):
        return motion.motion_table(of, clean, rng)
    assert isinstance(of, loadtest.LoadTest)
    return tables.load_table(of, clean, rng)


def measured(of: Scene, written: tables.Table, clean: Clean) -> Array:
    """(N, D) what was read, SI, base axes, as ``clean.y``."""
    if isinstance(of, poses.PoseSet):
        return np.concatenate([poses.pose_measured(of, written), clean.y[:, 3:]], axis=1)
    if isinstance(of, motion.Motion):
        return motion.motion_measured(of, written)
    assert isinstance(of, loadtest.LoadTest)
    c = written.columns
    D = concealed_load.axes_of(of, of.lab.displacement_frame)
    parts = [np.einsum("nij,nj->ni", D, 1e-3 * np.stack([c[f"d{a}_mm"] for a in "xyz"], axis=1))]
    if of.lab.turning:
        parts.append(np.einsum("nij,nj->ni", D, 1e-3 * np.stack([c[f"r{a}_mrad"] for a in "xyz"], axis=1)))
    return np.concatenate(parts, axis=1)


def repeats(of: Scene) -> bool:
    """Whether any pose and load was visited twice."""
    if isinstance(of, poses.PoseSet):
        return of.lab.sessions > 1
    if isinstance(of, motion.Motion):
        return of.lab.cycles > 1
    assert isinstance(of, loadtest.LoadTest)
    return of.lab.sessions * of.lab.cycles > 1 and not of.lab.mirrored


def ambient(of: Scene) -> list[dict[str, Any]]:
    """What is always in such a record and may be named."""
    if isinstance(of, motion.Motion):
        # dry and viscous friction are in every torque and belong to the base
        return [] if of.lab.link else [{"effect": "joint_friction", "location": f"joint:{j}"} for j in range(1, 7)]
    out = [{"effect": "geometric_stiffness", "location": "arm"}]
    if getattr(getattr(of, "lab", None), "name", "") == "wandering":
        out.append({"effect": "thermal_drift", "location": "environment"})
    return out

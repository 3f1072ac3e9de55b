"""The channels behind one set of functions: load tests, sets of poses, motions."""

from __future__ import annotations

from typing import Any

import load_test
import load_test_effects
import loading_rig
import motion_recording
import numpy as np
import pose_recording
import recording_tables
from dual_quaternions import Array
from effect_strength import Effect, NoiseFreeRecord, Scene
from robot_models import Robot

DISTURBED = (*loading_rig.DISTURBED, "fit_crude", "fixed_once", "fixed_few", "torque_restless")


def scene(channel: str, lab: str, nominal: Robot, built: Robot, rng: np.random.Generator) -> Scene:
    """An experiment by its channel and the lab's habits."""
    if channel == "motion":
        return motion_recording.Motion(nominal, built, motion_recording.MOTION_LABS[lab], rng)
    if channel == "poses":
        return pose_recording.PoseSet(nominal, built, pose_recording.POSE_LABS[lab], rng)
    return load_test.LoadTest(nominal, built, loading_rig.LABS[lab], rng)


def draw(of: Scene, name: str, rng: np.random.Generator, loud: float) -> list[Effect]:
    """Places an effect may have."""
    if isinstance(of, pose_recording.PoseSet):
        return pose_recording.draw(name, of, rng, loud)
    if isinstance(of, motion_recording.Motion):
        return motion_recording.draw(name, of, rng, loud)
    assert isinstance(of, load_test.LoadTest)
    return load_test_effects.draw(name, of, rng, loud)


def table(of: Scene, clean: NoiseFreeRecord, rng: np.random.Generator) -> recording_tables.Table:
    """The recording with its noise."""
    if isinstance(of, pose_recording.PoseSet):
        return pose_recording.pose_table(of, clean, rng)
    if isinstance(of, motion_recording.Motion):
        return motion_recording.motion_table(of, clean, rng)
    assert isinstance(of, load_test.LoadTest)
    return recording_tables.load_table(of, clean, rng)


def measured(of: Scene, written: recording_tables.Table, clean: NoiseFreeRecord) -> Array:
    """(N, D) what was read, SI, base axes, as ``clean.y``."""
    if isinstance(of, pose_recording.PoseSet):
        return np.concatenate([pose_recording.pose_measured(of, written), clean.y[:, 3:]], axis=1)
    if isinstance(of, motion_recording.Motion):
        return motion_recording.motion_measured(of, written)
    assert isinstance(of, load_test.LoadTest)
    c = written.columns
    D = load_test_effects.axes_of(of, of.lab.displacement_frame)
    parts = [np.einsum("nij,nj->ni", D, 1e-3 * np.stack([c[f"d{a}_mm"] for a in "xyz"], axis=1))]
    if of.lab.turning:
        parts.append(np.einsum("nij,nj->ni", D, 1e-3 * np.stack([c[f"r{a}_mrad"] for a in "xyz"], axis=1)))
    return np.concatenate(parts, axis=1)


def repeats(of: Scene) -> bool:
    """Whether any pose and load was visited twice."""
    if isinstance(of, pose_recording.PoseSet):
        return of.lab.sessions > 1
    if isinstance(of, motion_recording.Motion):
        return of.lab.cycles > 1
    assert isinstance(of, load_test.LoadTest)
    return of.lab.sessions * of.lab.cycles > 1 and not of.lab.mirrored


def ambient(of: Scene) -> list[dict[str, Any]]:
    """What is always in such a record and may be named."""
    if isinstance(of, motion_recording.Motion):
        # dry and viscous friction are in every torque and belong to the base
        return [] if of.lab.link else [{"effect": "joint_friction", "location": f"joint:{j}"} for j in range(1, 7)]
    out = [{"effect": "geometric_stiffness", "location": "arm"}]
    if getattr(getattr(of, "lab", None), "name", "") == "wandering":
        out.append({"effect": "thermal_drift", "location": "environment"})
    return out

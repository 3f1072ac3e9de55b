"""Load tests and pose measurements of a simulated arm, before any sensor sees them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.arm_model import Arm
from simulator.measurement_design import LoadTestSequence, PoseSequence
from simulator.serial_chain import rotation_vector
from simulator.static_equilibrium import Setting, Statics
from simulator.thermal_model import Heat

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deflections:
    """(B, S, …) of a programme."""

    displacement: Array  # (B, S, 6) m, rad in base axes from the zero of the cycle
    rotation: Array  # (B, S, 3, 3) of the tip
    residual: float


@dataclass(frozen=True)
class Poses:
    """(B, S, …) of visits."""

    position: Array  # (B, S, 3) m
    rotation: Array  # (B, S, 3, 3)
    residual: float


def simulate_load_tests(
    arm: Arm, programme: LoadTestSequence, joint_error: Array, approach: Array, lever: Array | None = None
) -> Deflections:
    """Every load step after the other where gears remember, all at once where they do not.

    Args:
        arm: as it is.
        programme: what is done.
        joint_error: (B, 6) rad, of the return to the pose; it stays while the pose is held.
        approach: (B, 6) N, N·m at the tip while the arm comes to rest (inertia), gone before the first reading.
        lever: (3,) m in the tip frame, where the load really acts.
    """
    statics = Statics(arm)
    B, S = programme.hold.shape
    base = Setting(programme.encoder, np.zeros((B, 6)), joint_error=joint_error)
    if lever is not None:
        base = replace(base, lever=np.broadcast_to(lever, (B, 3)))
    position, rotation = np.empty((B, S, 3)), np.empty((B, S, 3, 3))
    if statics.remembers:
        memory, x, worst = statics.start(B), None, 0.0
        for wrench in (approach, 0.3 * approach, np.zeros((B, 6))):
            setting = replace(base, wrench=wrench, hold=np.full(B, 8.0))
            e = statics.settle(setting, memory, x)
            memory, x = statics.commit(e.x, setting, memory), e.x
        for s in range(S):
            setting = replace(base, wrench=programme.wrench[:, s], hold=programme.hold[:, s])
            e = statics.settle(setting, memory, x)
            memory, x = statics.commit(e.x, setting, memory), e.x
            position[:, s], rotation[:, s], worst = e.position, e.rotation, max(worst, e.residual)
    else:

        def more(a: Array) -> Array:
            return np.repeat(a, S, axis=0)

        setting = Setting(
            more(base.encoder),
            programme.wrench.reshape(B * S, 6),
            hold=programme.hold.reshape(-1),
            lever=None if base.lever is None else more(base.lever),
            joint_error=more(joint_error),
        )
        e = statics.settle(setting)
        position, rotation, worst = e.position.reshape(B, S, 3), e.rotation.reshape(B, S, 3, 3), e.residual
    last_zero = np.maximum.accumulate(np.where(programme.zero, np.arange(S), 0))
    turned = rotation @ np.swapaxes(rotation[:, last_zero], -1, -2)
    d = np.concatenate(
        [position - position[:, last_zero], rotation_vector(turned.reshape(-1, 3, 3)).reshape(B, S, 3)], axis=2
    )
    return Deflections(d, rotation, worst)


def simulate_poses(
    arm: Arm, visits: PoseSequence, joint_error: Array, approach: Array, heat: Heat | None = None
) -> Poses:
    """Absolute poses; each visit starts with an approach from somewhere else."""
    if heat is not None:
        arm = replace(arm, grows=list(heat.links))
    statics = Statics(arm)
    B, S, _ = visits.wrench.shape
    growth = {} if heat is None else heat.growth(visits.time)
    base = Setting(visits.encoder, np.zeros((B, 6)), joint_error=joint_error, growth=growth, hold=np.full(B, 8.0))
    position, rotation = np.empty((B, S, 3)), np.empty((B, S, 3, 3))
    memory, x, worst = statics.start(B), None, 0.0
    if statics.remembers:
        for wrench in (approach, 0.3 * approach):
            setting = replace(base, wrench=wrench)
            e = statics.settle(setting, memory, x)
            memory, x = statics.commit(e.x, setting, memory), e.x
    for s in range(S):
        setting = replace(base, wrench=visits.wrench[:, s])
        e = statics.settle(setting, memory, x)
        memory, x = statics.commit(e.x, setting, memory), e.x
        position[:, s], rotation[:, s], worst = e.position, e.rotation, max(worst, e.residual)
    return Poses(position, rotation, worst)

"""Diagnosis of a motion: which channel its signals allow, and the equations and catalogue of that channel.

``link``: link-side against motor-side encoders; ``tip``: tracked TCP against the commanded joints; ``torque``: joint
torque against rigid-body dynamics from the URDF's inertias.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from machopt.diagnose import motion_checks, motion_link, motion_tip, motion_torque
from machopt.diagnose.motion_frame import Scene, one_joint
from machopt.diagnose.motion_signals import signals
from machopt.diagnose.problem import Array, Catalogue, Problem, Untestable
from machopt.diagnose.result import Finding
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording
from machopt.errors import InputError
from machopt.model.rigid import Dynamics, load_dynamics

Predicted = Literal["link", "tip", "torque"]
WORDS: dict[Predicted, str] = {
    "link": "link-side against motor-side joint position",
    "tip": "tracked position of the TCP",
    "torque": "joint torque by rigid-body dynamics from the URDF's inertias",
}
LONG = 600.0  # s; heat needs ten minutes to show


def channels(recording: Recording, cell: Cell) -> tuple[Predicted, ...]:
    """Which channels can be predicted and compared, the one that shows most first."""
    out: list[Predicted] = []
    other = recording.q_secondary
    if other is not None and any(np.isfinite(x).all() and np.ptp(x) > 1e-6 for x in other.T):
        out.append("link")
    if recording.position is not None and len(cell.arm_joints) == 6:
        out.append("tip")
    if recording.torque is not None and _dynamics(cell) is not None:
        out.append("torque")
    return tuple(out)


def build(
    recording: Recording, cell: Cell, channel: Predicted, rng: np.random.Generator, *, repeats: bool = True
) -> tuple[Problem, Catalogue, tuple[str, ...], tuple[Finding, ...]]:
    """Equations of one channel of a motion, and what may explain what they leave.

    Args:
        recording: of kind motion.
        cell: with the URDF; of its chain only the arm joints count.
        channel: one of :func:`channels`.
        rng: not used by these channels, which leave nothing to chance.
        repeats: hold a phase of a motion that repeats out of all periods at once; False: stretches of time alone.

    Returns:
        Problem, catalogue, notes for the reader, and findings about the record.

    Raises:
        InputError: the signals that the channel needs are missing or make no sense.
    """
    n = min(len(cell.arm_joints), recording.q.shape[1])
    recording, found = motion_checks.units(recording, n)
    warnings = motion_checks.quality(recording, n)
    motion = signals(recording, n, repeats=repeats)
    dynamics = _dynamics(cell)
    predicted: Array | None = None if dynamics is None else dynamics.torque(motion.q, motion.v, motion.a)
    if predicted is not None and channel == "torque":
        recording, more, words = motion_checks.torque_side(recording, motion, predicted)
        found += more
        warnings += words
    prismatic = tuple(dynamics is not None and dynamics.prismatic(j) for j in range(n))
    scene = Scene(
        recording, cell, motion, dynamics, predicted, n, one_joint(motion, n), prismatic, notes=[*motion.notes]
    )
    scene.notes.extend(warnings)
    if channel == "torque":
        problem, catalogue = motion_torque.build(scene)
    elif channel == "link":
        joints = motion_link.seen(scene)
        scene = Scene(recording, cell, motion, dynamics, predicted, len(joints), one_joint(motion, len(joints), joints),
                      prismatic, notes=scene.notes)  # fmt: skip
        problem, catalogue = motion_link.build(scene, joints)
    else:
        from machopt.model.robot import load_robot

        if n != 6:
            raise InputError(f"{recording.source}: a tracked TCP needs an arm of six joints; the cell has {n}")
        problem, catalogue, more = motion_tip.build(scene, load_robot(cell))
        found += more
    if channel != "tip":
        found += motion_checks.servo_lag(recording, n)
    missing = [*catalogue.untestable]
    if float(np.ptp(motion.time)) < LONG:
        missing.append(
            Untestable("thermal_drift", "environment", f"{np.ptp(motion.time):.0f} s are too short for heat")
        )
    if recording.q_command is None and channel != "tip":
        missing.append(Untestable("servo_lag", "controller", "the commanded joints are not recorded"))
    return problem, Catalogue(catalogue.hypotheses, tuple(missing), catalogue.axes), tuple(scene.notes), tuple(found)


def _dynamics(cell: Cell) -> Dynamics | None:
    """The arm's dynamics; None where the URDF has no inertias."""
    try:
        return load_dynamics(cell)
    except InputError as error:
        if "inertial" in error.reason:
            return None
        raise

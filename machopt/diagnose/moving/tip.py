"""A tracked TCP in motion: y = measured position − forward kinematics of the joints that were commanded.

Where no command is recorded the encoders take its place. Refitted in any case: the tracker's frame (6), the target in
the tool (3), and the compliance of each joint under the torque it carries. The problem is posed at the loaded
equilibrium of a first fit, so that deflections of a millimetre do not show as curvature.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.laws.motion_frame import PowerTaken, Scene
from machopt.diagnose.moving import angles
from machopt.diagnose.moving.checks import sign_test
from machopt.diagnose.moving.clock import clocks, followers, valley
from machopt.diagnose.moving.gears import drive, gear_laws, known
from machopt.diagnose.moving.masses import heldout
from machopt.diagnose.moving.torque import motion_axes
from machopt.diagnose.nouns.problem import (
    Catalogue,
    Family,
    Hypothesis,
    Problem,
    RecordCorrection,
    Unknown,
    Untestable,
)
from machopt.diagnose.nouns.result import Estimate, Finding
from machopt.domain.location import joint_at
from machopt.domain.parameters import joint_spring
from machopt.effects.delay import CLOCK, LAG
from machopt.errors import InputError
from machopt.model.robot import Robot
from machopt.se3 import skew as cross

ROUNDS = 3


def build(scene: Scene, robot: Robot) -> tuple[Problem, Catalogue, list[Finding]]:
    """Equations and catalogue of the channel tip.

    Raises:
        InputError: no tracked position.
    """
    m, rec, cell = scene.motion, scene.recording, scene.cell
    if rec.position is None:
        raise InputError(f"{rec.source}: the channel tip needs x_mm, y_mm, z_mm")
    T_tool = cell.tool.T_flange_tcp
    commanded = rec.q_command is not None
    asked = m.q if rec.q_command is None else np.ascontiguousarray(rec.q_command[m.index, :6])
    scene.notes.append("the TCP is predicted from the " + ("commanded joints" if commanded else "encoders"))
    measured = rec.position[m.index]
    lag = delays(scene, asked) if commanded else np.zeros(6)
    asked = scene.true_angles(asked)
    # Jacobians and attitudes where the arm really was: at the encoders' joints
    pose = _Pose(robot, T_tool, scene.true_angles(m.q), np.zeros_like(m.q))
    tip = robot.fk(asked, T_tool)[:, :3, 3]
    followed = pose.p - tip  # what the encoders say about following the command

    found = drive(scene)
    load = None if found is None else found.load
    unknowns = [Unknown(name=f"registration {a}", unit="m", location="sensor:position") for a in "xyz"]
    unknowns += [Unknown(name=f"registration turn {a}", unit="rad", location="sensor:position") for a in "xyz"]
    unknowns += [Unknown(name=f"target {a}", unit="m", location="tool") for a in "xyz"]
    untestable: list[Untestable] = []
    y_fine = measured - tip
    if found is not None and load is not None:
        scene.notes.append(f"gears are loaded by the {found.words}")
        unknowns += [
            Unknown(name=f"compliance {j}", unit="rad/(N·m)", lower=0.0, location=joint_at(j), key=joint_spring(j))
            for j in range(1, 7)
        ]
        y_fine, pose = _loaded(scene, pose, measured - tip, load, followed)
    else:
        untestable.append(Untestable("joint_backlash", "arm", "neither torques nor inertias are known"))
    y, base = m.within(m.mean(y_fine)), scene.everywhere(pose.columns(load))
    if load is not None:
        for j in range(6) if scene.known else ():
            y = y - scene.everywhere(pose.J[:, :, j] * known(scene, j, load[:, j])[:, None])
    problem = scene.problem(
        "position",
        y,
        base,
        unknowns,
        Family(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3, stated=rec.uncertainty.displacement),
    )

    def lift(joint: int, x: Array) -> Array:
        return scene.everywhere(pose.J[:, :, joint, None] * x[:, None, :])

    scene = replace(scene, lift=lift)
    out: list[Hypothesis] = []
    inertia = None if scene.dynamics is None else scene.dynamics.own_inertia(m.q)
    fit = PowerTaken(y, base, np.ones(3))
    for j in range(6):
        if load is not None:
            out += gear_laws(scene, j, load[:, j], None if inertia is None else inertia[:, j], fit)
        laws, taken_up = angles.hypotheses(scene, j, fit)
        out += laws
        untestable += taken_up

    def late(d: float) -> Array:
        return m.within(m.mean(m.late(tip, d) - tip))

    best = valley(lambda d: fit.misfit(late(d)))
    out += clocks(scene, "position", late, best, penalty=1.0 if commanded else 0.0)
    if commanded:
        out += _servo(scene, fit, robot, asked, followed, lag)
    else:
        untestable.append(Untestable(LAG.name, LAG.places[0], "the commanded joints are not recorded"))
    return (
        problem,
        Catalogue(tuple(out), tuple(untestable), motion_axes(scene)),
        _late_encoders(y, base, scene, followed, lag),
    )


class _Pose:
    """The arm at joints q bent by b: position, Jacobian, and the columns of the base there."""

    def __init__(self, robot: Robot, T_tool: Array, q: Array, bent: Array) -> None:
        state = robot.state(q + bent, T_tool)
        self.robot, self.T_tool, self.q, self.bent = robot, T_tool, q, bent
        self.p, self.R = state.T_base_tool[:, :3, 3], state.T_base_tool[:, :3, :3]
        self.J = state.J[:, :3]

    def columns(self, load: Array | None) -> Array:
        """(M, 3, P): registration, target, and the compliances under ``load``."""
        parts = [np.broadcast_to(np.eye(3), (len(self.p), 3, 3)), -cross(self.p), self.R]
        if load is not None:
            parts.append(self.J * load[:, None, :])
        return np.concatenate(parts, axis=2)


def _loaded(scene: Scene, pose: _Pose, y: Array, load: Array, followed: Array) -> tuple[Array, _Pose]:
    """Measured less nominal (M, 3) at the loaded equilibrium, such that columns still carry their whole coefficients.

    f(q + b) − f(q) is curved in b = c τ. What J b at the bent arm says beyond it is put to the measured side.
    """
    m, straight, y_fine = scene.motion, pose.p, y
    for _ in range(ROUNDS):
        X = scene.everywhere(np.concatenate([pose.columns(load), followed[:, :, None]], axis=2))
        A = X.reshape(-1, X.shape[2])
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x = np.linalg.lstsq(A / size, m.within(m.mean(y_fine)).reshape(-1), rcond=1e-10)[0] / size
        pose = _Pose(pose.robot, pose.T_tool, pose.q, load * np.clip(x[9:15], 0.0, None))
        y_fine = y - (pose.p - straight) + np.einsum("nci,ni->nc", pose.J, pose.bent)
    return y_fine, pose


def delays(scene: Scene, asked: Array) -> Array:
    """(n,) s by which each encoder follows its command; 0 where it stays with it."""
    m = scene.motion
    speed = m.differentiate(asked)
    out = np.zeros(asked.shape[1])
    for j in range(asked.shape[1]):
        behind = asked[:, j] - m.q[:, j]
        if np.std(behind) > calibrated.MOTION.follows and np.ptp(asked[:, j]) > calibrated.MOTION.moves:
            x = np.stack([speed[:, j], np.ones(len(behind))], axis=1)
            out[j] = float(np.linalg.lstsq(x, behind, rcond=None)[0][0])
    return out


def _late_encoders(y: Array, base: Array, scene: Scene, followed: Array, lag: Array) -> list[Finding]:
    """Encoders that lag the command while the TCP does not: their clock, not the arm."""
    moving = lag[np.abs(lag) > 0]
    if not len(moving) or abs(float(np.mean(moving))) < calibrated.MOTION.late_s:
        return []
    own = scene.everywhere(followed[:, :, None])
    X = np.concatenate([base, own], axis=2).reshape(-1, base.shape[2] + 1)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    share = float((np.linalg.lstsq(X / size, y.reshape(-1), rcond=1e-10)[0] / size)[-1])
    if share > calibrated.MOTION.followed or np.std(moving) > calibrated.MOTION.alike * abs(float(np.mean(moving))):
        return []
    late, sigma = 1e3 * float(np.mean(moving)), 1e3 * float(np.std(moving)) / np.sqrt(len(moving))
    # predicted from the encoders as recorded, and with their clock put right, which is from the command
    group, even = scene.motion.group, np.ones(3)
    count = 3.0 * np.unique(group, return_counts=True)[1]
    before, after = (1e3 * np.sqrt(heldout(e, base, group, even) / count) for e in (y - own[:, :, 0], y))
    return [
        Finding(
            effect=CLOCK.name,
            location="sensor:q",
            law=CLOCK.delays[0].name,
            equation="q_recorded(t) = q(t − d)",
            note="in proportion to speed",
            one_of=((CLOCK.name, "sensor:q"),),
            parameters={
                "late": Estimate(
                    late, "ms", (late - 1.645 * sigma, late + 1.645 * sigma), (late - 1.96 * sigma, late + 1.96 * sigma)
                )
            },
            before=float(np.median(before)),
            after=float(np.median(after)),
            p_value=sign_test(before, after),
            correction=RecordCorrection(CLOCK.name, "sensor:q", {"late_ms": late}),
            record=True,
        )
    ]


def _servo(scene: Scene, fit: PowerTaken, robot: Robot, asked: Array, followed: Array, lag: Array) -> list[Hypothesis]:
    """The arm follows its command late: as the encoders show it, and as one delay of all joints."""
    m = scene.motion
    T_tool = scene.cell.tool.T_flange_tcp
    tip = robot.fk(asked, T_tool)[:, :3, 3]

    def late(d: float) -> Array:
        return m.within(m.mean(robot.fk(m.late(asked, d), T_tool)[:, :3, 3] - tip))

    best = valley(lambda d: fit.misfit(late(d)))
    return followers(scene, late, best, scene.everywhere(followed[:, :, None]), lag)

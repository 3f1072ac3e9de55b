"""How the foreign lab loads an arm: habits, poses and loads that it goes through, and how the nominal arm moves."""

from __future__ import annotations

from dataclasses import dataclass

import dual_quaternions as dq
import elastic_arm
import numpy as np
from dual_quaternions import Array
from instrument_noise import Instrument
from robot_models import SPREAD, Robot

DISPLACEMENT = Instrument(0.010, 0.010)  # mm
ROTATION = Instrument(0.02, 0.015)  # mrad


@dataclass(frozen=True)
class Lab:
    """Habits of one laboratory."""

    name: str
    poses: int = 16
    sessions: int = 2
    cycles: int = 1  # a direction and session
    directions: int = 3
    up: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0)
    down: tuple[float, ...] = (0.75, 0.5, 0.25)
    both_signs: bool = True
    mirrored: bool = False  # the second day pulls where the first pushed: nothing is repeated but its mirror image
    turning: bool = False  # rotations recorded too
    moments: str = "none"  # none: no columns; noise: pull through the TCP, columns hold noise; lever: a hook beside it
    wrench_frame: str = "base"
    displacement_frame: str = "base"
    displacement: Instrument = DISPLACEMENT
    rotation: Instrument = ROTATION
    force: float = 0.004  # 1 sigma of a reading, share of the largest
    session_gain: float = 0.002
    stated: bool = True
    clock: bool = True
    branch: bool = True
    outliers: float = 0.0
    hold: float = 15.0  # s a load
    strength: float = 1.0  # of the loads


LABS = {
    lab.name: lab
    for lab in (
        Lab("plain"),
        Lab("full", turning=True, moments="lever", poses=14),
        Lab("through_tcp", moments="noise"),
        Lab("through_tcp_6", moments="noise", turning=True, poses=14),
        Lab("one_day", sessions=1, cycles=2, clock=False),
        Lab("no_repeats", sessions=1, cycles=1, down=(), branch=False, poses=24, up=(0.5, 1.0)),
        Lab("mirrored", mirrored=True),
        Lab("twelve", poses=12, sessions=2, cycles=1),
        Lab("crude", displacement=Instrument(0.018, 0.012, tails=4.0, step=0.01), outliers=0.01),
        Lab("wandering", displacement=Instrument(0.012, 0.010, wander=0.4), stated=False),
        Lab("tool_axes", wrench_frame="tool", displacement_frame="tool", moments="lever", turning=True),
        Lab("mixed_axes", wrench_frame="tool", moments="none", poses=20, directions=2, cycles=2),
        Lab("weights", both_signs=False, directions=1, cycles=3, poses=22, stated=False, strength=0.5),
    )
}
DISTURBED = ("crude", "wandering", "no_repeats", "twelve", "weights", "one_day")


class Rig:
    """An arm, as it is believed and as it is built, with the poses and loads of one load test."""

    def __init__(self, nominal: Robot, built: Robot, lab: Lab, rng: np.random.Generator) -> None:
        self.nominal, self.built, self.lab = nominal, built, lab
        self.script, self.zero, self.pose, self.shown, self.unloading = self._design(rng)
        rigid = elastic_arm.chain(
            elastic_arm.ElasticArm(nominal), self.script.q, {"joints": np.zeros_like(self.script.q)}
        )
        self.rigid = {k: v[self.shown] for k, v in rigid.items()}
        _, torque = elastic_arm.solve_rest_states(elastic_arm.ElasticArm(built), self.script)
        self.torque = torque
        self.swing = np.ptp(torque - torque[self.zero], axis=0)  # N·m by the loads

    def _design(self, rng: np.random.Generator) -> tuple[elastic_arm.Script, Array, Array, Array, Array]:
        lab, robot = self.lab, self.nominal
        spread = np.radians(SPREAD)
        poses = robot.home + rng.uniform(-1, 1, (lab.poses, 6)) * spread
        q5 = poses[:, 4]
        poses[:, 4] = np.where(np.abs(q5) < 0.15, np.sign(q5 + 1e-9) * 0.3, q5)
        largest = (
            lab.strength * 3.6e-3 / (robot.reach() ** 2 * np.mean(1.0 / robot.stiffness[:3]))
        )  # N for about a millimetre a coordinate
        lever = robot.reach() * rng.uniform(-0.08, 0.08, 3) if lab.moments == "lever" else np.zeros(3)
        rows: list[tuple[Array, Array, float, int, int, int, int, bool, bool]] = []
        clock, visit, cycle = 0.0, 0, 0
        frames = elastic_arm.chain(elastic_arm.ElasticArm(robot), poses, {"joints": np.zeros_like(poses)})
        tips = dq.matrix(frames["tcp"])
        axes = [self._axes(rng) for _ in range(lab.poses)]
        for session in range(lab.sessions):
            clock += 50000.0
            for pose in rng.permutation(lab.poses):
                clock += 90.0
                visit += 1
                for k in range(lab.directions * lab.cycles):
                    direction = axes[pose][k % lab.directions]
                    # repeats on another day keep their sign, unless the lab mirrors them
                    turns = k % lab.directions + pose
                    turns += k // lab.directions if lab.sessions > 1 else 0
                    turns += session if lab.mirrored else 0
                    sign = -1.0 if lab.both_signs and turns % 2 else 1.0
                    cycle += 1
                    first = len(rows)
                    steps = [(0.0, False), *((s, False) for s in lab.up), *((s, True) for s in lab.down)]
                    for share, back in steps:
                        force = sign * share * largest * direction
                        moment = np.cross(tips[pose] @ lever, force)
                        clock += lab.hold * rng.uniform(0.9, 1.1)
                        load = np.concatenate([force, moment])
                        rows.append((poses[pose], load, clock, visit, cycle, session, first, share > 0, back))
        q, w, t, v, c, s, zero, shown, back = (np.array(x) for x in zip(*rows, strict=True))
        self.largest = float(largest)
        pose_of = np.array([int(np.argmin(np.abs(poses - row).sum(axis=1))) for row in q])
        return elastic_arm.Script(q, w, t, v, c, s), zero, pose_of, shown, back

    def _axes(self, rng: np.random.Generator) -> list[Array]:
        """Three directions that are not square to each other, or one straight down where weights hang."""
        if self.lab.directions == 1:
            return [np.array([0.0, 0.0, -1.0])]
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        return [a / np.linalg.norm(a) for a in turn + 0.15 * rng.normal(size=(3, 3))]


def joint_columns(robot: Robot, rigid: dict[str, Array]) -> tuple[Array, Array]:
    """(N, 6, 3) motion of the TCP and its turning per rad of each joint, base axes."""
    tip = dq.place(rigid["tcp"])
    axes = np.stack([dq.matrix(rigid[f"link{i}"]) @ robot.axes[i] for i in range(6)], axis=1)
    arms = np.stack([tip - dq.place(rigid[f"link{i}"]) for i in range(6)], axis=1)
    return np.cross(axes, arms), axes

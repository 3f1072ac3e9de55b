"""The written program, read back by code that its writer does not share, against the motion it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.program import LIN, Controller, RobotProgram
from machopt.errors import InputError
from machopt.formats.programs import ParsedProgram, read_program
from machopt.formats.programs.joints import urdf_joints
from machopt.model.robot import Robot

Array = NDArray[np.float64]
URDF_JOINTS = ("csv", "json", "ros")  # dialects whose angles no joint map touches
POSITION = 5e-6  # m: angles printed to 1e-4° move a tool four metres away by that much
ANGLE = float(np.radians(2e-3))
FEED = 5.1e-5  # m/s: tenths of mm/s are the coarsest print


@dataclass(frozen=True)
class ReadBack:
    """What came back; errors are the largest over all moves."""

    file: str
    moves: int
    position_error: float  # m of the tool tip, joint targets through forward kinematics
    angle_error: float  # rad
    feed_error: float  # m/s on linear moves; NaN where the format has no feeds
    differences: tuple[str, ...]  # anything that is not as it should be, in words

    @property
    def ok(self) -> bool:
        return not self.differences


def read_back(program: RobotProgram, controller: Controller, file: Path, robot: Robot) -> ReadBack:
    """Compare a program with the file that was written from it, move by move.

    Args:
        program: what was written.
        controller: what the post was told.
        file: the first of the written files.
        robot: for the places of joint targets.

    Invalid for: what the controller makes of the program; only that it says what it should.
    """
    nan = float("nan")
    pulses = None if controller.pulses_per_deg is None else controller.pulses_per_deg.tolist()
    try:
        parsed = read_program(file, pulses_per_deg=pulses)
    except InputError as problem:
        return ReadBack(file.name, 0, nan, nan, nan, (f"cannot be read back: {problem}",))
    if len(parsed) != len(program):
        difference = f"{len(parsed)} moves instead of {len(program)}"
        return ReadBack(file.name, len(parsed), nan, nan, nan, (difference,))
    wrong: list[str] = []
    if (parsed.kind != program.kind).any():
        wrong.append(f"move {int(np.argmax(parsed.kind != program.kind)) + 1} is of another kind")
    T = _placed(parsed, program, controller, robot)
    gap = np.linalg.norm(T[:, :3, 3] - program.T_workpiece_tcp[:, :3, 3], axis=1)
    chord = np.linalg.norm(T[:, :3, :3] - program.T_workpiece_tcp[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
    turn = 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))
    if not (gap <= POSITION).all():  # a NaN is a difference too
        wrong.append(f"move {int(np.argmax(~(gap <= POSITION))) + 1} goes elsewhere")
    if not (turn <= ANGLE).all():
        wrong.append(f"move {int(np.argmax(~(turn <= ANGLE))) + 1} turns elsewhere")
    linear = program.kind == LIN
    known = linear & np.isfinite(parsed.feed)
    feed = np.abs(parsed.feed - program.feed)[known]
    if known.any() and (not known[linear].all() or (feed > FEED).any()):
        wrong.append("a feed differs")
    if [(e.index, e.text) for e in parsed.events] != [(e.index, _told(e.text, parsed)) for e in program.events]:
        wrong.append("events differ")
    return ReadBack(
        file.name, len(parsed), float(gap.max()), float(turn.max()), float(feed.max()) if known.any() else nan,
        tuple(wrong),
    )  # fmt: skip


def _placed(parsed: ParsedProgram, program: RobotProgram, controller: Controller, robot: Robot) -> Array:
    """(M, 4, 4) tool in workpiece, of joint targets through the robot's forward kinematics."""
    T = parsed.T_base_tcp.copy()
    joint = ~parsed.has_pose
    if joint.any():
        m = controller.joint_map
        mapped = m is not None and parsed.dialect not in URDF_JOINTS
        axes = parsed.axes_deg[joint]
        q = urdf_joints(axes, m.sign, m.offset_deg, m.coupling) if mapped and m is not None else np.radians(axes)
        T[joint] = np.linalg.inv(program.T_base_workpiece) @ robot.fk(q, program.T_flange_tcp)
    return T


def _told(text: str, parsed: ParsedProgram) -> str:
    """An event's text as far as the program's comments have room for it."""
    plain = " ".join(text.split())
    return next((e.text for e in parsed.events if e.text and plain.startswith(e.text)), plain)

"""The written program, read back by code that its writer does not share, against the motion it was made from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.program import LIN, Controller, RobotProgram
from machopt.errors import InputError
from machopt.formats.posts.densify import Tolerance, departure
from machopt.formats.programs import ParsedProgram, read_program
from machopt.formats.programs.configuration import first_difference
from machopt.formats.programs.joints import urdf_joints
from machopt.formats.programs.toolpath import URDF_JOINTS
from machopt.job.program import Programmed
from machopt.model.robot import Robot
from machopt.se3 import inverse

Array = NDArray[np.float64]
POSITION = 5e-6  # m: angles printed to 1e-4° move a tool four metres away by that much
ANGLE = float(np.radians(2e-3))
PULSES = 3.0  # of an encoder: joints may be off by that much, by rounding and by coupling
FEED = 5.1e-5  # m/s: tenths of mm/s are the coarsest print
FRAME = 1e-6  # m: frames are printed to 1e-3 mm at least, FANUC's in a comment only
NAN = float("nan")


@dataclass(frozen=True)
class ReadBack:
    """What came back; errors are the largest over all moves."""

    file: str
    moves: int
    differences: tuple[str, ...]  # anything that is not as it should be, in words
    position_error: float = NAN  # m of the tool tip, joint targets through forward kinematics
    angle_error: float = NAN  # rad
    joint_error: float = NAN  # rad of joint targets; NaN where the program has none
    feed_error: float = NAN  # m/s on linear moves; NaN where the format has no feeds
    path_error: float = NAN  # m between the motion and the lines the controller draws; NaN where it draws none
    axis_error: float = NAN  # rad, the same between tool axes
    turn_error: float = NAN  # rad, the same between orientations
    configurations: int = 0  # moves whose status, turns or confdata were counted again
    configuration_equal: bool = False
    events_equal: bool = False

    @property
    def ok(self) -> bool:
        return not self.differences

    def as_result(self) -> dict[str, object]:
        """For result.json: mm, deg, mm/min; null where a post has no such thing."""
        return {
            "moves": self.moves,
            "positions_max_mm": self.position_error * 1e3,
            "orientations_max_deg": float(np.degrees(self.angle_error)),
            "joints_max_deg": float(np.degrees(self.joint_error)),
            "feeds_max_mm_min": self.feed_error * 6e4,
            "path_max_mm": self.path_error * 1e3,
            "path_axis_max_deg": float(np.degrees(self.axis_error)),
            "path_turn_max_deg": float(np.degrees(self.turn_error)),
            "configuration_equal": self.configuration_equal if self.configurations else None,
            "events_equal": self.events_equal,
        }


def read_back(
    made: Programmed, controller: Controller, file: Path, robot: Robot, motion: Array, tolerance: Tolerance,
    forbidden: str = "",
) -> ReadBack:  # fmt: skip
    """Compare a program with the motion it was written from, move by move and sample by sample.

    Args:
        made: what was written.
        controller: what the post was told.
        file: the first of the written files.
        robot: for the places of joint targets and samples.
        motion: (S, 6) rad, the exported trajectory.
        tolerance: how far the controller's straight lines may be from it.
        forbidden: characters that the post takes out of free text.

    Invalid for: what the controller makes of the program; only that it says what it should.
    """
    program = made.program
    pulses = None if controller.pulses_per_deg is None else controller.pulses_per_deg.tolist()
    try:
        parsed = read_program(file, pulses_per_deg=pulses)
    except InputError as problem:
        return ReadBack(file.name, 0, (f"cannot be read back: {problem}",))
    if len(parsed) != len(program):
        return ReadBack(file.name, len(parsed), (f"{len(parsed)} moves instead of {len(program)}",))
    wrong: list[str] = []

    def told(bad: NDArray[np.bool_], what: str) -> None:
        if bad.any():
            k = int(np.argmax(bad))
            wrong.append(f"move {k + 1} (line {int(parsed.line[k])}) {what}")

    told(parsed.kind != program.kind, "is of another kind")
    q, T = _placed(parsed, program, controller, robot)
    joint = np.isfinite(q).all(axis=1)
    off = np.where(joint, np.abs(q - program.q).max(axis=1), 0.0)
    coarse = PULSES / min(map(abs, pulses)) if pulses and parsed.dialect == "jbi" else 0.0
    lever = float(np.radians(coarse)) * 6.0  # of six joints
    gap = np.linalg.norm(T[:, :3, 3] - program.T_workpiece_tcp[:, :3, 3], axis=1)
    turn = _angle(T, program.T_workpiece_tcp)
    told(~(gap <= POSITION + lever * 5.0), "goes elsewhere")  # five metres away; a NaN is a difference too
    told(~(turn <= ANGLE + lever), "turns elsewhere")
    told(~(off <= ANGLE + lever), "goes there with other joints")
    feed = _feeds(parsed, program, wrong)
    _frames(parsed, program, controller, wrong)
    told_of, first = first_difference(
        parsed.dialect, parsed.configuration, _axes(program, controller),
        None if program.behind is None or program.elbow_up is None else (program.behind, program.elbow_up),
        controller.nonflip_j5,
    )  # fmt: skip
    if first is not None:
        wrong.append(f"move {first + 1} (line {int(parsed.line[first])}) names another configuration")
    events = _events_equal(parsed, program, forbidden)
    if not events:
        wrong.append("events differ")
    path, axis, whole = _along(T, made, robot, motion, tolerance, wrong)
    return ReadBack(
        file.name, len(parsed), tuple(wrong), float(gap.max()), float(turn.max()),
        float(off[joint].max()) if joint.any() else NAN, feed, path, axis, whole, told_of, first is None, events,
    )  # fmt: skip


def _along(
    T: Array, made: Programmed, robot: Robot, motion: Array, tolerance: Tolerance, wrong: list[str]
) -> tuple[float, float, float]:
    """Largest departures (m, rad, rad) of the trajectory from the lines as they were read."""
    program = made.program
    samples = np.linalg.inv(program.T_base_workpiece) @ robot.fk(motion, program.T_flange_tcp)
    off = departure(samples, T, made.at, program.kind == LIN)
    if not len(off.sample):
        return NAN, NAN, NAN
    share = off.share(tolerance)
    worst = int(np.argmax(~(share <= 1.0)))
    if not share[worst] <= 1.0:
        wrong.append(
            f"on its way to move {int(off.move[worst]) + 1} the controller's straight line leaves the motion: "
            f"{1e3 * off.position[worst]:.3f} mm, tool axis {np.degrees(off.axis[worst]):.3f} deg, "
            f"orientation {np.degrees(off.turn[worst]):.3f} deg"
        )
    return off.worst()


def _feeds(parsed: ParsedProgram, program: RobotProgram, wrong: list[str]) -> float:
    linear = program.kind == LIN
    known = linear & np.isfinite(parsed.feed)
    if not known.any():
        return NAN
    feed = np.abs(parsed.feed - program.feed)[known]
    if not known[linear].all() or (feed > FEED).any():
        wrong.append("a feed differs")
    return float(feed.max())


def _frames(parsed: ParsedProgram, program: RobotProgram, controller: Controller, wrong: list[str]) -> None:
    """Tool and base, where the program gives their numbers."""
    own = parsed.dialect in URDF_JOINTS  # of the URDF, whatever the cell says of its controller
    root = np.eye(4) if own or controller.T_base_root is None else controller.T_base_root
    mount = np.eye(4) if own or controller.T_flange_mount is None else controller.T_flange_mount
    pose = parsed.has_pose
    for frames, wanted, name in (
        ([parsed.bases[k] for k in np.unique(parsed.base[pose])], inverse(root) @ program.T_base_workpiece, "base"),
        ([parsed.tools[k] for k in np.unique(parsed.tool[pose])], inverse(mount) @ program.T_flange_tcp, "tool"),
    ):
        for frame in frames:
            if frame.T is None:
                continue
            gap, turn = np.linalg.norm(frame.T[:3, 3] - wanted[:3, 3]), float(_angle(frame.T, wanted))
            if not (gap <= FRAME and turn <= ANGLE):
                wrong.append(f"the {name} frame {frame.name} lies elsewhere")


def _placed(
    parsed: ParsedProgram, program: RobotProgram, controller: Controller, robot: Robot
) -> tuple[Array, Array]:  # fmt: skip
    """Joints (M, 6), NaN where the target is a pose only, and tool in workpiece (M, 4, 4).

    Targets without a pose are taken through the robot's forward kinematics.
    """
    T = parsed.T_base_tcp.copy()
    m = controller.joint_map
    mapped = m is not None and parsed.dialect not in URDF_JOINTS
    axes = parsed.axes_deg
    q = urdf_joints(axes, m.sign, m.offset_deg, m.coupling) if mapped and m is not None else np.radians(axes)
    joint = ~parsed.has_pose
    if joint.any():
        T[joint] = np.linalg.inv(program.T_base_workpiece) @ robot.fk(q[joint], program.T_flange_tcp)
    return q, T


def _axes(program: RobotProgram, controller: Controller) -> Array:
    """(M, 6) deg as the controller counts them: C (sign · q + offset), added up here axis by axis."""
    m = controller.joint_map
    degrees = np.degrees(program.q)
    if m is None:
        return np.asarray(degrees)
    out = np.empty_like(degrees)
    for k in range(6):
        out[:, k] = m.sign[k] * degrees[:, k] + m.offset_deg[k]
    plain = out.copy()
    for k, j in zip(*np.nonzero(m.coupling), strict=True):
        out[:, k] += m.coupling[k, j] * plain[:, j]
    return out


def _angle(T0: Array, T1: Array) -> Array:
    """Angle between orientations (..., 4, 4), exact for small ones."""
    chord = np.linalg.norm(T0[..., :3, :3] - T1[..., :3, :3], axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))


def _events_equal(parsed: ParsedProgram, program: RobotProgram, forbidden: str) -> bool:
    """The same events before the same moves; texts as far as a program's comments can hold them."""

    def kept(text: str) -> str:
        return "".join(c for c in text if c.isascii() and c not in f" ?<>&{forbidden}")

    if len(parsed.events) != len(program.events):
        return False
    for read, written in zip(parsed.events, program.events, strict=True):
        back, text = kept(read.text), kept(written.text)
        if read.index != written.index or not text.startswith(back) or bool(text) != bool(back):
            return False
    return True

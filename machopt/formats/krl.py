"""KUKA robot programs: ``name.src`` and ``name.dat`` for KSS 8.

Conventions. Poses are ``{X,Y,Z,A,B,C}`` in mm and degrees with R = Rz(A) Ry(B) Rx(C). The program begins
with an axis PTP and gives every PTP as axes, so that no configuration is left to the controller. S and T
stand on the LIN targets for whoever turns one into a PTP; KSS reads them on PTP only. How they are read here
(documents disagree; this reading agrees with points recorded on robots, such as S 2,T 35 and S 6,T 50):

* T, bit i: axis i+1 stands below 0°.
* S, bit 0: the wrist root point lies behind A1 (its x in the frame that turns with A1 is negative).
* S, bit 1: A3 is above the angle at which the arm is stretched (0° where axes 3 and 4 meet): elbow up.
* S, bit 2: A5 is below 0°.

Bits 0 and 1 need the arm's lengths (:class:`ArmLengths`); without them S is left out, never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PTP, LIN = 0, 1
MOVES_PER_DEF = 4000
"""Longest DEF written; beyond it the moves go into numbered local DEFs."""

_XYZ, _ABC, _AXIS, _EXTERNAL = 4, 5, 5, 4  # decimals; KRL's REAL is single precision, seven digits
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")


@dataclass(frozen=True)
class JointMap:
    """Axis angles of the controller from joint positions of the URDF: A = sign · deg(q) + offset_deg."""

    sign: Array = field(default_factory=lambda: np.ones(6))  # (6,) ±1
    offset_deg: Array = field(default_factory=lambda: np.zeros(6))  # (6,)

    def axes_deg(self, q: Array) -> Array:
        """(..., 6) degrees as the controller counts them, from q (..., 6) rad."""
        return self.sign * np.degrees(q) + self.offset_deg


@dataclass(frozen=True)
class ArmLengths:
    """The arm in its own plane, in m, as KUKA data sheets draw it at A2 = −90°, A3 = 90°."""

    shoulder: float  # axis 1 to axis 2, horizontally
    upper_arm: float  # axis 2 to axis 3
    forearm: float  # axis 3 to the wrist root, along axis 4
    elbow: float = 0.0  # axis 3 to axis 4, positive where axis 4 lies above axis 3 with the forearm level


@dataclass(frozen=True)
class RobotProgram:
    """A motion program as any post takes it: M moves in order, SI, joints as the URDF counts them.

    The first move must be a PTP. ``T_base_workpiece`` holds with the external axes at zero.
    """

    kind: NDArray[np.int8]  # (M,) PTP or LIN
    q: Array  # (M, 6) rad, at the end of the move
    T_workpiece_tcp: Array  # (M, 4, 4), at the end of the move
    feed: Array  # (M,) m/s of the TCP on LIN moves; NaN on PTP
    cutting: NDArray[np.bool_]  # (M,)
    operation: NDArray[np.int32]  # (M,) index into ``operations``, −1 for none
    operations: tuple[str, ...]
    T_flange_tcp: Array  # (4, 4)
    T_base_workpiece: Array  # (4, 4), workpiece in the robot's base_link
    external: Array = field(default_factory=lambda: np.empty((0, 0)))  # (M, E) rad or m
    external_prismatic: tuple[bool, ...] = ()  # (E,)
    events: tuple[tuple[int, str], ...] = ()  # (move it comes before, source words)
    ptp_speed: float = 0.8  # share of the axis velocity limits on PTP moves
    blend: float = 0.0  # m, corner rounding allowed between cutting moves; 0 stops exactly at every point
    source: str = ""  # what it was made from, for the head comment

    def __post_init__(self) -> None:
        if len(self.kind) == 0 or self.kind[0] != PTP:
            raise ValueError("a robot program begins with a PTP move")
        if not (self.feed[self.kind == LIN] >= 1e-6).all():
            raise ValueError("every LIN move needs a feed of at least 1e-6 m/s, the last digit of $VEL.CP")
        if len(self.external_prismatic) != (self.external.shape[1] if self.external.size else 0):
            raise ValueError("external_prismatic needs one entry for each column of external")

    def __len__(self) -> int:
        return len(self.kind)


def write_krl(
    folder: Path, name: str, program: RobotProgram,
    *, joint_map: JointMap | None = None, arm: ArmLengths | None = None,
) -> tuple[Path, Path]:  # fmt: skip
    """Write ``name.src`` and ``name.dat`` into ``folder`` and return their paths.

    Args:
        folder: existing folder.
        name: module name: a letter, then letters, digits and underscores, 24 characters at most.
        program: the moves.
        joint_map: sign and zero of each axis; identity by default.
        arm: lengths that decide S; without them S is not written.

    Raises:
        ValueError: KRL cannot have a module of that name.
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no KRL module name: a letter, then letters, digits, _, at most 24")
    joint_map = joint_map or JointMap()
    axes = joint_map.axes_deg(program.q)
    src, dat = folder / f"{name}.src", folder / f"{name}.dat"
    _save(dat, _dat_lines(name, program))
    _save(src, _src_lines(name, program, axes, arm))
    return src, dat


def krl_name(text: str) -> str:
    """The nearest name KRL takes for ``text``: ``"2nd op-A"`` becomes ``p2nd_op_A``."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    return (name if name[:1].isalpha() else f"p{name}")[:24]


def abc_deg(R: Array) -> Array:
    """A, B, C in degrees (..., 3) of rotations (..., 3, 3): R = Rz(A) Ry(B) Rx(C); A = 0 where |B| = 90°."""
    R = np.asarray(R, float)
    cos_b = np.hypot(R[..., 0, 0], R[..., 1, 0])
    b = np.arctan2(-R[..., 2, 0], cos_b)
    upright = cos_b < 1e-9
    a = np.where(upright, 0.0, np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    c = np.where(upright, np.arctan2(-R[..., 1, 2], R[..., 1, 1]), np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    abc: Array = np.degrees(np.stack([a, b, c], axis=-1))
    return abc


def turn_bits(axes_deg: Array) -> NDArray[np.int64]:
    """T (...,) of axes (..., 6) in the controller's degrees: bit i set where axis i+1 is below 0°."""
    return np.asarray((np.asarray(axes_deg) < 0.0) @ (1 << np.arange(6)), dtype=np.int64)


def status_bits(axes_deg: Array, arm: ArmLengths) -> NDArray[np.int64]:
    """S (...,) of axes (..., 6) in the controller's degrees, as the head of this file reads it."""
    a2, a3 = np.radians(axes_deg[..., 1]), np.radians(axes_deg[..., 2])
    forward = arm.shoulder + arm.upper_arm * np.cos(a2)
    forward = forward + arm.forearm * np.cos(a2 + a3) + arm.elbow * np.sin(a2 + a3)
    stretched = math.atan2(arm.elbow, arm.forearm)  # A3 at which wrist root, elbow and shoulder are in line
    bits = [forward < 0.0, np.sin(a3 - stretched) > 0.0, axes_deg[..., 4] < 0.0]
    return np.asarray(sum(bit.astype(np.int64) << i for i, bit in enumerate(bits)))


def _dat_lines(name: str, program: RobotProgram) -> Iterator[str]:
    yield "&ACCESS RVP"
    yield f"DEFDAT {name} PUBLIC"
    yield "EXT BAS (BAS_COMMAND :IN,REAL :IN )"
    yield "; tool centre point in the flange, cell key tool.tcp"
    yield f"DECL FRAME MO_TOOL={_frame(program.T_flange_tcp)}"
    yield "; workpiece (frame of the CAM coordinates) in the robot's base_link"
    yield f"DECL FRAME MO_BASE={_frame(program.T_base_workpiece)}"
    yield "ENDDAT"


def _src_lines(name: str, program: RobotProgram, axes: Array, arm: ArmLengths | None) -> Iterator[str]:
    """Head, set-up and moves; more than one DEF's worth of moves goes into numbered local DEFs."""
    moves = _targets(program, axes, arm)
    starts = range(0, len(program), MOVES_PER_DEF)
    subprograms = [f"{name[:20]}_{k + 1:03d}" for k in range(len(starts))]
    yield "&ACCESS RVP"
    yield f"DEF {name}( )"
    yield from _setup(program, arm)
    if len(starts) == 1:
        yield from _moves(program, moves, 0, len(program))
        yield "END"
        return
    yield from (f"{sub}( )" for sub in subprograms)
    yield "END"
    for sub, start in zip(subprograms, starts, strict=True):
        stop = min(start + MOVES_PER_DEF, len(program))
        yield ""
        yield f"DEF {sub}( )"
        yield f"; moves {start + 1} to {stop} of {len(program)}; run through the main program only"
        yield from _moves(program, moves, start, stop)
        yield "END"


def _setup(program: RobotProgram, arm: ArmLengths | None) -> Iterator[str]:
    yield f"; written by machopt{f' from {_comment(program.source)}' if program.source else ''}"
    yield f"; {len(program)} moves; lengths mm, angles deg, $VEL.CP m/s"
    yield "; $BASE is given from the robot root: where $ROBROOT is not zero, shift MO_BASE"
    if program.external_prismatic:
        yield "; MO_BASE holds at external axes zero; set up a positioner or rail as external kinematics"
    if arm is None:
        yield "; S is left out: the arm's lengths were not given (LIN does not read it)"
    if program.blend > 0:
        yield f"; cutting moves are rounded by C_DIS within {program.blend * 1e3:g} mm of their points"
    else:
        yield "; no approximation: the robot stops exactly at every programmed point"
    yield "; check $LOAD for this tool before the first run; first run in T1"
    yield "BAS(#INITMOV,0)"
    yield "$TOOL=MO_TOOL"
    yield "$BASE=MO_BASE"
    yield "$IPO_MODE=#BASE"
    yield "$ORI_TYPE=#VAR"
    yield "$ADVANCE=3"
    yield f"BAS(#VEL_PTP,{program.ptp_speed * 100:g})"
    if program.blend > 0:
        yield f"$APO.CDIS={program.blend * 1e3:.3f}  ; mm"


def _moves(program: RobotProgram, targets: Sequence[str], start: int, stop: int) -> Iterator[str]:
    """The statements of moves start … stop−1; operation and speed are stated anew at ``start``."""
    events: dict[int, list[str]] = {}
    for index, text in program.events:
        events.setdefault(index, []).append(text)
    kind, operation = program.kind.tolist(), program.operation.tolist()
    speeds = [f"{v:.6f}" for v in program.feed.tolist()]
    rounded = _rounded(program).tolist()
    label: int | None = None
    speed: str | None = None
    for k in range(start, stop):
        if operation[k] != label:
            label = operation[k]
            if label >= 0:
                yield f"; operation: {_comment(program.operations[label])}"
        for text in events.get(k, ()):
            yield f"; CAM: {_comment(text)}"
        if kind[k] == PTP:
            yield f"PTP {targets[k]}"
            continue
        if speeds[k] != speed:
            speed = speeds[k]
            yield f"$VEL.CP={speed}"
        yield f"LIN {targets[k]}{' C_DIS' if rounded[k] else ''}"


def _rounded(program: RobotProgram) -> NDArray[np.bool_]:
    """(M,) True where a cutting LIN runs on into another of the same operation without an event between."""
    n = len(program)
    out = np.zeros(n, dtype=bool)
    if program.blend <= 0:
        return out
    cut = program.cutting & (program.kind == LIN)
    out[:-1] = cut[:-1] & cut[1:] & (program.operation[:-1] == program.operation[1:])
    out[[i - 1 for i, _ in program.events if 0 < i < n]] = False
    out[MOVES_PER_DEF - 1 :: MOVES_PER_DEF] = False  # a sub-program ends there
    return out


def _targets(program: RobotProgram, axes: Array, arm: ArmLengths | None) -> list[str]:
    """The aggregate of each move: axes for PTP, pose with S and T for LIN."""
    lin = program.kind == LIN
    if program.external_prismatic:
        scale = np.array([1e3 if along else 180.0 / np.pi for along in program.external_prismatic])
        external = program.external * scale
        e_format = "".join(f",E{i + 1} %.{_EXTERNAL}f" for i in range(external.shape[1]))
    else:
        external, e_format = np.empty((len(program), 0)), ""
    axis_format = "{" + ",".join(f"A{i} %.{_AXIS}f" for i in range(1, 7)) + e_format + "}"
    pose_format = (
        "{" + ",".join([*(f"{c} %.{_XYZ}f" for c in "XYZ"), *(f"{c} %.{_ABC}f" for c in "ABC")])
        + (",S %d" if arm else "") + ",T %d" + e_format + "}"
    )  # fmt: skip
    bits = [status_bits(axes, arm), turn_bits(axes)] if arm else [turn_bits(axes)]
    pose = np.column_stack([
        np.round(program.T_workpiece_tcp[:, :3, 3] * 1e3, _XYZ) + 0.0,
        np.round(abc_deg(program.T_workpiece_tcp[:, :3, :3]), _ABC) + 0.0,
        *bits, np.round(external, _EXTERNAL) + 0.0,
    ]).tolist()  # fmt: skip
    joint = np.column_stack([np.round(axes, _AXIS) + 0.0, np.round(external, _EXTERNAL) + 0.0]).tolist()
    return [
        pose_format % tuple(pose[k]) if is_lin else axis_format % tuple(joint[k])
        for k, is_lin in enumerate(lin.tolist())
    ]


def _frame(T: Array) -> str:
    xyz = np.round(T[:3, 3] * 1e3, _XYZ) + 0.0
    abc = np.round(abc_deg(T[:3, :3]), _ABC) + 0.0
    return "{" + ",".join(
        [f"{c} {v:.{_XYZ}f}" for c, v in zip("XYZ", xyz, strict=True)]
        + [f"{c} {v:.{_ABC}f}" for c, v in zip("ABC", abc, strict=True)]
    ) + "}"  # fmt: skip


def _comment(text: str) -> str:
    """One line of ASCII, as an old KRC editor shows it."""
    return " ".join(text.split()).encode("ascii", "replace").decode("ascii")[:120]


def _save(path: Path, lines: Iterator[str]) -> None:
    path.write_text("".join(line + "\n" for line in lines), encoding="ascii", newline="\r\n")

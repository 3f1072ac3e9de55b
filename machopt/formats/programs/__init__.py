"""Robot programs read back: the readers that prove our own programs, and that take foreign ones as toolpaths.

They share no code with the writers in :mod:`machopt.formats.posts`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.programs.fanuc import read_fanuc
from machopt.formats.programs.jbi import read_jbi
from machopt.formats.programs.krl import read_krl
from machopt.formats.programs.parsed import ParsedProgram
from machopt.formats.programs.rapid import read_rapid
from machopt.formats.programs.ros import read_ros
from machopt.formats.programs.tables import read_csv_program, read_json_program
from machopt.formats.programs.toolpath import KnownRobot, to_toolpath
from machopt.formats.programs.urscript import read_urscript
from machopt.formats.programs.val3 import read_val3
from machopt.formats.source import ReadOptions, Source, decode, read_bytes

__all__ = ["KnownRobot", "ParsedProgram", "is_program", "read_program", "read_program_as_toolpath", "recognised"]

_HEAD_LINES = 400


def _has(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.MULTILINE)


_READERS: tuple[tuple[str, re.Pattern[str], Callable[[Source, float, bool], ParsedProgram]], ...] = (
    ("URScript", _has(r"^\s*(?:def|thread)\s+\w+\(.*\)\s*:|^\s*(?:movej|movel|movep|servoj)\("), read_urscript),
    ("KUKA KRL", _has(r"(?i)^\s*(?:&ACCESS|(?:GLOBAL\s+)?DEF\s+\w+\s*\(|DEFDAT\s+\w+)"), read_krl),
    ("ABB RAPID", _has(r"(?i)^\s*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+)?PROC\s+\w+\s*\()"), read_rapid),
    ("FANUC", _has(r"^\s*/PROG\b"), read_fanuc),
    ("Yaskawa", _has(r"^\s*/JOB\b"), read_jbi),
    ("Staubli VAL3", _has(r"staubli\.com/robotics/VAL3"), read_val3),
    ("program table", _has(r"^# machopt_program\b|^item,.*\bq1_deg\b"), read_csv_program),
    ("program JSON", _has(r'\A\s*\{\s*"machopt_program"'), read_json_program),
    ("ROS JointTrajectory", _has(r'^"?joint_names"?\s*:|^\s*\{.*"joint_names"\s*:'), read_ros),
)


def is_program(source: Source) -> bool:
    """True where the text is a robot program of a kind that is read here."""
    return _reader(source) is not None


def recognised(path: Path) -> bool:
    """True where a file is a robot program of a kind that is read here.

    Raises:
        InputError: it cannot be read at all.
    """
    return is_program(_source(path))


def read_program(
    path: Path | str, options: ReadOptions | None = None, *, pulses_per_deg: Sequence[float] | None = None
) -> ParsedProgram:
    """Read a robot program with what it calls from its own folder.

    Args:
        path: .src, .mod, .ls, .script, .pjx, .JBI, .csv, .json or .yaml; the content decides.
        options: arc tolerance and strictness.
        pulses_per_deg: six numbers, for Yaskawa jobs in pulses; without them their joint targets have no angles.

    Raises:
        InputError: names file and line, what was found and what would work.
    """
    options = options or ReadOptions()
    source = _source(Path(path))
    reader = _reader(source)
    if reader is None:
        known = ", ".join(name for name, _, _ in _READERS)
        raise source.error(f"is not recognised as a robot program; readable are {known}")
    if reader is read_jbi and pulses_per_deg is not None:
        return read_jbi(source, options.arc_tolerance, options.strict, tuple(pulses_per_deg))
    return reader(source, options.arc_tolerance, options.strict)


def read_program_as_toolpath(
    path: Path | str, options: ReadOptions | None = None, *, robot: KnownRobot | None = None
) -> Toolpath:
    """Read a robot program as a toolpath.

    Args:
        path: as for :func:`read_program`.
        options: default feed, strictness, arc tolerance, the tool frame's direction to the shank.
        robot: places of joint targets, where the robot is known.

    Raises:
        InputError: see :func:`read_program`, and where the program has no path that could be planned anew.
    """
    options = options or ReadOptions()
    pulses = None if robot is None or robot.controller.pulses_per_deg is None else robot.controller.pulses_per_deg
    program = read_program(path, options, pulses_per_deg=None if pulses is None else pulses.tolist())
    return to_toolpath(program, _source(Path(path)), options, robot)


def _source(path: Path) -> Source:
    data = read_bytes(path)
    if data[:2] in (b"\x1f\x8b", b"PK"):
        what = "a PolyScope program (.urp)" if path.suffix.lower() == ".urp" else "compressed"
        raise InputError(f"is {what}, which is packed; save it as a script or text program", file=path)
    return decode(path, data)


def _reader(source: Source) -> Callable[[Source, float, bool], ParsedProgram] | None:
    head = "\n".join(source.lines[:_HEAD_LINES])
    return next((reader for _, pattern, reader in _READERS if pattern.search(head)), None)

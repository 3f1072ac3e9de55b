"""Robot programs read back: the readers that prove our own programs, and that take foreign ones as toolpaths.

They share no code with the writers in :mod:`machopt.formats.posts`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.programs.parsed import ParsedProgram
from machopt.formats.programs.toolpath import KnownRobot, to_toolpath
from machopt.formats.source import ReadOptions, Source, decode, read_bytes

__all__ = ["KnownRobot", "ParsedProgram", "is_program", "read_program", "read_program_as_toolpath", "recognised"]

_HEAD_LINES = 400


def _has(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.MULTILINE)


@dataclass(frozen=True)
class _Language:
    """A language, how it is known, and its reader, which alone is loaded."""

    name: str
    known_by: re.Pattern[str]
    module: str
    function: str

    def read(self, source: Source, options: ReadOptions, pulses_per_deg: Sequence[float] | None) -> ParsedProgram:
        reader = getattr(import_module(f"{__name__}.{self.module}"), self.function)
        pulses = () if self.module != "jbi" or pulses_per_deg is None else (tuple(pulses_per_deg),)
        parsed: ParsedProgram = reader(source, options.arc_tolerance, options.strict, *pulses)
        return parsed


_READERS = (  # the first that fits: VAL3 holds movej( and movel( as URScript does
    _Language("Staubli VAL3", _has(r"staubli\.com/robotics/VAL3"), "val3", "read_val3"),
    _Language(
        "URScript",
        _has(r"^\s*(?:def|thread)\s+\w+\(.*\)\s*:|^\s*(?:movej|movel|movep|servoj)\("),
        "urscript",
        "read_urscript",
    ),
    _Language("KUKA KRL", _has(r"(?i)^\s*(?:&ACCESS|(?:GLOBAL\s+)?DEF\s+\w+\s*\(|DEFDAT\s+\w+)"), "krl", "read_krl"),
    _Language("ABB RAPID", _has(r"(?i)^\s*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+)?PROC\s+\w+\s*\()"), "rapid", "read_rapid"),
    _Language("FANUC", _has(r"^\s*/PROG\b"), "fanuc", "read_fanuc"),
    _Language("Yaskawa", _has(r"^\s*/JOB\b"), "jbi", "read_jbi"),
    _Language("program table", _has(r"^# machopt_program\b|^item,.*\bq1_deg\b"), "tables", "read_csv_program"),
    _Language("program JSON", _has(r'\A\s*\{\s*"machopt_program"'), "tables", "read_json_program"),
    _Language("ROS JointTrajectory", _has(r'^"?joint_names"?\s*:|^\s*\{.*"joint_names"\s*:'), "ros", "read_ros"),
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
        known = ", ".join(language.name for language in _READERS)
        raise source.error(f"is not recognised as a robot program; readable are {known}")
    return reader.read(source, options, pulses_per_deg)


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
    loose = replace(options, strict=False)  # the toolpath refuses what is not understood, and knows what is accepted
    program = read_program(path, loose, pulses_per_deg=None if pulses is None else pulses.tolist())
    return to_toolpath(program, _source(Path(path)), options, robot)


def _source(path: Path) -> Source:
    data = read_bytes(path)
    if data[:2] in (b"\x1f\x8b", b"PK"):
        what = "a PolyScope program (.urp)" if path.suffix.lower() == ".urp" else "compressed"
        raise InputError(f"is {what}, which is packed; save it as a script or text program", file=path)
    return decode(path, data)


def _reader(source: Source) -> _Language | None:
    head = "\n".join(source.lines[:_HEAD_LINES])
    return next((language for language in _READERS if language.known_by.search(head)), None)

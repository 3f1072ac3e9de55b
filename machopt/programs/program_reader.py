"""Robot program readers, which verify our own programs and import foreign ones as toolpaths.

They share no code with the writers in :mod:`machopt.programs.program_writer`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from machopt.data_types.toolpath import Toolpath
from machopt.errors import FileFormatError
from machopt.file_formats.source_file import ReadOptions, SourceFile, decode_source, read_bytes
from machopt.programs.program_to_toolpath import ProgramRobot, convert_to_toolpath
from machopt.programs.reading.parsed_program import ParsedProgram

__all__ = ["ParsedProgram", "ProgramRobot", "is_program", "is_program_file", "read_program", "read_program_as_toolpath"]

_HEAD_LINES = 400


def _compile_pattern(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.MULTILINE)


@dataclass(frozen=True)
class _ProgramLanguage:
    """A language, how it is known, and its reader, which alone is loaded."""

    name: str
    known_by: re.Pattern[str]
    module: str  # the maker's package below machopt.programs
    function: str

    def read(self, source: SourceFile, options: ReadOptions, pulses_per_deg: Sequence[float] | None) -> ParsedProgram:
        reader = getattr(import_module(f"machopt.programs.{self.module}.reader"), self.function)
        pulses = () if self.module != "yaskawa" or pulses_per_deg is None else (tuple(pulses_per_deg),)
        parsed: ParsedProgram = reader(source, options.arc_tolerance, options.strict, *pulses)
        return parsed


_READERS = (  # the first that fits: VAL3 holds movej( and movel( as URScript does
    _ProgramLanguage("Staubli VAL3", _compile_pattern(r"staubli\.com/robotics/VAL3"), "staubli", "read_val3"),
    _ProgramLanguage(
        "URScript",
        _compile_pattern(r"^\s*(?:def|thread)\s+\w+\(.*\)\s*:|^\s*(?:movej|movel|movep|servoj)\("),
        "universal_robots",
        "read_urscript",
    ),
    _ProgramLanguage(
        "KUKA KRL",
        _compile_pattern(r"(?i)^\s*(?:&ACCESS|(?:GLOBAL\s+)?DEF\s+\w+\s*\(|DEFDAT\s+\w+)"),
        "kuka",
        "read_krl",
    ),
    _ProgramLanguage(
        "ABB RAPID",
        _compile_pattern(r"(?i)^\s*(?:%%%|MODULE\s+\w+|(?:LOCAL\s+)?PROC\s+\w+\s*\()"),
        "abb",
        "read_rapid",
    ),
    _ProgramLanguage("FANUC", _compile_pattern(r"^\s*/PROG\b"), "fanuc", "read_fanuc"),
    _ProgramLanguage("Yaskawa", _compile_pattern(r"^\s*/JOB\b"), "yaskawa", "read_jbi"),
    _ProgramLanguage(
        "program table",
        _compile_pattern(r"^# machopt_program\b|^item,.*\bq1_deg\b"),
        "generic_tables",
        "read_csv_program",
    ),
    _ProgramLanguage(
        "program JSON", _compile_pattern(r'\A\s*\{\s*"machopt_program"'), "generic_tables", "read_json_program"
    ),
    _ProgramLanguage(
        "ROS JointTrajectory", _compile_pattern(r'^"?joint_names"?\s*:|^\s*\{.*"joint_names"\s*:'), "ros", "read_ros"
    ),
)


def is_program(source: SourceFile) -> bool:
    """Return whether a text is a robot program in a supported language.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
    """
    return _select_language(source) is not None


def is_program_file(path: Path) -> bool:
    """Return whether a file is a robot program in a supported language.

    Args:
        path: Path of the file.

    Raises:
        InputError: the file cannot be read.
    """
    return is_program(_read_source(path))


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
    source = _read_source(Path(path))
    reader = _select_language(source)
    if reader is None:
        known = ", ".join(language.name for language in _READERS)
        raise source.build_error(f"is not recognised as a robot program; readable are {known}")
    return reader.read(source, options, pulses_per_deg)


def read_program_as_toolpath(
    path: Path | str, options: ReadOptions | None = None, *, robot: ProgramRobot | None = None
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
    return convert_to_toolpath(program, _read_source(Path(path)), options, robot)


def _read_source(path: Path) -> SourceFile:
    data = read_bytes(path)
    if data[:2] in (b"\x1f\x8b", b"PK"):
        what = "a PolyScope program (.urp)" if path.suffix.lower() == ".urp" else "compressed"
        raise FileFormatError(f"is {what}, which is packed; save it as a script or text program", file=path)
    return decode_source(path, data)


def _select_language(source: SourceFile) -> _ProgramLanguage | None:
    head = "\n".join(source.lines[:_HEAD_LINES])
    return next((language for language in _READERS if language.known_by.search(head)), None)

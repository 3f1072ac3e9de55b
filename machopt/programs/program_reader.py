"""Robot program readers, which verify our own programs and import foreign ones as toolpaths.

They share no code with the writers in :mod:`machopt.programs.program_writer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from machopt.data_types.toolpath import Toolpath
from machopt.errors import FileFormatError
from machopt.file_formats.source_file import ReadOptions, SourceFile, decode_source, read_bytes
from machopt.programs.maker_contract import ProgramLanguage
from machopt.programs.maker_registry import list_languages
from machopt.programs.program_to_toolpath import ProgramRobot, convert_to_toolpath
from machopt.programs.reading.parsed_program import ParsedProgram

__all__ = ["ParsedProgram", "ProgramRobot", "is_program", "is_program_file", "read_program", "read_program_as_toolpath"]

_HEAD_LINES = 400


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
    language = _select_language(source)
    if language is None:
        known = ", ".join(language.name for language in list_languages())
        raise source.build_error(f"is not recognised as a robot program; readable are {known}")
    pulses = (tuple(pulses_per_deg),) if language.reads_pulses and pulses_per_deg is not None else ()
    parsed: ParsedProgram = language.load(language.reader)(source, options.arc_tolerance, options.strict, *pulses)
    return parsed


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


def _select_language(source: SourceFile) -> ProgramLanguage | None:
    head = "\n".join(source.lines[:_HEAD_LINES])
    return next((language for language in list_languages() if language.known_by.search(head)), None)

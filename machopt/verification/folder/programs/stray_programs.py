"""Robot programs in an output folder that none of its posts wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from machopt.errors import InputError
from machopt.programs.program_reader import is_program_file
from machopt.verification.check_results import build_file_check
from machopt.verification.folder.programs.program_comparison_result import ListedProgram, ProgramComparison

NON_PROGRAM_FILES = frozenset(
    ("points.csv", "trajectory.csv", "compensation.csv", "result.json", "manifest.json", "report.html")
)


def find_stray_programs(out: Path, posted: Sequence[ListedProgram]) -> tuple[ProgramComparison, ...]:
    """Return one entry for each file that looks like a robot program and belongs to no post of the folder.

    Args:
        out: The output folder.
        posted: Programs that the manifest lists.
    """
    mine = {name for one in posted for name in (*one.files, one.label)}  # a user's template lies under its label
    found = []
    for file in sorted(p for p in out.rglob("*") if p.is_file()):
        name = file.relative_to(out).as_posix()
        if name in mine or name in NON_PROGRAM_FILES or file.is_symlink():
            continue
        try:
            program = is_program_file(file)
        except InputError:
            program = False
        if program:
            check = build_file_check(
                name,
                "a program of this job",
                False,
                1.0,
                0.0,
                "files",
                "a robot program that belongs to no post of this folder",
            )
            found.append(ProgramComparison(ListedProgram("", None, (name,)), 0, (check,)))
    return tuple(found)

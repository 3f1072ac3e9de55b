"""Robot programs in an output folder that no post of it wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from machopt.errors import InputError
from machopt.formats.programs import recognised
from machopt.recheck.compared import Compared, Posted
from machopt.verify.check import of_file

NOT_PROGRAMS = frozenset(
    ("points.csv", "trajectory.csv", "compensation.csv", "result.json", "manifest.json", "report.html")
)


def strays(out: Path, posted: Sequence[Posted]) -> tuple[Compared, ...]:
    """One entry a file that looks like a robot program and belongs to none of the folder."""
    mine = {name for one in posted for name in (*one.files, one.label)}  # a user's template lies under its label
    found = []
    for file in sorted(p for p in out.rglob("*") if p.is_file()):
        name = file.relative_to(out).as_posix()
        if name in mine or name in NOT_PROGRAMS or file.is_symlink():
            continue
        try:
            program = recognised(file)
        except InputError:
            program = False
        if program:
            check = of_file(
                name,
                "a program of this job",
                False,
                1.0,
                0.0,
                "files",
                "a robot program that belongs to no post of this folder",
            )
            found.append(Compared(Posted("", None, (name,)), 0, (check,)))
    return tuple(found)

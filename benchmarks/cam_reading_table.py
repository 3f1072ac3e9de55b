"""A table of what machopt reads of a folder of CAM files and robot programs.

Run: ``python benchmarks/cam_reading_table.py FOLDER [--unit mm] [--feed MM_MIN] [--machine NAME] [--csv OUT.csv]``. One
row a file: dialect, points, operations, words that were not understood, or why it is refused. Without options a file
that does not state its unit or its feeds is refused; with ``--ask`` it is asked again with what the refusal asks for
(mm, 1000 mm/min, a path, the usual kinematics one after the other, at last with the axes through the program's zero),
and the row says what had to be given: such a path shows that the reader takes the file, not where the part is.
"""

from __future__ import annotations

import argparse
import collections
import csv
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

ASKED = (  # words of a refusal, and what it asks for
    ("--unit mm", {"unit": "mm"}),
    ("--feed", {"default_feed": 1000.0 / 60e3}),
    ("--kind", {"kind": "path"}),
)
MACHINES = ("table-ac", "table-bc", "table-ab", "table-b", *(f"table-{a}@0,0,0" for a in ("ac", "bc", "ab", "b")))
KINDS = (  # words of a reason, and how it is counted
    ("binary", "binary"),
    ("APT part program", "APT part program without points"),
    ("STEP", "STEP-NC: features, no points"),
    ("joint moves and no linear one", "robot program of joint moves only"),
    ("holds no moves", "robot program without moves"),
    ("while the robot runs", "robot program that gets its targets at run time"),
    ("declared in none", "robot program that refers to files that are not here"),
    ("without a program", "data list without its program"),
    ("packed", "packed"),
    ("--machine", "rotary axes without their kinematics"),
    ("--unit", "no unit"),
    ("--feed", "no feed"),
    ("no cutting move", "rapid moves only"),
    ("I, J, K with a wrong sign", "arcs whose centres cannot be known"),
    ("calls none", "subroutines without the program that calls them"),
    ("calls a subprogram", "subprogram that is not in the file"),
    ("MillPlus", "MillPlus control"),
    ("_HAL", "values of the running control"),
    ("turning program", "turning program"),
    ("--offset", "work offsets that only the control knows"),
)


@dataclass
class Row:
    """One file."""

    file: str
    dialect: str = ""
    points: int = 0
    cutting: int = 0
    operations: int = 0
    ignored: str = ""  # not understood, with count and first line
    given: list[str] = field(default_factory=list)
    doubts: str = ""
    refused: str = ""
    seconds: float = 0.0


def look(file: Path, folder: Path, options: dict[str, Any], ask: bool) -> Row:
    """Read one file, giving what it asks for where that is allowed."""
    row = Row(file.relative_to(folder).as_posix())
    start = time.perf_counter()
    toolpath, given, row.refused = read_or_ask(file, options, ask)
    if toolpath is not None:
        describe(row, toolpath)
    row.given = [
        f"--{'feed' if k == 'default_feed' else k} {v:g}" if isinstance(v, float) else f"--{k} {v}"
        for k, v in given.items()
    ]
    row.given = [g.replace("0.0166667", "1000") for g in row.given]
    row.seconds = time.perf_counter() - start
    return row


def read_or_ask(file: Path, options: dict[str, Any], ask: bool) -> tuple[Toolpath | None, dict[str, Any], str]:
    """The path, what had to be given for it beyond ``options``, and why it is refused (empty where it is not)."""
    given: dict[str, Any] = {}
    machines = iter(MACHINES)
    while True:
        try:
            return read_toolpath(file, **options, **given), given, ""
        except InputError as problem:
            more = _answer(problem.reason, options | given, machines) if ask else {}
            if not more:
                return None, given, (f"{problem.where}: " if problem.where else "") + problem.reason
            given |= more


def _answer(reason: str, options: dict[str, Any], machines: Iterator[str]) -> dict[str, Any]:
    """What a refusal asks for, as keywords; empty where it asks for nothing more that is known here."""
    for words, keywords in ASKED:
        if words in reason and not set(keywords) <= set(options):
            return keywords
    if "--machine" in reason or "has no such axis" in reason:
        machine = next(machines, None)
        return {} if machine is None else {"machine": machine}
    return {}


def describe(row: Row, toolpath: Toolpath) -> None:
    """What was read, and what of it looks odd."""
    row.dialect, row.points, row.cutting = toolpath.format, len(toolpath), int(toolpath.cutting.sum())
    row.operations = len(toolpath.operations)
    strange = [w for w in toolpath.ignored if not w.understood]
    row.ignored = "; ".join(f"{w.word} x{w.count} (line {w.first_line})" for w in strange)
    p = toolpath.position * 1e3
    doubts = []
    size = float(np.ptp(p[toolpath.cutting], axis=0).max())
    if not 0.5 < size < 5000.0:
        doubts.append(f"the cuts span {size:.3g} mm")
    step = np.linalg.norm(np.diff(p, axis=0), axis=1)[toolpath.cutting[1:]]
    if len(step) and float(step.max()) > 1000.0:
        doubts.append(f"a cut of {float(step.max()):.0f} mm")
    if float(toolpath.axis[toolpath.cutting, 2].max()) < -0.7:
        doubts.append("tool from below")
    feed = toolpath.feed[toolpath.cutting] * 60e3
    if float(np.median(feed)) > 20e3 or float(np.median(feed)) < 1.0:
        doubts.append(f"median feed {float(np.median(feed)):.3g} mm/min")
    doubts += [w for w in toolpath.warnings if "not understood" not in w]
    row.doubts = "; ".join(doubts)


def files_in(folder: Path) -> list[Path]:
    """Every file but an index of them."""
    return sorted(f for f in folder.rglob("*") if f.is_file() and f.name != "index.csv" and not f.name.startswith("."))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--unit", choices=("mm", "inch"))
    parser.add_argument("--feed", type=float, metavar="MM_MIN")
    parser.add_argument("--machine")
    parser.add_argument("--ask", action="store_true", help="give a file what its refusal asks for")
    parser.add_argument("--csv", type=Path, metavar="OUT.csv", help="the table as CSV too")
    args = parser.parse_args()
    options: dict[str, Any] = {"unit": args.unit, "machine": args.machine}
    options = {k: v for k, v in options.items() if v is not None}
    if args.feed is not None:
        options["default_feed"] = args.feed / 60e3
    rows = [look(f, args.folder, options, args.ask) for f in files_in(args.folder)]
    print(f"{'file':64} {'dialect':18} {'points':>8} {'cuts':>8} {'ops':>4}  not understood, or why it is refused")
    for r in rows:
        told = f"REFUSED: {r.refused}" if r.refused else r.ignored
        given = f"[with {' '.join(r.given)}] " if r.given and not r.refused else ""
        told = f"{given}{told}" + (f" | {r.doubts}" if r.doubts and not r.refused else "")
        print(
            f"{r.file[:64]:64} {r.dialect:18} {r.points or '':>8} {r.cutting or '':>8} {r.operations or '':>4}  {told}"
        )
    if args.csv is not None:
        with args.csv.open("w", newline="", encoding="utf-8") as f:
            writer = csv.writer(f)
            writer.writerow(list(vars(Row(""))))
            writer.writerows([*(" ".join(v) if isinstance(v, list) else v for v in vars(r).values())] for r in rows)
    summary(rows)
    return 0


def summary(rows: list[Row]) -> None:
    """How many were read as they are, with what given, and refused for what."""
    read = [r for r in rows if not r.refused]
    plain = sum(not r.given for r in read)
    print(
        f"\n{len(rows)} files: {len(read)} read ({plain} as they are), {len(rows) - len(read)} refused; "
        f"{sum(r.points for r in read):,} points in {sum(r.seconds for r in rows):.1f} s; "
        f"{sum(bool(r.ignored) for r in read)} of those read hold words that were not understood"
    )
    given = collections.Counter(" ".join(g.split()[0] for g in r.given) for r in read if r.given)
    for what, count in given.most_common():
        print(f"  {count:4} read with {what}")
    kinds = collections.Counter(kind_of(r.refused) for r in rows if r.refused)
    for what, count in kinds.most_common():
        print(f"  {count:4} refused: {what}")


def kind_of(reason: str) -> str:
    """The reason in few words."""
    return next((kind for words, kind in KINDS if words in reason), reason[:100])


if __name__ == "__main__":
    sys.exit(main())

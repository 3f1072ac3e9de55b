"""machopt's reader and the second reader (benchmarks/second_cam_reader) on the same files, difference by difference.

Run: ``python benchmarks/cam_reader_comparison.py FOLDER [--only WORD] [--csv OUT.csv]``. Each reads every file of the
folder by its own code; a file that asks for a unit, a feed or a machine gets mm, 1000 mm/min and the usual ones, as
with ``cam_reading_table.py --ask``. Compared are:

- the ends of the second reader's moves: each must be a point of machopt's, in order;
- machopt's points: each must lie on the second reader's path;
- extent, length of feed and of rapid moves, smallest and largest feed, axis where the second reader knows it.

The limits stand below with their reasons. Differences that remain are explained in
benchmarks/second_cam_reader/README.md.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import cam_reading_table
import second_cam_reader
from second_cam_reader.sampled_path import Path3

from machopt.data_types.toolpath import Toolpath

Array = NDArray[np.float64]

PLACE = 1e-3  # mm: files carry three or four decimals, and both sides compute in double precision
SAGITTA = 0.011  # mm: machopt's chords leave an arc by at most 0.01 mm
LENGTH = 2e-3  # of the length: chords of that sagitta on radii above 1 mm are shorter than the arc by less
AXIS = 1e-4  # rad


@dataclass
class Verdict:
    """One file."""

    file: str
    dialect: str = ""
    second: str = ""  # what the second reader says where it does not read
    refused: str = ""  # what machopt says where it does not read
    given: str = ""
    points: int = 0
    ends: int = 0
    missing_ends: int = 0
    first_missing: str = ""
    off_path: int = 0
    first_off: str = ""
    extent_mm: float = math.nan
    cut_mm: float = math.nan
    cut_difference_mm: float = math.nan
    rapid_difference_mm: float = math.nan
    feeds: str = ""
    axis_rad: float = math.nan
    differs: list[str] = field(default_factory=list)


def judge(file: Path, name: str) -> Verdict:
    """Both readings of one file, compared."""
    v = Verdict(name)
    mine, given, v.refused = cam_reading_table.read_or_ask(file, {}, ask=True)
    v.given = " ".join(f"{k}={x:.4g}" if isinstance(x, float) else f"{k}={x}" for k, x in given.items())
    other: Path3 | None = None
    try:
        other = second_cam_reader.read(file)
    except second_cam_reader.NotReadError as reason:
        v.second = str(reason)
    if mine is not None:
        v.dialect, v.points = mine.format, len(mine)
    if other is not None:
        v.ends = len(other.moves)
        v.dialect = v.dialect or other.dialect
        if not other.moves:
            v.second = "no moves"
    if mine is not None and other is not None and other.moves:
        compare(v, mine, other, feed_given="default_feed" in given)
    return v


def compare(v: Verdict, mine: Toolpath, other: Path3, *, feed_given: bool) -> None:
    """Fill in the differences."""
    p = mine.position * 1e3
    ends_in_order(v, p, mine, other)
    on_path(v, p, mine, other)
    low, high = other.extent()
    v.extent_mm = float(max(np.abs(p.min(axis=0) - low).max(), np.abs(p.max(axis=0) - high).max()))
    step = np.linalg.norm(np.diff(p, axis=0), axis=1)
    feeding = ~np.isnan(mine.feed[1:])
    v.cut_mm = other.length(rapid=False)
    v.cut_difference_mm = float(step[feeding].sum()) - v.cut_mm
    v.rapid_difference_mm = float(step[~feeding].sum()) - other.length(rapid=True)
    theirs = other.feeds()
    own = sorted({round(float(f) * 60e3, 3) for f in mine.feed if not math.isnan(f)})
    if theirs and not feed_given:
        ok = own and math.isclose(own[0], theirs[0], rel_tol=1e-3) and math.isclose(own[-1], theirs[-1], rel_tol=1e-3)
        v.feeds = "" if ok else f"{own[:1]}..{own[-1:]} ({len(own)}) against {theirs[0]}..{theirs[-1]} ({len(theirs)})"
    for name, wrong in (
        ("ends", v.missing_ends > 0),
        ("path", v.off_path > 0),
        ("extent", v.extent_mm > SAGITTA),
        ("length", not other.pecks and abs(v.cut_difference_mm) > LENGTH * v.cut_mm + PLACE),
        ("rapids", not other.pecks and abs(v.rapid_difference_mm) > LENGTH * other.length(rapid=True) + PLACE),
        ("feeds", bool(v.feeds)),
    ):
        if wrong:
            v.differs.append(name)


def ends_in_order(v: Verdict, p: Array, mine: Toolpath, other: Path3) -> None:
    """Each end of the second reader is looked for from where the last one was found, by the shortest way on."""
    k = 0
    for m in other.moves:
        end = m.points[-1]
        near = np.flatnonzero(np.abs(p[k:] - end).max(axis=1) < PLACE)
        if not len(near):
            v.missing_ends += 1
            v.first_missing = v.first_missing or f"line {m.line}: {np.round(end, 3).tolist()}"
        else:
            k += int(near[0])
    _ = mine


def on_path(v: Verdict, p: Array, mine: Toolpath, other: Path3) -> None:
    """Points of machopt farther from every piece of the second reader's path than the sampling allows."""
    pieces = [other.moves[0].points[:1], *(m.points for m in other.moves)]
    line = np.concatenate(pieces)
    a, b = line[:-1], line[1:]
    order = 0
    for k, q in enumerate(p):
        if _distance(q, a[order : order + 400], b[order : order + 400]) < SAGITTA:
            near = _near(q, a[order : order + 400], b[order : order + 400])
            order = max(0, order + near - 200)
            continue
        near = _near(q, a, b)
        if _distance(q, a[near : near + 1], b[near : near + 1]) >= SAGITTA:
            v.off_path += 1
            v.first_off = v.first_off or f"line {mine.line[k]}: {np.round(q, 3).tolist()}"
        else:
            order = max(0, near - 200)


def _distances(q: Array, a: Array, b: Array) -> Array:
    d = b - a
    t = np.clip(np.einsum("ij,ij->i", q - a, d) / np.maximum(np.einsum("ij,ij->i", d, d), 1e-30), 0.0, 1.0)
    out: Array = np.linalg.norm(a + t[:, None] * d - q, axis=1)
    return out


def _distance(q: Array, a: Array, b: Array) -> float:
    return float(_distances(q, a, b).min()) if len(a) else math.inf


def _near(q: Array, a: Array, b: Array) -> int:
    return int(_distances(q, a, b).argmin()) if len(a) else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="files with this word in their name")
    parser.add_argument("--csv", type=Path, metavar="OUT.csv")
    args = parser.parse_args()
    verdicts = []
    for file in cam_reading_table.files_in(args.folder):
        name = file.relative_to(args.folder).as_posix()
        if args.only in name:
            verdicts.append(judge(file, name))
            tell(verdicts[-1])
    both = [v for v in verdicts if not v.refused and not v.second]
    print(
        f"\n{len(verdicts)} files: {len(both)} read by both, {sum(not v.differs for v in both)} of them alike; "
        f"{sum(bool(v.refused) and bool(v.second) for v in verdicts)} refused by both, "
        f"{sum(bool(v.refused) and not v.second for v in verdicts)} by machopt only, "
        f"{sum(bool(v.second) and not v.refused for v in verdicts)} by the second reader only"
    )
    if args.csv is not None:
        with args.csv.open("w", newline="", encoding="utf-8") as f:
            writer = csv.writer(f)
            writer.writerow([x.name for x in fields(Verdict)])
            writer.writerows(
                [" ".join(x) if isinstance(x, list) else x for x in (getattr(v, g.name) for g in fields(Verdict))]
                for v in verdicts
            )
    return 0


def tell(v: Verdict) -> None:
    """One line, and more where they differ."""
    head = f"{v.file[:58]:58} {v.dialect:16}"
    if v.refused or v.second:
        print(f"{head} machopt: {v.refused[:110] or 'reads it'} | second: {v.second[:70] or 'reads it'}")
        return
    print(
        f"{head} {v.points:7} points {v.ends:6} ends  {'DIFFERS: ' + ' '.join(v.differs) if v.differs else 'alike'}"
        f"{'  [' + v.given + ']' if v.given else ''}"
    )
    if v.differs:
        print(
            f"      ends missing {v.missing_ends} {v.first_missing}; off path {v.off_path} {v.first_off}; "
            f"extent {v.extent_mm:.4f}; cut {v.cut_difference_mm:+.3f} of {v.cut_mm:.1f}; "
            f"rapid {v.rapid_difference_mm:+.3f}; feeds {v.feeds}"
        )


if __name__ == "__main__":
    sys.exit(main())

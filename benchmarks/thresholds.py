"""Thresholds of the diagnosis: the table, what they come to on concealed cases, and the same with one set otherwise.

    python benchmarks/thresholds.py                                          # the table
    python benchmarks/concealed/run.py --set dev --fast --out out/concealed  # cases and answers
    python benchmarks/thresholds.py --answers out/concealed                  # false alarms and misses of these answers
    python benchmarks/thresholds.py --answers out/concealed --vary detection.gain=20,30,40

``--vary`` diagnoses every case again in this process with the threshold at each value, into a folder that is thrown
away. What is held against the truth, and how, stands in benchmarks/concealed/score.py.

How far each threshold may move before anything changes, and what a quarter less or more does (benchmarks/room.py):

    python benchmarks/concealed/generate.py --set dev --seed 31 --out out/own
    python benchmarks/stranger/make.py --set dev --seed 31 --share 0.3 --out out/stranger
    python benchmarks/thresholds.py --room out/room --cases "out/own=benchmarks/concealed/run.py --set dev --seed 31" \\
        "out/stranger=benchmarks/stranger/run.py --set dev --seed 31 --share 0.3" --seconds 900 --write
    python docs/make_thresholds.py

``--write`` puts it into machopt/measurement/threshold_evidence/rooms.json, which tests hold against the tables.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks"), str(ROOT / "benchmarks" / "concealed")]

import room  # noqa: E402
import score  # noqa: E402  beside this file's neighbour, no package
import watched  # noqa: E402

from machopt.measurement.diagnosis import thresholds  # noqa: E402
from machopt.measurement.diagnosis.thresholds import ThresholdSensitivity  # noqa: E402

FALSE_ALARM, MISS = "null: something named", "recall of single effects"
RIGHT, OUTSIDE = "precision of a named effect", "outside the catalogue: misnamed"
FIGURES = (FALSE_ALARM, RIGHT, MISS, OUTSIDE)


def table() -> list[str]:
    """One line a threshold: its name, its value, where that comes from, what it is, what cases say of it."""
    known = thresholds.read_sensitivity_table().thresholds
    rows = [
        (
            t.key,
            f"{t.value:g}",
            t.origin.describe(),
            t.meaning + (f" ({known[t.key].describe()})" if t.key in known else ""),
        )
        for t in thresholds.list_thresholds()
    ]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return ["  ".join(text.ljust(w) for text, w in zip(row, (*widths, 0), strict=True)).rstrip() for row in rows]


def rates(answers: Path) -> dict[str, tuple[float, int]]:
    """Share and count of each figure of the answers in a folder."""
    lines, _ = score.table(score.read(answers))
    of = {line.what: line for line in lines}
    return {name: (100.0 * of[name].hits / max(of[name].of, 1), of[name].of) for name in FIGURES}


def varied(answers: Path, name: str, value: float) -> dict[str, tuple[float, int]]:
    """The same of every case diagnosed again with a threshold at another value."""
    from machopt.cli import main

    with tempfile.TemporaryDirectory() as folder, watched.otherwise({name: value}):
        for truth in sorted(answers.glob("*.truth.json")):
            case = truth.name.removesuffix(".truth.json")
            shutil.copy(truth, folder)
            out = Path(folder) / case / "out"
            out.parent.mkdir()
            given = [str(answers / case / part) for part in ("cell", "recording")]
            code = main(["diagnose", *given, "-o", str(out), "--quiet"])
            (out.parent / "run.json").write_text(json.dumps({"seconds": 0.0, "exit_code": code, "problem": ""}))
        return rates(Path(folder))


def line(what: str, found: dict[str, tuple[float, int]]) -> str:
    return f"{what}: " + ", ".join(f"{name} {share:.1f} % of {count}" for name, (share, count) in found.items())


def measure(folder: Path, cases: Sequence[str], seconds: float, written: bool) -> None:
    """The room of every threshold on cases that lie there; what is in ``folder`` already is not done again."""
    drawn = [c.partition("=") for c in cases]
    where = [Path(path) for path, _, _ in drawn]
    log, varied = folder / "watched.jsonl", folder / "varied.jsonl"
    room.run(log, where, seconds)
    room.vary(varied, log, where, seconds)
    tests = {key: list(r.tests) for key, r in thresholds.read_sensitivity_table().thresholds.items()}
    rows = room.table(log, varied, tests)
    print("\n".join(f"{key}: {ThresholdSensitivity.from_row(row).describe()}" for key, row in rows.items()))
    if written:
        done = {line["case"].partition(" ")[2] for line in room.lines(log)}  # some are identified from, too
        sets = [
            f"{sum(d.startswith(p.name + '/') for d in done)} cases of {c[2]}"
            for p, c in zip(where, drawn, strict=True)
        ]
        room.write(
            ROOT / "machopt" / "measurement" / "threshold_evidence" / "rooms.json",
            rows,
            room.together(varied),
            sets,
            date.today().isoformat(),
        )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--answers", type=Path, help="folder of benchmarks/concealed/run.py")
    parser.add_argument("--vary", action="append", default=[], metavar="TABLE.NAME=VALUE,…")
    parser.add_argument("--room", type=Path, metavar="FOLDER", help="where to keep what thresholds were held against")
    parser.add_argument("--cases", nargs="*", default=[], metavar="FOLDER=COMMAND", help="cases, and what drew them")
    parser.add_argument("--seconds", type=float, default=900.0, help="of the processor, for either half of --room")
    parser.add_argument("--write", action="store_true", help="into machopt/measurement/threshold_evidence/rooms.json")
    asked = parser.parse_args(arguments)
    if asked.room is not None:
        measure(asked.room, asked.cases, asked.seconds, asked.write)
        return 0
    print("\n".join(table()))
    if asked.answers is None:
        return 0
    print(line("\nas they are", rates(asked.answers)))
    for change in asked.vary:
        name, _, values = change.partition("=")
        if name not in {t.key for t in thresholds.list_thresholds()}:
            parser.error(f"--vary: there is no threshold {name!r}; the table above lists them")
        for value in values.split(","):
            print(line(f"{name} = {value}", varied(asked.answers, name, float(value))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Thresholds of the diagnosis: the table, what they come to on concealed cases, and the same with one set otherwise.

    python benchmarks/thresholds.py                                          # the table
    python benchmarks/concealed/run.py --set dev --fast --out out/concealed  # cases and answers
    python benchmarks/thresholds.py --answers out/concealed                  # false alarms and misses of these answers
    python benchmarks/thresholds.py --answers out/concealed --vary detection.gain=20,30,40

``--vary`` diagnoses every case again in this process with the threshold at each value, into a folder that is thrown
away. What is held against the truth, and how, stands in benchmarks/concealed/score.py.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "concealed")]

import score  # noqa: E402  beside this file's neighbour, no package

from machopt.diagnose import calibrated  # noqa: E402

FALSE_ALARM, MISS = "null: something named", "recall of single effects"
RIGHT, OUTSIDE = "precision of a named effect", "outside the catalogue: misnamed"
FIGURES = (FALSE_ALARM, RIGHT, MISS, OUTSIDE)


def table() -> list[str]:
    """One line a threshold: its name, its value, where that comes from, what it is."""
    rows = [(f"{t.concern.lower()}.{t.name}", f"{t.value:g}", _origin(t.origin), t.why) for t in calibrated.every()]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return ["  ".join(text.ljust(w) for text, w in zip(row, (*widths, 0), strict=True)).rstrip() for row in rows]


def _origin(o: calibrated.Origin) -> str:
    return o.how if o.how != "measured" else f"{o.script} --set {o.cases}, {o.date}"


def rates(answers: Path) -> dict[str, tuple[float, int]]:
    """Share and count of each figure of the answers in a folder."""
    lines, _ = score.table(score.read(answers))
    of = {line.what: line for line in lines}
    return {name: (100.0 * of[name].hits / max(of[name].of, 1), of[name].of) for name in FIGURES}


def varied(answers: Path, name: str, value: float) -> dict[str, tuple[float, int]]:
    """The same of every case diagnosed again with a threshold at another value."""
    from machopt.cli import main

    concern, _, field = name.partition(".")
    table = getattr(calibrated, concern.upper())
    setattr(calibrated, concern.upper(), replace(table, **{field: type(getattr(table, field))(value)}))
    try:
        with tempfile.TemporaryDirectory() as room:
            for truth in sorted(answers.glob("*.truth.json")):
                case = truth.name.removesuffix(".truth.json")
                shutil.copy(truth, room)
                out = Path(room) / case / "out"
                out.parent.mkdir()
                code = main(
                    [
                        "diagnose",
                        *(str(answers / case / part) for part in ("cell", "recording")),
                        "-o",
                        str(out),
                        "--quiet",
                    ]
                )
                (out.parent / "run.json").write_text(json.dumps({"seconds": 0.0, "exit_code": code, "problem": ""}))
            return rates(Path(room))
    finally:
        setattr(calibrated, concern.upper(), table)


def line(what: str, found: dict[str, tuple[float, int]]) -> str:
    return f"{what}: " + ", ".join(f"{name} {share:.1f} % of {count}" for name, (share, count) in found.items())


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--answers", type=Path, help="folder of benchmarks/concealed/run.py")
    parser.add_argument("--vary", action="append", default=[], metavar="TABLE.NAME=VALUE,…")
    asked = parser.parse_args(arguments)
    print("\n".join(table()))
    if asked.answers is None:
        return 0
    print(line("\nas they are", rates(asked.answers)))
    for change in asked.vary:
        name, _, values = change.partition("=")
        if name not in {f"{t.concern.lower()}.{t.name}" for t in calibrated.every()}:
            parser.error(f"--vary: there is no threshold {name!r}; the table above lists them")
        for value in values.split(","):
            print(line(f"{name} = {value}", varied(asked.answers, name, float(value))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

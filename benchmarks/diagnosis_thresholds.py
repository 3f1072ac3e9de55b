"""Print the thresholds of identification and diagnosis, and what they come to on concealed cases.

    python benchmarks/diagnosis_thresholds.py                                          # the table
    python benchmarks/diagnosis_chain_benchmark/run_chain_benchmark.py --set dev --fast --out out/chain
        writes cases and answers
    python benchmarks/diagnosis_thresholds.py --answers out/chain
        prints false alarms and misses of these answers
    python benchmarks/diagnosis_thresholds.py --answers out/chain --vary levels.min_gain=20,30,40

``--vary`` diagnoses every case again in this process with the threshold at each value, into a temporary folder.
benchmarks/diagnosis_chain_benchmark/score_diagnoses.py compares the answers with the truth.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks" / "diagnosis_chain_benchmark")]

import score_diagnoses  # noqa: E402

from machopt.measurement import thresholds  # noqa: E402

FIGURES = (
    "null: something named",
    "precision of a named effect",
    "recall of single effects",
    "outside the catalogue: misnamed",
)


def format_table() -> list[str]:
    """Return one line for each threshold: key, value, origin, meaning."""
    rows = [(t.key, f"{t.value:g}", t.origin.describe(), t.meaning) for t in thresholds.list_thresholds()]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return ["  ".join(text.ljust(w) for text, w in zip(row, (*widths, 0), strict=True)).rstrip() for row in rows]


@contextmanager
def set_threshold(key: str, value: float) -> Iterator[None]:
    """Set a threshold for the duration of a block.

    Args:
        key: ``TABLE.NAME``, e.g. ``levels.min_gain``.
        value: its new value.
    """
    concern, _, name = key.partition(".")
    table = getattr(thresholds, concern.upper())
    setattr(thresholds, concern.upper(), replace(table, **{name: type(getattr(table, name))(value)}))
    try:
        yield
    finally:
        setattr(thresholds, concern.upper(), table)


def compute_rates(answers: Path) -> dict[str, tuple[float, int]]:
    """Return share in percent and count of each figure of the answers in a folder."""
    lines, _ = score_diagnoses.table(score_diagnoses.read(answers))
    of = {line.what: line for line in lines}
    return {name: (100.0 * of[name].hits / max(of[name].of, 1), of[name].of) for name in FIGURES}


def compute_varied_rates(answers: Path, key: str, value: float) -> dict[str, tuple[float, int]]:
    """Return the rates of all cases diagnosed again with a threshold at another value."""
    from machopt.cli import main as run_command

    with tempfile.TemporaryDirectory() as folder, set_threshold(key, value):
        for truth in sorted(answers.glob("*.truth.json")):
            case = truth.name.removesuffix(".truth.json")
            shutil.copy(truth, folder)
            out = Path(folder) / case / "out"
            out.parent.mkdir()
            given = [str(answers / case / part) for part in ("cell", "recording")]
            code = run_command(["diagnose", *given, "-o", str(out), "--quiet"])
            (out.parent / "run.json").write_text(json.dumps({"seconds": 0.0, "exit_code": code, "problem": ""}))
        return compute_rates(Path(folder))


def format_rates(what: str, found: dict[str, tuple[float, int]]) -> str:
    """Return one line of rates."""
    return f"{what}: " + ", ".join(f"{name} {share:.1f} % of {count}" for name, (share, count) in found.items())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and, if wanted, the rates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--answers", type=Path, help="folder of benchmarks/diagnosis_chain_benchmark/run_chain_benchmark.py"
    )
    parser.add_argument("--vary", action="append", default=[], metavar="TABLE.NAME=VALUE,…")
    args = parser.parse_args(arguments)
    print("\n".join(format_table()))
    if args.answers is None:
        return 0
    print(format_rates("\nas they are", compute_rates(args.answers)))
    for change in args.vary:
        key, _, values = change.partition("=")
        if key not in {t.key for t in thresholds.list_thresholds()}:
            parser.error(f"--vary: unknown threshold {key!r}; the table above lists them")
        for value in values.split(","):
            print(format_rates(f"{key} = {value}", compute_varied_rates(args.answers, key, float(value))))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What was found, missed and misnamed, effect by effect.

``python benchmarks/diagnosis_rates_by_effect.py NAME=FOLDER … [--file table.md]``: FOLDER holds answered cases of
benchmarks/diagnosis_chain_benchmark or benchmarks/diagnosis_energy_benchmark; NAME heads its columns. Counted are
single effects and those of sets that were due (twice the stated detection limit, or plain to a perfect test where none
is stated), names that are wrong by the effect they claim, and intervals of 95 % that hold the true size.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

sys.path += [
    str(Path(__file__).resolve().parent / part) for part in ("diagnosis_chain_benchmark", "diagnosis_energy_benchmark")
]
import evaluate_answers
import score_diagnoses
from score_diagnoses import Answer

HIDDEN = (
    "single",
    "pair",
    "set",
)  # groups whose effects are asked for; faults of the record are counted by their own row


@dataclass
class Counts:
    """Of one simulator."""

    due: Counter[str] = field(default_factory=Counter)
    found: Counter[str] = field(default_factory=Counter)
    named: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    held: Counter[str] = field(default_factory=Counter)
    sized: Counter[str] = field(default_factory=Counter)
    cases: int = 0


def count(answers: list[Answer]) -> Counts:
    """One pass over all cases."""
    out = Counts(cases=len(answers))
    for a in answers:
        group = a.truth["group"]
        if group in HIDDEN:
            for e in a.truth["effects"]:
                if score_diagnoses.above_limit(e, a.said) and not _silent(a):
                    out.due[e["effect"]] += 1
                    out.found[e["effect"]] += score_diagnoses.found(e, a.findings)
        for f in a.findings:
            out.named[f["effect"]] += 1
            out.wrong[f["effect"]] += not score_diagnoses.right(f, a.truth["effects"])
        for effect in {e["effect"] for e in a.truth["effects"]}:
            inside, total = score_diagnoses.intervals(evaluate_answers._only([a], effect))
            out.held[effect] += inside
            out.sized[effect] += total
        for label in _groups(a):
            out.due[label] += 1
            out.found[label] += not _misled(a)
            out.wrong[label] += _misled(a)
    return out


def _silent(a: Answer) -> bool:
    """A record that was never repeated and is told to say too little."""
    return not a.truth.get("repeats", True) and evaluate_answers.verdict(a) == "insufficient"


def _groups(a: Answer) -> list[str]:
    group = a.truth["group"]
    if group == "null":
        return ["*nothing concealed*"]
    if group == "outside":
        return ["*physics outside the catalogue*"]
    if group == "record":
        return ["*faults of the record*"]
    return []


def _misled(a: Answer) -> bool:
    """Something is named that is not there; of a faulty record, physics."""
    wrong = [f for f in a.findings if not score_diagnoses.right(f, a.truth["effects"])]
    return (
        any(f["effect"] not in evaluate_answers.OF_THE_RECORD for f in wrong)
        if a.truth["group"] == "record"
        else bool(wrong)
    )


def markdown(parts: dict[str, Counts]) -> str:
    """One row an effect, three columns a simulator; – where nothing was asked."""
    labels = sorted({k for c in parts.values() for k in (*c.due, *c.named)}, key=lambda k: (k.startswith("*"), k))
    head = "".join(f" {n}: found of due | named, of these wrong | 95 % held |" for n in parts)
    lines = [f"| effect |{head}", "|---|" + "---|---|---|" * len(parts)]
    for label in labels:
        cells = []
        for c in parts.values():
            if label.startswith("*"):
                cells += [f"{c.due[label]} cases", f"misled in {c.wrong[label]}", "–"]
                continue
            cells.append(f"{c.found[label]} of {c.due[label]}" if c.due[label] else "–")
            cells.append(f"{c.named[label]}, **{c.wrong[label]}**" if c.wrong[label] else f"{c.named[label]}, 0")
            cells.append(f"{c.held[label]} of {c.sized[label]}" if c.sized[label] else "–")
        name = label.strip("*") if label.startswith("*") else f"`{label}`"
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--file", type=Path, help="write the table here, too")
    options = parser.parse_args(arguments)
    parts = {}
    for given in options.folders:
        name, _, folder = given.partition("=")
        answers = evaluate_answers.read(Path(folder or name))
        if not answers:
            print(f"{folder or name}: no case was run; start run.py first", file=sys.stderr)
            return 2
        parts[name] = count(answers)
    table = markdown(parts)
    print(table, end="")
    if options.file is not None:
        options.file.write_text(table, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

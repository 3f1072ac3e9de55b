"""Make cases, diagnose them through the command line, judge, and print the table.

::

    python benchmarks/diagnosis_tracker_benchmark/run_tracker_benchmark.py --seed 3 --out out/tracker  # 60 cases
    python benchmarks/diagnosis_tracker_benchmark/run_tracker_benchmark.py --groups zeros,several --count 12
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from random_cases import GROUPS, Case, Truth, cases

RECORD = {"outliers"}  # what every tracker has now and then


@dataclass(frozen=True)
class Judged:
    """One case."""

    group: str
    named: int  # truths that are findings
    among: int  # that a finding's one_of holds
    truths: int
    extra: tuple[str, ...]  # findings that are none
    held: tuple[bool, ...]  # intervals of 95 % that hold the true size
    verdict: str


def judged(case: Case, group: str, result: Mapping[str, Any] | None) -> Judged:
    """Hold a diagnosis.json against the truth; None: it was refused."""
    findings = [] if result is None else [f for f in result["findings"] if f["effect"] not in RECORD]
    left, named, among, held = list(findings), 0, 0, []
    rest: list[Truth] = []
    for t in case.truths:
        own = next((f for f in left if _says(t, (f["effect"], f["location"]))), None)
        if own is None:
            rest.append(t)
            continue
        named += 1
        left.remove(own)
        if t.size is not None and t.size[0] in own["parameters"]:
            low, high = own["parameters"][t.size[0]]["ci95"]
            if low is not None and high is not None:  # an end that no reading tells is no interval to hold
                held.append(low <= t.size[1] <= high)
    for t in rest:
        own = next((f for f in left if any(_says(t, tuple(name)) for name in f["one_of"])), None)
        if own is not None:
            among += 1
            left.remove(own)
    extra = tuple(f"{f['effect']} {f['location']}" for f in left)
    verdict = "refused" if result is None else str(result["verdict"])
    return Judged(group, named, among, len(case.truths), extra, tuple(held), verdict)


def _says(t: Truth, name: Sequence[str]) -> bool:
    return any(name[0] == effect and where in ("*", name[1]) for effect, where in t.names)


def diagnosed(room: Path) -> Mapping[str, Any] | None:
    """By the command line; None where it is refused as bad input."""
    out = room / "out"
    command = [sys.executable, "-m", "machopt.cli", "diagnose", str(room / "cell"), str(room / "rec")]
    done = subprocess.run([*command, "-o", str(out), "--quiet"], capture_output=True, text=True, check=False)
    if done.returncode == 2:
        return None
    if done.returncode:
        raise SystemExit(f"{room}: exit {done.returncode}\n{done.stderr}")
    loaded: Mapping[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return loaded


def table(all_: Sequence[Judged]) -> str:
    """By group."""
    lines = [
        "| group | cases | named | as one of a set | not there, but named | all right | 95 % intervals that hold |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for group in dict.fromkeys(j.group for j in all_):
        own = [j for j in all_ if j.group == group]
        truths, held = sum(j.truths for j in own), [h for j in own for h in j.held]
        right = sum(j.named == j.truths and not j.extra for j in own)
        counted = f"{sum(held)} of {len(held)}" if held else ""
        lines.append(
            f"| {group} | {len(own)} | {sum(j.named for j in own)} of {truths} | {sum(j.among for j in own)} | "
            f"{sum(len(j.extra) for j in own)} | {right} | {counted} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--count", type=int, default=12, help="cases of each group")
    parser.add_argument("--out", type=Path, required=True, help="a folder that is not there yet")
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    all_ = []
    for group in args.groups.split(","):
        for case in cases(args.seed, group, args.count):
            room = args.out / case.name
            case.make(room)
            all_.append(judged(case, group, diagnosed(room)))
            j = all_[-1]
            print(
                f"{case.name} {case.arm}: {j.named}+{j.among} of {j.truths}, {j.verdict}; besides {list(j.extra)}",
                flush=True,
            )
    print(table(all_))


if __name__ == "__main__":
    main()

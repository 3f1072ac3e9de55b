"""Generate cases, diagnose each with the command line in a folder of its own, and score the answers.

Run: ``python benchmarks/diagnosis_bushing_benchmark/run.py -o out/bushing``. README.md lists the options.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).resolve().parent))
from bushing_simulator.case_files import write_case
from bushing_simulator.case_list import GROUPS, CasePlan, list_cases
from scoring import CaseScore, build_report, score_case

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LONGEST = 600.0  # s a diagnosis may take


def select_cases(cases: list[CasePlan], groups: list[str], limit: str) -> list[CasePlan]:
    """Return the chosen cases, mixed so that a run cut short has the same share of every group.

    Args:
        limit: empty, a number per group, or ``null=40,single=24``.
    """
    most = dict.fromkeys(GROUPS, 10**6)
    for part in filter(None, limit.split(",")):
        name, _, number = part.rpartition("=")
        most.update({g: int(number) for g in GROUPS} if not name else {name: int(number)})
    chosen = []
    for group in groups:
        members = [c for c in cases if c.group == group][: most[group]]
        chosen += [((n + 0.5) / len(members), c) for n, c in enumerate(members)]
    return [c for _, c in sorted(chosen, key=lambda x: x[0])]


def run_diagnosis(folder: Path) -> tuple[float, str]:
    """Run the command on copies of cell and recording; return processor seconds and what went wrong."""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as room:
        for part in ("cell", "recording"):
            shutil.copytree(folder / part, Path(room) / part)
        command = [sys.executable, "-m", "machopt.cli", "diagnose", "cell", "recording", "-o", "out", "--quiet"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        try:
            done = subprocess.run(
                command, cwd=room, env=env, capture_output=True, text=True, check=False, timeout=LONGEST
            )
            problem = "" if done.returncode == 0 else f"exit {done.returncode}: {done.stderr.strip()[-200:]}"
        except subprocess.TimeoutExpired:
            problem = f"longer than {LONGEST:.0f} s"
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        answer = Path(room) / "out" / "diagnosis.json"
        if answer.is_file():
            shutil.copy(answer, folder / "diagnosis.json")
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, problem.replace("\n", " ")


def is_finished(case: CasePlan, out: Path, commit: str) -> bool:
    """Return whether OUT holds the answer of this commit."""
    run = out / case.key.replace("/", "_") / "run.json"
    return run.is_file() and json.loads(run.read_text())["commit"] == commit


def score_one(case: CasePlan, out: Path, commit: str) -> CaseScore:
    """Write, diagnose and score one case; a finished one is only scored."""
    folder = out / case.key.replace("/", "_")
    run = folder / "run.json"
    if not is_finished(case, out, commit):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "diagnosis.json").unlink(missing_ok=True)
        write_case(case, folder)
        seconds, problem = run_diagnosis(folder)
        run.write_text(json.dumps({"seconds": seconds, "problem": problem, "commit": commit}) + "\n")
    state = json.loads(run.read_text())
    answer = folder / "diagnosis.json"
    score = score_case(
        json.loads((folder / "truth.json").read_text()),
        json.loads(answer.read_text()) if answer.is_file() else None,
        state["seconds"],
        state["problem"],
    )
    print(f"{case.key}  {state['seconds']:.1f} s  {score.verdict}  {score.named}  {score.problem}", flush=True)
    return score


def find_commit() -> str:
    """Return the commit of the product, marked where ``machopt/`` has changes."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run(
        [*git, "log", "-1", "--format=%h", "--", "machopt"], capture_output=True, text=True, check=True
    )
    changed = subprocess.run([*git, "status", "--porcelain", "machopt"], capture_output=True, text=True, check=True)
    return commit.stdout.strip() + ("+changes" if changed.stdout.strip() else "")


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", default=",".join(GROUPS), help="groups, separated by commas")
    parser.add_argument("--limit", default="", help="cases per group, or null=40,single=24")
    parser.add_argument("--draw", type=int, default=0, help="which draw of all random numbers")
    parser.add_argument("--minutes", type=float, default=0.0, help="start no case after so many minutes")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/bushing"))
    parser.add_argument("--write", action="store_true", help="store the table as results.md beside this file")
    options = parser.parse_args(arguments)
    groups = options.cases.split(",")
    if unknown := set(groups) - set(GROUPS):
        parser.error(f"--cases: unknown {sorted(unknown)}; accepted: {', '.join(GROUPS)}")
    cases = select_cases(list_cases(options.draw), groups, options.limit)
    commit, start = find_commit(), monotonic()

    def work(case: CasePlan) -> CaseScore | None:
        late = options.minutes and monotonic() - start > 60 * options.minutes
        if late and not is_finished(case, options.out, commit):
            return None
        return score_one(case, options.out, commit)

    with ThreadPoolExecutor(options.jobs) as pool:
        scores = [s for s in pool.map(work, cases) if s is not None]
    words = f"run.py --cases {options.cases} --draw {options.draw}" + (
        f" --limit {options.limit}" if options.limit else ""
    )
    report = build_report(scores, commit, words)
    print("\n" + report)
    if options.write:
        (HERE / "results.md").write_text(report)
    return 0


if __name__ == "__main__":
    sys.exit(main())

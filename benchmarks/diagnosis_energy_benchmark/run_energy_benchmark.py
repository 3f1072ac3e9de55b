"""Make, diagnose and evaluate cases of the energy simulator.

Run: ``python benchmarks/diagnosis_energy_benchmark/run_energy_benchmark.py --set dev --fast --out out/energy``.

Each diagnosis runs by the command line in an empty folder that holds only the cell and the recording.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parent))
import evaluate_answers
import make_cases
from case_catalogue import SETS, chosen

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 600.0  # s a diagnosis may take


def diagnose(case: Path, extra: list[str]) -> tuple[str, float, str]:
    """One case; its answer comes back to ``case``/out. Returns name, seconds, what went wrong."""
    start = perf_counter()
    shutil.rmtree(case / "out", ignore_errors=True)
    (case / "run.json").unlink(missing_ok=True)
    code, problem = -1, ""
    with tempfile.TemporaryDirectory(prefix="stranger_") as room:
        for part in ("cell", "recording"):
            shutil.copytree(case / part, Path(room) / part)
        command = [sys.executable, "-m", "machopt.cli", "diagnose", "cell", "recording", "-o", "out", "--quiet", *extra]
        path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
        # one thread each: as many diagnoses as cores run side by side
        room_of = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        try:
            answer = subprocess.run(
                command, cwd=room, capture_output=True, text=True, check=False, timeout=LONGEST, env=room_of
            )
            code = answer.returncode
            problem = "" if code == 0 else f"exit code {code}: {answer.stderr.strip()[-400:]}"
        except subprocess.TimeoutExpired:
            problem = f"took longer than {LONGEST:.0f} s"
        if (Path(room) / "out").is_dir():
            shutil.copytree(Path(room) / "out", case / "out")
    seconds = perf_counter() - start
    answered = {"seconds": round(seconds, 1), "exit_code": code, "problem": problem}
    (case / "run.json").write_text(json.dumps(answered) + "\n", encoding="utf-8")
    return case.name, seconds, problem


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=sorted(SETS), default="dev")
    parser.add_argument("--seed", type=int, default=0, help="another draw of the whole set, from 1")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--fast", action="store_true", help="a subset of about thirty")
    parser.add_argument("--share", type=float, default=1.0, help="an even share of the cases, fixed by their names")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", action="store_true", help="do not make or diagnose again what is there")
    parser.add_argument("--extra", nargs=argparse.REMAINDER, default=[], help="options handed to machopt diagnose")
    options = parser.parse_args(arguments)
    names = [c.name for c in chosen(options.only, options.fast, options.share)]
    if not (options.keep and all((options.out / f"{n}.truth.json").is_file() for n in names)):
        again = [
            "--set",
            options.set,
            "--seed",
            str(options.seed),
            "--out",
            str(options.out),
            "--share",
            str(options.share),
        ]
        again += ["--jobs", str(options.jobs)] + ["--fast"] * options.fast
        if code := make_cases.main([*again, *(["--only", *options.only] if options.only else [])]):
            return code
    todo = [n for n in names if not (options.keep and (options.out / n / "run.json").is_file())]
    start = perf_counter()
    with ThreadPoolExecutor(options.jobs) as pool:
        for name, seconds, problem in pool.map(lambda n: diagnose(options.out / n, options.extra), todo):
            print(f"{name}  {seconds:6.1f} s  {problem[:160]}".rstrip(), flush=True)
    print(f"{len(todo)} diagnoses, {perf_counter() - start:.0f} s in all\n")
    return evaluate_answers.main([str(options.out)])


if __name__ == "__main__":
    sys.exit(main())

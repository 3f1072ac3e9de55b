"""Generate, diagnose and score cases with hidden effects.

Run: ``python benchmarks/diagnosis_chain_benchmark/run_chain_benchmark.py --set dev --out out/chain``.

Each diagnosis runs in a folder of its own that holds only the cell and the recording, through the command line.
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
import generate_cases
import score_diagnoses

COMMAND = [sys.executable, "-m", "machopt.cli", "diagnose"]
LONGEST = 900.0  # s a diagnosis may take


def available() -> str:
    """Empty where the command exists, else what it answered."""
    answer = subprocess.run([*COMMAND, "--help"], capture_output=True, text=True, check=False, env=_environment())
    return "" if answer.returncode == 0 else (answer.stderr or answer.stdout).strip()


def diagnose(case: Path, extra: list[str]) -> tuple[str, float, str]:
    """One case; its answer comes back to ``case``/out. Returns name, seconds, what went wrong."""
    start = perf_counter()
    for old in ("out", "run.json"):
        target = case / old
        if target.is_dir():
            shutil.rmtree(target)
        target.unlink(missing_ok=True)
    problem = ""
    with tempfile.TemporaryDirectory(prefix="concealed_") as room:
        for part in ("cell", "recording"):
            shutil.copytree(case / part, Path(room) / part)
        try:
            answer = subprocess.run(
                [*COMMAND, "cell", "recording", "-o", "out", "--quiet", *extra],
                cwd=room,
                capture_output=True,
                text=True,
                check=False,
                timeout=LONGEST,
                env=_environment(),
            )
            code = answer.returncode
            if code != 0:
                problem = f"exit code {code}: {answer.stderr.strip()[-300:]}"
        except subprocess.TimeoutExpired:
            code, problem = -1, f"took longer than {LONGEST:.0f} s"
        if (Path(room) / "out").is_dir():
            shutil.copytree(Path(room) / "out", case / "out")
    seconds = perf_counter() - start
    (case / "run.json").write_text(json.dumps({"seconds": seconds, "exit_code": code, "problem": problem}) + "\n")
    return case.name, seconds, problem


def _environment() -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(p for p in (root, os.environ.get("PYTHONPATH", "")) if p)
    # one thread each: as many diagnoses as cores run side by side
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=sorted(generate_cases.SETS), default="dev")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="*", default=[], metavar="PATTERN")
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument(
        "--seed", type=int, default=0, help="which draw of the set; one that nobody has answered judges"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", action="store_true", help="do not generate again what is there")
    parser.add_argument("--extra", nargs=argparse.REMAINDER, default=[], help="options handed to machopt diagnose")
    options = parser.parse_args(arguments)
    missing = available()
    if missing:
        print(f"machopt diagnose cannot be run, so nothing was scored. It answered:\n{missing}", file=sys.stderr)
        return 3
    names = [c[0] for c in generate_cases.chosen(options.set, options.only, options.fast, options.rounds, options.seed)]
    if not (options.keep and all((options.out / f"{n}.truth.json").is_file() for n in names)):
        again = [
            "--set",
            options.set,
            "--out",
            str(options.out),
            "--rounds",
            str(options.rounds),
            "--seed",
            str(options.seed),
            "--jobs",
            str(options.jobs),
        ]
        again += ["--fast"] * options.fast + (["--only", *options.only] if options.only else [])
        if code := generate_cases.main(again):
            return code
    start, times = perf_counter(), []
    with ThreadPoolExecutor(options.jobs) as pool:
        for name, seconds, problem in pool.map(lambda n: diagnose(options.out / n, options.extra), names):
            times.append(seconds)
            print(f"{name}  {seconds:6.1f} s  {problem}".rstrip())
    print(
        f"\n{len(times)} diagnoses, {sum(times) / len(times):.1f} s each, longest {max(times):.1f} s, "
        f"{perf_counter() - start:.0f} s in all\n"
    )
    return score_diagnoses.main([str(options.out)])


if __name__ == "__main__":
    sys.exit(main())

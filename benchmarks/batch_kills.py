"""SIGKILL of ``machopt batch`` at random moments: what is finished stays, and the end is the same bytes.

``python benchmarks/batch_kills.py [--kills 100] [--seed 1]`` kills a batch of small jobs so many times, resumes it and
prints what it found; exit code 1 where a finished job was lost or broken. The batch is forked from this program, which
has everything imported: a kill costs a run of the jobs, not a start of Python. ``optimize_kills.py`` does the same to a
plan.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
JOBS = 6


def main(argv: list[str] | None = None) -> int:
    """Print the table; returns 1 where an output folder was anything but old or new."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kills", type=int, default=100, metavar="N", help="how many (100)")
    options.add_argument("--seed", type=int, default=1)
    args = options.parse_args(argv)
    with tempfile.TemporaryDirectory() as place:
        found = kill_batch(Path(place), args.kills, random.Random(args.seed))
    print(", ".join(f"{n} {what}" for what, n in sorted(found.items())))
    return int(any(what.startswith("WRONG") for what in found))


def kill_batch(place: Path, kills: int, draw: random.Random) -> Counter[str]:
    """A batch of small jobs, killed and resumed until it is through; then another."""
    from batch_stub_jobs import contents, folder_of, request_for

    from machopt.batch.run import run_batch

    jobs = folder_of(place, **{f"job{n}": "sleep 0.1" for n in range(JOBS)})
    found = Counter[str]()

    def run(out: Path) -> None:
        run_batch(request_for(jobs, out, workers=2))

    pid = forked(lambda: run(place / "whole"))
    begin = time.monotonic()
    os.waitpid(pid, 0)
    length = time.monotonic() - begin
    wanted, number, had = contents(place / "whole"), 0, set[str]()
    for _ in range(kills):
        out = place / f"out{number}"
        pid = forked(lambda o=out: run(o))  # type: ignore[misc]
        time.sleep(draw.uniform(0.0, length))
        ended = killed(pid)
        finished = {f.parent.name for f in out.glob("jobs/*/job.json")} if out.is_dir() else set()
        broken = [f for f in finished if not readable(out / "jobs" / f / "job.json")]
        if had - finished or broken:
            found["WRONG: a finished job was lost or broken"] += 1
        elif not ended:
            found["killed, and what was finished stayed"] += 1
        had = finished
        if ended:
            same = contents(out) == wanted
            found["through, the same bytes as undisturbed" if same else "WRONG: other bytes than undisturbed"] += 1
            number, had = number + 1, set()
    return found


def forked(work: Callable[[], None]) -> int:
    """Do the work in a process and a session of its own; returns its id."""
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.setsid()
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                work()
            code = 0
        finally:
            os._exit(code)
    return pid


def killed(pid: int) -> bool:
    """Kill the process; True where it had ended by itself before."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    return not os.WIFSIGNALED(os.waitpid(pid, 0)[1])


def readable(file: Path) -> bool:
    """A whole record of a job."""
    try:
        return "key" in json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        return False


if __name__ == "__main__":
    sys.exit(main())

"""Cycle time of method joint against the fixed path at equal tolerance and the same feed cap, on five milling jobs.

Run: ``python benchmarks/joint_method.py [--only NAME] [--keep FOLDER]``.

Both plans begin with ``objective: tolerance``. The fixed path keeps the postures of that plan and has its own feed
advice, re-timed; the joint result has other postures and their advice. Neither exceeds the feed cap of the job
(:mod:`joint_method_jobs`). The goal is a median gain of 15 %, and no job that takes longer. Processor time is that of
the whole command, per 1,000 points of the toolpath, without compilation.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from joint_method_jobs import CELL, JointMethodJob, list_jobs

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize

GOAL_PERCENT = 15.0  # median gain of the jobs
CPU_PER_THOUSAND_S = 60.0


@dataclass(frozen=True)
class JointMethodRow:
    """Figures of one job."""

    name: str
    points: int
    fixed_s: float
    joint_s: float  # cycle time of what is driven
    windows: str
    in_tolerance: str
    cpu_s: float
    is_verified: bool
    reason: str

    @property
    def gain_percent(self) -> float:
        """Share of the cycle time saved."""
        return 100.0 * (1.0 - self.joint_s / self.fixed_s)


def run_job(job: JointMethodJob, folder: Path) -> JointMethodRow:
    """Plan one job with method joint and return its figures."""
    toolpath = folder / f"{job.name}.csv"
    job.write(toolpath)
    request = OptimizeRequest(
        cell=CELL,
        toolpath=toolpath,
        out=folder / job.name,
        process=CELL / "process.yaml",
        direct={"method": "joint", "objective": "tolerance"},
        overwrite=True,
    )
    begin = time.process_time()
    outcome = run_optimize(request)
    cpu = time.process_time() - begin
    result = outcome.result
    assert result.joint is not None
    assert result.process is not None
    entry = result.joint[0]
    after = result.process.in_tolerance.after
    return JointMethodRow(
        name=job.name,
        points=result.toolpath.points,
        fixed_s=entry.fixed_path_s or float("nan"),
        joint_s=result.cycle_time_s or float("nan"),
        windows=f"{sum(w.accepted for w in entry.windows)} of {len(entry.windows)}",
        in_tolerance=f"{after['pass']} of {result.toolpath.cutting_points}",
        cpu_s=cpu,
        is_verified=outcome.exit_code == 0,
        reason=entry.reason,
    )


def print_rows(rows: list[JointMethodRow]) -> None:
    """Print the table and the verdicts."""
    print("| job | points | fixed path s | joint s | gain % | windows | in tolerance | CPU s/1,000 points | verified |")
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        print(
            f"| {r.name} | {r.points} | {r.fixed_s:.2f} | {r.joint_s:.2f} | {r.gain_percent:.1f} | {r.windows} "
            f"| {r.in_tolerance} | {1e3 * r.cpu_s / r.points:.1f} | {'yes' if r.is_verified else 'NO'} |"
        )
        if r.reason:
            print(f"  {r.name}: {r.reason}")
    median = statistics.median(r.gain_percent for r in rows)
    print(f"median gain {median:.1f} % (goal {GOAL_PERCENT:g} %), least {min(r.gain_percent for r in rows):.1f} %")
    print(f"all verified: {all(r.is_verified for r in rows)}")
    slow = [r.name for r in rows if 1e3 * r.cpu_s / r.points > CPU_PER_THOUSAND_S]
    print(f"above {CPU_PER_THOUSAND_S:g} CPU s per 1,000 points: {', '.join(slow) or 'none'}")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=[job.name for job in list_jobs()])
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep toolpaths and output folders there")
    args = parser.parse_args()
    jobs = [job for job in list_jobs() if not args.only or job.name in args.only]
    folder = args.keep or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    try:
        print_rows([run_job(job, folder) for job in jobs])
    finally:
        if args.keep is None:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()

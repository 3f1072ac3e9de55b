"""Stiffness or stability: what weight and least ratio of stability cost, on shipped milling jobs.

Run: ``python benchmarks/stability_choice.py [toolpath…]``. Cell `kr500_milling` with its process.yaml (end mill of
17 mm, 6 mm deep at 12,000 rpm, 7075, damping assumed at 3 %). Each job is planned for stiffness alone, with
``weights.stability`` 30, and with ``min_stability_ratio`` 1 and 1.2. Printed for each: mean and worst deflection, least
stable depth over planned depth, unstable points, cycle time, verdict. Then, at points of the first job over the range
of limits, the limit of the planner beside the exact one: modes by the code of the verification, and semi-discretization
with 24 intervals a tooth period (`tests/process/delay_reference.py`).
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from process.delay_reference import first_unstable, semi_discretization_radius  # noqa: E402
from stability_postures import build_delay_system, choose_rows  # noqa: E402

from machopt.commands.optimize.request import OptimizeRequest  # noqa: E402
from machopt.commands.optimize.run import run_optimize  # noqa: E402
from machopt.data_types.documents.optimize_document import OptimizeDocument  # noqa: E402

CELL = ROOT / "cells" / "kr500_milling"
JOBS = ("plain.csv", "cylinder_head_face.cls", "contour_5axis.csv")
CHOICES = (
    ("stiffness only", ()),
    ("weight 30", ("weights={stability: 30}",)),
    ("least ratio 1", ("min_stability_ratio=1",)),
    ("least ratio 1.2", ("min_stability_ratio=1.2",)),
)
INTERVALS, POSTURES = 24, 5


def plan(job: str, overrides: tuple[str, ...], out: Path) -> OptimizeDocument:
    """Plan one job."""
    request = OptimizeRequest(
        cell=CELL,
        toolpath=ROOT / "toolpaths" / job,
        out=out,
        overrides=overrides,
        process=CELL / "process.yaml",
    )
    return run_optimize(request).result


def print_choice(name: str, result: OptimizeDocument) -> None:
    """Print one line."""
    process, chosen, scale = result.process, result.objective.chosen, result.index_scale
    stability = None if process is None else process.stability
    if result.cycle_time_s is None or stability is None or chosen.mean is None or chosen.worst is None:
        reasons = {p.status for p in result.infeasible_points} | {b.code for b in result.breaks}
        print(f"  {name:16} infeasible: {len(result.infeasible_points)} points, {', '.join(sorted(reasons))}")
        return
    assert scale is not None
    passed = result.verification is not None and result.verification.passed
    print(
        f"  {name:16} mean {1e3 * scale * chosen.mean:.4f} mm, worst {1e3 * scale * chosen.worst:.4f} mm, least ratio "
        f"{stability.least_ratio:.2f}, unstable {stability.unstable} of {stability.unstable + stability.stable}, "
        f"{result.cycle_time_s:.1f} s, {'verified' if passed else 'NOT verified'}"
    )


def compare_with_reference(job: str, out: Path) -> None:
    """Print the limits of some points of a plan beside the exact ones."""
    for row, limit in choose_rows(out, POSTURES):
        system, _ = build_delay_system(CELL, CELL / "process.yaml", ROOT / "toolpaths" / job, out, row)
        exact = first_unstable(
            lambda depth, system=system: semi_discretization_radius(system, depth, INTERVALS),
            0.2 * limit,
            3.0 * limit,
            1.02,
        )
        print(f"  point {row:5}: {1e3 * limit:7.3f} mm, semi-discretization {1e3 * exact:7.3f} mm, {limit / exact:.3f}")


def main() -> None:
    """Plan all jobs and print."""
    jobs = tuple(sys.argv[1:]) or JOBS
    with tempfile.TemporaryDirectory() as folder:
        for job in jobs:
            print(job)
            for n, (name, overrides) in enumerate(CHOICES):
                print_choice(name, plan(job, overrides, Path(folder) / f"{job}_{n}"))
        print(f"limits of {jobs[0]}, stiffness only")
        compare_with_reference(jobs[0], Path(folder) / f"{jobs[0]}_0")


if __name__ == "__main__":
    main()

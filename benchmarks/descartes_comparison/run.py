"""Planning time and result against Tesseract's Descartes planner: ``python benchmarks/descartes_comparison/run.py``.

Needs ``pip install machopt[compare]``. Two jobs: ``main_job`` of ``optimize_time.py`` and ``crowded`` of
``obstacle_job.py``. Both planners get the same triangles, pairs, clearance, joint limits and rotations.
Descartes gets every point of the toolpath, and finds a sequence of configurations that are checked at the points, for
contact only: with machopt's clearance of 2 mm FCL needs about a hundred times as long. machopt's seconds include
set-up, checks of the motion between the points, clearance, smoothing, lower bound and retiming. Processor seconds of
processes of their own, the second of two runs; those of Descartes do not include reading the cell (0.3 s).
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))

VARIANTS = ("shipped", "wrapped", "stiffness")


def write_job(cell_folder: Path, toolpath: Path, folder: Path) -> None:
    """Write scene and stations of a job for Tesseract.

    Args:
        cell_folder: cell without external joints.
        toolpath: toolpath with one tool.
        folder: receives the files.
    """
    from opw_parameters import find_opw_parameters
    from scene import write_scene

    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
    from machopt.planning.pipeline.planning_setup import prepare_planning
    from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
    from machopt.planning.stations.planning_path import build_planning_path, compute_tcp_poses
    from machopt.toolpath.toolpath_reader import read_toolpath

    cell = load_cell(cell_folder)
    options = load_options(cell.plan, None, [])
    setup = prepare_planning(cell, options)
    path = build_planning_path(read_toolpath(toolpath))
    write_scene(setup, folder)
    points = np.flatnonzero(path.is_point).astype(np.int32)
    poses = setup.arm.in_base(path.external[points], compute_tcp_poses(path, points, np.zeros(len(points))))
    poses = np.linalg.inv(find_opw_parameters(setup.robot).T_base_opw) @ poses
    run = path.run[points]
    edge = np.flatnonzero(np.diff(run, prepend=-1, append=-1))
    runs = [(a, b) for a, b in itertools.pairwise(edge) if b - a > 1]
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    scores = score_candidates(path, enumerate_candidates(path, setup.arm, options), setup.elasticity, d, options)
    share = np.gradient(path.s[points]) / path.s[-1]
    np.savez(
        folder / "job.npz",
        poses=poses,
        runs=np.array(runs),
        points=points,
        step=options.rotation_step,
        clearance=options.clearance,
        weight=share,
        scale=scores.scale,
        cell=str(cell_folder),
        toolpath=str(toolpath),
    )


def plan_with_machopt(cell_folder: Path, toolpath: Path, folder: Path) -> None:
    """Write the processor seconds from the cell in memory to the retimed motion, and the joints at the points.

    Args:
        cell_folder: cell without external joints.
        toolpath: toolpath with one tool.
        folder: receives ``machopt.npz``.
    """
    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.placement.segment_task import build_single_segment
    from machopt.planning.job.job_planner import plan_job
    from machopt.planning.pipeline.planning_setup import StageTimings
    from machopt.toolpath.toolpath_reader import read_toolpath

    cell, path = load_cell(cell_folder), read_toolpath(toolpath)
    options = load_options(cell.plan, None, [])
    timings = StageTimings()
    cpu = time.process_time()
    job = plan_job(build_single_segment(cell, path), path, options, timings)
    seconds = time.process_time() - cpu
    assert job.timeline is not None
    assert job.timeline.trajectory is not None, "machopt has no complete motion"
    stages = ", ".join(f"{k} {v:.2f}" for k, v in timings.seconds.items())
    q = job.plan.chosen.assignment.q[job.plan.path.is_point]
    np.savez(folder / "machopt.npz", q=q, seconds=seconds, stages=stages)


def rate_sequence(cell_folder: Path, toolpath: Path, q: np.ndarray) -> str:
    """Return mean and worst index in units of the scale, joint travel and configuration changes of (N, 6) joints."""
    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.planning.cost.stiffness_index import compute_configuration_cost, compute_load_directions, resolve_index
    from machopt.planning.pipeline.planning_setup import prepare_planning
    from machopt.planning.stations.planning_path import build_planning_path
    from machopt.toolpath.toolpath_reader import read_toolpath

    cell = load_cell(cell_folder)
    options = load_options(cell.plan, None, [])
    setup = prepare_planning(cell, options)
    path = build_planning_path(read_toolpath(toolpath))
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    some = np.isfinite(q).all(axis=1)
    points = np.flatnonzero(path.is_point)[some]
    cost = compute_configuration_cost(setup.elasticity, d, points, q[some], resolve_index(options))
    assert setup.collision is not None
    step = np.abs(np.diff(q[some], axis=0))
    hit = setup.collision.check_motion(q[some], path.may_touch[points], np.radians(2.0)).hit
    return (
        f"{some.sum()} of {len(q)} points; index mean {1e6 * cost.mean():.2f}, worst {1e6 * cost.max():.2f} µm; "
        f"joint travel {np.degrees(step.sum()):.0f}°, largest step {np.degrees(step.max()):.1f}°; "
        f"{int(hit.sum())} moves between them in contact or too near"
    )


def run_child(*arguments: str, python: str = sys.executable) -> None:
    """Run one part in a process of its own."""
    subprocess.run([python, *arguments], check=True, cwd=Path(__file__).parent)


def compare(name: str, cell: Path, toolpath: Path, folder: Path, python: str) -> None:
    """Print the table of one job."""
    run_child("run.py", "--part", "scene", str(cell), str(toolpath), str(folder))
    rows = []
    for variant in ("machopt", *VARIANTS):
        for _ in range(2):  # the first run compiles, or reads the files
            if variant == "machopt":
                run_child("run.py", "--part", "machopt", str(cell), str(toolpath), str(folder))
            else:
                run_child("plan_with_tesseract.py", str(folder), variant, python=python)
        out = np.load(folder / f"{variant}.npz")
        rows.append((variant, float(out["seconds"]), rate_sequence(cell, toolpath, out["q"])))
        if variant == "machopt":
            print(f"{name}: stages of machopt, wall s: {out['stages']}")
    for variant, seconds, text in rows:
        print(f"  {variant:<10} {seconds:6.2f} s CPU; {text}")
    of = {variant: seconds for variant, seconds, _ in rows}
    net = of["shipped"] + of["stiffness"] - of["wrapped"]
    print(f"  ratio to Descartes as shipped {of['machopt'] / of['shipped']:.2f}")
    print(f"  ratio to Descartes with stiffness, calls to Python left out, {of['machopt'] / net:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("scene", "machopt"))
    parser.add_argument("--jobs", nargs="*", default=["main_job", "crowded"])
    parser.add_argument("--python", default=sys.executable, help="interpreter that has tesseract_robotics")
    parser.add_argument("--keep", type=Path, help="folder that keeps the scenes")
    parser.add_argument("rest", nargs="*", type=Path)
    args = parser.parse_args()
    if args.part == "scene":
        write_job(*args.rest)
        return
    if args.part == "machopt":
        plan_with_machopt(*args.rest)
        return
    import obstacle_job
    import optimize_time

    for name in args.jobs:
        with tempfile.TemporaryDirectory() as folder:
            make = optimize_time.make_job if name == "main_job" else obstacle_job.make_job
            at = (args.keep or Path(folder)) / name
            scene = at / "scene"
            scene.mkdir(parents=True)
            cell, toolpath = make(at)
            compare(name, cell, toolpath, scene, args.python)


if __name__ == "__main__":
    main()

"""Gain by the tilt of a ball cutter: deflection, cycle time, planning time, and points that only a tilt reaches.

Run: ``python benchmarks/tilt_gain.py [--only gain|rescue|motion] [--keep FOLDER]``.

* gain: two shipped jobs on the shipped milling cell with a ball of the same diameter, lead and side within ±5°, against
  the same cell without tilt. The potential is the mean of the least deflection of each station over rotations, branches
  and 25 tilts without contact, each station by itself; motion between them is not considered.
* rescue: short passes whose tool axis is inclined a little farther than the arm, its limits and the bodies permit.
* motion: J and mean deflection for several shares of the price of motion in the search with tilt.
"""

from __future__ import annotations

import argparse
import itertools
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.tool_tilt import compute_tilted_axis
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.job.job_planner import JobPlan, plan_job
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.stations.tilt_curve import tilt_path
from machopt.planning.tilt import tilt_planning

ROOT = Path(__file__).resolve().parents[1]
JOBS = ("cylinder_head_face.cls", "contour_5axis.csv")
TILT_DEG = 5.0
TILT = f"tilt_deg={{lead: [-{TILT_DEG:g}, {TILT_DEG:g}], side: [-{TILT_DEG:g}, {TILT_DEG:g}]}}"
SHARES = (1.0, 0.8, 2.0 / 3.0, 0.5)  # of the weights of travel and rotation
PLACES, AZIMUTHS = 4, 10  # of the rescue set: places on the deck, directions of the inclination
STEP_DEG, STEEPEST_DEG = 1.0, 80.0  # of the inclinations that are tried
BEYOND_DEG = (0.5, 1.5, 2.5, 3.5, 4.5)  # past the first unreachable inclination, in turn


@dataclass(frozen=True)
class TimedPlan:
    """A planned job with its processor time."""

    job: JobPlan
    cpu: float  # s

    @property
    def plan(self) -> Plan:
        """The plan."""
        return self.job.plan

    @property
    def deflection(self) -> tuple[float, float]:
        """Mean over the length cut, and worst, in mm."""
        cost = self.plan.chosen.cost
        return 1e3 * float(np.nansum(self.plan.path.weight * cost)), 1e3 * float(
            np.nanmax(cost[self.plan.path.counted])
        )

    @property
    def cycle(self) -> float:
        """Cycle time in s, NaN without a motion."""
        timeline = self.job.timeline
        return float(timeline.trajectory.time[-1]) if timeline is not None and timeline.trajectory else float("nan")

    @property
    def lost(self) -> int:
        """Number of cut points without a configuration."""
        path = self.plan.path
        return int((path.counted & path.is_point)[self.plan.missing].sum())


def make_ball_cell(folder: Path) -> Path:
    """Return a copy of the shipped milling cell whose cutter is a ball of the same diameter."""
    from ruamel.yaml import YAML

    cell = folder / "ball_cell"
    shutil.copytree(ROOT / "cells" / "kr500_milling", cell)
    yaml = YAML()
    data = yaml.load(cell / "cell.yaml")
    cutter = data["tool"]["cutter"]
    cutter["corner_radius_mm"] = cutter["diameter_mm"] / 2
    yaml.dump(data, cell / "cell.yaml")
    return cell


def plan(cell: Path, toolpath: Path, *overrides: str) -> TimedPlan:
    """Plan a job in this process."""
    given = load_optimize_inputs(OptimizeRequest(cell=cell, toolpath=toolpath, out=Path("unused"), overrides=overrides))
    start = time.process_time()
    job = plan_job(given.segments, given.toolpath, given.options, StageTimings())
    return TimedPlan(job, time.process_time() - start)


def find_least_deflection(of: Plan, tilts_deg: tuple[float, ...]) -> float:
    """Return the mean in mm of the least deflection of each station over a grid without contact."""
    path, setup, st = of.path.programmed, of.setup, of.path.stations
    costs, joints = [], []
    for lead, side in itertools.product(np.radians(tilts_deg), repeat=2):
        n = len(path.index)
        axis = compute_tilted_axis(path.axis, path.travel, np.full(n, lead), np.full(n, side))
        found = enumerate_candidates(tilt_path(path, axis, setup.ball_radius), setup.arm, of.options)
        usable = found.usable
        cost = np.full(usable.shape, np.inf)
        points = st[np.nonzero(usable)[0]]
        cost[usable] = compute_configuration_cost(
            setup.elasticity, of.directions, points, found.q[usable], "deflection"
        )
        costs.append(cost.reshape(len(st), -1))
        joints.append(found.q.reshape(len(st), -1, 6))
    cost, q = np.concatenate(costs, axis=1), np.concatenate(joints, axis=1)
    order = np.argsort(cost, axis=1)
    nth, least, open_rows = np.zeros(len(st), int), np.full(len(st), np.nan), np.arange(len(st))
    while len(open_rows) and setup.collision is not None:
        at = order[open_rows, nth[open_rows]]
        known = np.isfinite(cost[open_rows, at])
        open_rows, at = open_rows[known], at[known]
        rows = of.path.whole(q[open_rows, at], st[open_rows])
        hit = setup.collision.check_configurations(rows, path.may_touch[st[open_rows]]).hit
        least[open_rows[~hit]] = cost[open_rows[~hit], at[~hit]]
        open_rows = open_rows[hit]
        nth[open_rows] += 1
    return 1e3 * float(np.nansum(path.station_weight * least))


def measure_gain(cell: Path) -> None:
    """Print the gain on both jobs."""
    for name in JOBS:
        toolpath = ROOT / "toolpaths" / name
        plan(cell, toolpath, TILT)  # compiles what is not compiled yet
        plain, tilted = plan(cell, toolpath), plan(cell, toolpath, TILT)
        (mean, worst), (mean_tilted, worst_tilted) = plain.deflection, tilted.deflection
        free = find_least_deflection(plain.plan, (0.0,))
        free_tilted = find_least_deflection(plain.plan, (-TILT_DEG, -TILT_DEG / 2, 0.0, TILT_DEG / 2, TILT_DEG))
        reached, possible = 1.0 - mean_tilted / mean, 1.0 - free_tilted / free
        bound = tilted.plan.tilt_bound
        print(f"{name}")
        print(f"  mean deflection   {mean:.4f} -> {mean_tilted:.4f} mm ({-100 * reached:+.1f} %)")
        print(f"  worst deflection  {worst:.4f} -> {worst_tilted:.4f} mm ({100 * (worst_tilted / worst - 1):+.1f} %)")
        print(
            f"  J                 {plain.plan.chosen.objective.total:.4f} -> {tilted.plan.chosen.objective.total:.4f}"
        )
        longer = tilted.cycle / plain.cycle - 1
        print(f"  cycle time        {plain.cycle:.1f} -> {tilted.cycle:.1f} s ({100 * longer:+.1f} %)")
        print(f"  planning, CPU     {plain.cpu:.2f} -> {tilted.cpu:.2f} s (x {tilted.cpu / plain.cpu:.2f})")
        print(
            f"  point by point    {free:.4f} -> {free_tilted:.4f} mm without contact ({-100 * possible:+.1f} %): "
            f"{100 * reached / possible:.0f} % of this potential is reached"
        )
        if bound is not None:
            scale = 1e3 * tilted.plan.scores.scale
            print(
                f"  lower bound       mean {bound.mean * scale:.4f} mm, worst {bound.worst * scale:.4f} mm over "
                f"{bound.tilts} tilts x {np.degrees(bound.step):g}° x branches at {bound.stations} stations"
            )


def measure_motion_share(cell: Path) -> None:
    """Print J and mean for several prices of motion in the search with tilt."""
    own = tilt_planning.MOTION_SHARE
    for name in JOBS:
        for share in SHARES:
            tilt_planning.MOTION_SHARE = share
            found = plan(cell, ROOT / "toolpaths" / name, TILT)
            total, mean = found.plan.chosen.objective.total, found.deflection[0]
            print(f"{name}: share {share:.2f}, J {total:.4f}, mean {mean:.4f} mm")
    tilt_planning.MOTION_SHARE = own


def make_rescue_set(cell: Path, folder: Path) -> Path:
    """Return a toolpath of short passes whose axis is inclined a little farther than can be reached.

    At each place and azimuth the inclination is increased until no configuration is left; the pass has it a little
    larger still.
    """
    rng = np.random.default_rng(20261129)
    places = np.column_stack([rng.uniform(-180, 180, PLACES), rng.uniform(-70, 70, PLACES), np.zeros(PLACES)])
    azimuths = np.radians(np.arange(AZIMUTHS) * 360.0 / AZIMUTHS)
    inclination = np.arange(0.0, STEEPEST_DEG + STEP_DEG / 2, STEP_DEG)
    pairs = list(itertools.product(range(PLACES), range(AZIMUTHS)))
    trial = folder / "inclinations.csv"
    write_passes(trial, [(places[p], azimuths[a], tilt) for p, a in pairs for tilt in inclination])
    reached = find_reached_passes(cell, trial).reshape(len(pairs), len(inclination))
    passes: list[tuple[np.ndarray, float, float]] = []
    for n, (p, a) in enumerate(pairs):
        lost = np.flatnonzero(~reached[n])
        if len(lost) and lost[0] > 0:
            beyond = BEYOND_DEG[len(passes) % len(BEYOND_DEG)]
            passes.append((places[p], azimuths[a], inclination[lost[0] - 1] + STEP_DEG + beyond))
    out = folder / "unreachable_passes.csv"
    write_passes(out, passes)
    return out


def write_passes(file: Path, passes: list[tuple[Array, float, float]]) -> None:
    """Write passes of three points, 4 mm apart across the inclination; each begins and ends 30 mm off the part."""
    rows = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min"]
    for place, azimuth, inclination in passes:
        theta = np.radians(inclination)
        axis = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
        along = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        ends = [(place + 30.0 * axis, "rapid,"), (place, "approach,600")]
        ends += [(place + 4.0 * k * along, "cut,600") for k in (1, 2)]
        ends += [(place + 8.0 * along + 30.0 * axis, "retract,600")]
        rows += [",".join(f"{v:.6f}" for v in (*p, *axis)) + f",{word}" for p, word in ends]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")


def find_reached_passes(cell: Path, toolpath: Path) -> Bools:
    """Return which passes have a configuration without contact at each of their cut points, with the CAM axis."""
    given = load_optimize_inputs(
        OptimizeRequest(cell=cell, toolpath=toolpath, out=Path("unused"), overrides=("allow_gaps=true",))
    )
    from machopt.planning.pipeline.planning_setup import fix_external_axes, prepare_planning
    from machopt.planning.stations.planning_path import build_planning_path

    setup = prepare_planning(given.cell, given.options)
    path = fix_external_axes(build_planning_path(given.toolpath), given.cell.external_home)
    rows = np.flatnonzero(path.counted & path.is_point)
    path = replace(path, stations=rows.astype(np.int32))
    found = enumerate_candidates(path, setup.arm, given.options)
    usable = np.argwhere(found.usable)
    q = found.q[tuple(usable.T)]
    assert setup.collision is not None
    hit = setup.collision.check_configurations(q, np.ones(len(q), bool)).hit
    free = np.bincount(usable[~hit, 0], minlength=len(rows)) > 0
    return np.asarray(free.reshape(-1, 2).all(axis=1))


def measure_rescue(cell: Path, folder: Path) -> None:
    """Print how many cut points are reached by a tilt alone."""
    toolpath = make_rescue_set(cell, folder)
    plain, tilted = plan(cell, toolpath, "allow_gaps=true"), plan(cell, toolpath, "allow_gaps=true", TILT)
    rescued = plain.lost - tilted.lost
    print(f"rescue set: {int(plain.plan.path.counted.sum())} cut points, {plain.lost} cannot be reached without tilt")
    print(f"  {rescued} of them are with it ({100 * rescued / max(plain.lost, 1):.0f} %)")
    print(f"  planning, CPU     {plain.cpu:.2f} -> {tilted.cpu:.2f} s (x {tilted.cpu / plain.cpu:.2f})")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("gain", "rescue", "motion"))
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where cell and toolpath are left")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        cell = make_ball_cell(folder)
        if args.only in (None, "gain"):
            measure_gain(cell)
        if args.only in (None, "motion"):
            measure_motion_share(cell)
        if args.only in (None, "rescue"):
            measure_rescue(cell, folder)


if __name__ == "__main__":
    main()

"""Our tree search for rapid moves beside OMPL's RRT-Connect: success, time, length and duration of the ways found.

Run: ``python benchmarks/rapid_moves_ompl.py [--moves 20] [--seconds 10] [--range 0.5]`` in an environment that has
``ompl`` (``pip install ompl``) beside machopt. Random pairs of free poses in the shipped KR500 cell between four tall
posts (``benchmarks/obstacle_job.py``) whose straight line is blocked; both planners ask the same collision model, know
no detours, and their ways are timed by the same law (at rest at every corner). OMPL simplifies its way as it does by
default.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from obstacle_job import make_job

SEED = 1
STEP = np.radians(1.0)


@dataclass(frozen=True)
class Way:
    """One planner's answer."""

    seconds: float  # that it took, in all
    search: float  # of these until there was a way, before it was made shorter; the same where that is not told
    points: Any  # (W, 6) rad, None where it found none


def blocked_moves(setup: Any, count: int) -> list[tuple[Any, Any]]:
    """Pairs of free poses that the straight line does not join, near the part as rapid moves are."""
    rng, model, home = np.random.default_rng(SEED), setup.collision, setup.driven.home[:6]
    low, high = setup.driven.limits.lower[:6], setup.driven.limits.upper[:6]
    spread = np.radians([40, 35, 35, 120, 80, 150])
    out: list[tuple[np.ndarray, np.ndarray]] = []
    while len(out) < count:
        ends = np.clip(home + rng.uniform(-1, 1, (2, 6)) * spread, low, high)
        still = np.zeros(2, bool)
        if not model.check(ends, still).any and model.check_motion(ends, still, STEP, first_only=True).any:
            out.append((ends[0], ends[1]))
    return out


def ours(setup: Any, a: Any, b: Any, seed: int) -> Way:
    from machopt.planning.motion.rapid_moves import FreeSpace, RapidMove, RapidTiming, plan_rapid

    start = time.perf_counter()
    found = plan_rapid(
        a,
        b,
        timing=RapidTiming(setup.driven.limits, scale=0.8, sample=0.012),
        space=FreeSpace(collision=setup.collision, step=STEP),
        detours=list,
        rng=np.random.default_rng(seed),
    )
    took = time.perf_counter() - start
    return Way(took, took, found.waypoints if isinstance(found, RapidMove) else None)


def ompl_way(setup: Any, a: Any, b: Any, seconds: float, planner: str, step: float) -> Way:
    from ompl import base as ob
    from ompl import geometric as og

    model, low, high = setup.collision, setup.driven.limits.lower[:6], setup.driven.limits.upper[:6]
    space = ob.RealVectorStateSpace(6)
    bounds = ob.RealVectorBounds(6)
    for k in range(6):
        bounds.setLow(k, float(low[k]))
        bounds.setHigh(k, float(high[k]))
    space.setBounds(bounds)
    simple = og.SimpleSetup(space)
    info = simple.getSpaceInformation()

    def joints(state: Any) -> Any:
        return np.array([state[k] for k in range(6)])

    class Straight(ob.MotionValidator):  # type: ignore[misc, name-defined]
        def checkMotion(self, s1: Any, s2: Any, *_: Any) -> bool:
            rows = np.array([joints(s1), joints(s2)])
            return not model.check_motion(rows, np.zeros(2, bool), STEP, first_only=True).any

    validator = Straight(info)
    simple.setStateValidityChecker(lambda state: not model.check(joints(state)[None], np.zeros(1, bool)).any)
    info.setMotionValidator(validator)
    start, goal = space.allocState(), space.allocState()
    for k in range(6):
        start[k], goal[k] = float(a[k]), float(b[k])
    simple.setStartAndGoalStates(start, goal)
    chosen = getattr(og, planner)(info)
    if step > 0:
        chosen.setRange(step)
    simple.setPlanner(chosen)
    began = time.perf_counter()
    solved = simple.solve(seconds)
    searched = time.perf_counter() - began
    if solved and simple.haveExactSolutionPath():
        simple.simplifySolution(seconds)
        path = simple.getSolutionPath()
        points = np.array([joints(path.getState(n)) for n in range(path.getStateCount())])
        return Way(time.perf_counter() - began, searched, points)
    return Way(searched, searched, None)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=20)
    parser.add_argument("--skip", type=int, default=0, help="of these, the first ones")
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="of search, and again of simplifying, for OMPL (10)"
    )
    parser.add_argument("--range", type=float, default=0.0, help="rad, longest step of OMPL's tree (0: its own choice)")
    parser.add_argument("--planner", default="RRTConnect", help="of ompl.geometric (RRTConnect)")
    args = parser.parse_args()
    try:
        from ompl import util
    except ImportError:
        print("this benchmark needs OMPL, which machopt does not depend on: pip install ompl", file=sys.stderr)
        return 2
    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.planning.motion.rapid_moves import retime_straight_segments
    from machopt.planning.pipeline.planning_setup import prepare_planning

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(SEED)
    with tempfile.TemporaryDirectory() as name:
        cell = load_cell(make_job(Path(name), 10)[0])
        setup = prepare_planning(cell, load_options(cell.plan, None, []))
    assert setup.collision is not None
    found: dict[str, list[Way]] = {"ours": [], args.planner: []}
    moves = blocked_moves(setup, args.moves)[args.skip :]
    for n, (a, b) in enumerate(moves):
        found["ours"].append(ours(setup, a, b, args.skip + n))
        found[args.planner].append(ompl_way(setup, a, b, args.seconds, args.planner, args.range))
        print(
            n, *(f"{k} {w[-1].seconds:.2f} s {'found' if w[-1].points is not None else '-'}" for k, w in found.items())
        )
    both = [n for n in range(len(moves)) if all(w[n].points is not None for w in found.values())]
    for name, ways in found.items():
        got = [w for w in ways if w.points is not None]
        length = [np.degrees(np.abs(np.diff(ways[n].points, axis=0)).sum()) for n in both]
        drive = [
            (len(retime_straight_segments(ways[n].points, setup.driven.limits, 0.8, 0.012)) - 1) * 0.012 for n in both
        ]
        free = [not setup.collision.check_motion(w.points, np.zeros(len(w.points), bool), STEP).any for w in got]
        took = [w.seconds for w in ways]
        corners = np.mean([len(ways[n].points) - 2 for n in both])
        print("seconds:", " ".join(f"{w.search:.2f}/{w.seconds:.2f}" for w in ways))
        print(
            f"{name}: {len(got)} of {len(ways)} found, all free: {all(free)}; median {np.median(took):.2f} s, "
            f"mean {np.mean(took):.2f} s, longest {max(took):.2f} s; search alone: median "
            f"{np.median([w.search for w in ways]):.2f} s"
        )
        print(
            f"  the {len(both)} found by both: median {np.median(length):.0f}° summed over the joints (mean "
            f"{np.mean(length):.0f}°), {np.median(drive):.2f} s to drive ({np.mean(drive):.2f} s), "
            f"{corners:.1f} corners"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())

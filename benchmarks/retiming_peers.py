"""Time laws of machopt, toppra and copp-py on the same joint paths: ``python benchmarks/retiming_peers.py``.

Needs ``pip install machopt[compare]``. A KR500-like arm on a closed five-axis curve, at three programmed feeds and
two densities. All keep 0.97 of the joints' limits and the programmed feed (a seventh coordinate of the peers is the
length of path). toppra and copp-py's ``topp2_ra`` know no jerk limits: their motion is a lower bound that no drive
follows. ``topp3_lp`` of copp-py keeps jerk limits; its stations are the points of the path. The peers get the quintic
spline through the joints, machopt keeps the TCP on the lines of the program within 0.015 mm. Processor seconds of the
second of two runs, without building the spline.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from retiming_time import loop
from test_retiming import make

from machopt.planning.retiming.run_retiming import RunInput, RunTrajectory, retime_run

POINTS = (1000, 5000)
LENGTH = 2.0  # m of each path
FEEDS = (0.025, 0.1, 0.4)  # m/s


@dataclass(frozen=True)
class PeerProblem:
    """One path for the peers: joints and length of path over the length of path, and symmetric limits."""

    s: NDArray[np.float64]  # (n,) m
    spline: BSpline  # (n,) → (n, 7) rad and m
    velocity: NDArray[np.float64]  # (7,)
    acceleration: NDArray[np.float64]
    jerk: NDArray[np.float64]


def build_problem(run: RunInput) -> PeerProblem:
    """Return the path of a run; the seventh limits of acceleration and jerk do not bind."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(run.position, axis=0), axis=1))])
    limits = run.limits
    top = [run.limit_scale * np.asarray(v) for v in (limits.velocity, limits.acceleration, limits.jerk)]
    return PeerProblem(
        s=s,
        spline=make_interp_spline(s, np.column_stack([run.q, s]), k=5),
        velocity=np.append(top[0], run.feed[1]),
        acceleration=np.append(top[1], 1e3),
        jerk=np.append(top[2], 1e6),
    )


def retime_with_toppra(problem: PeerProblem) -> float:
    """Return the duration of the motion in s."""
    import toppra
    from toppra import algorithm, constraint

    class Curve(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        """The spline as toppra sees a path."""

        dof, path_interval = 7, np.array([problem.s[0], problem.s[-1]])
        waypoints = None

        def __call__(self, positions: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]:
            return np.asarray(problem.spline(positions, nu=order))

    limits = [np.column_stack([-v, v]) for v in (problem.velocity, problem.acceleration)]
    constraints = [constraint.JointVelocityConstraint(limits[0]), constraint.JointAccelerationConstraint(limits[1])]
    solver = algorithm.TOPPRA(constraints, Curve(), gridpoints=problem.s, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    return float((2 * np.diff(problem.s) / (speed[1:] + speed[:-1])).sum())


def retime_with_copp(problem: PeerProblem, *, jerk: bool) -> float:
    """Return the duration of the motion in s.

    Args:
        problem: path and limits.
        jerk: keep the jerk limits.
    """
    import copp_py as copp

    robot = copp.Robot(7, capacity=len(problem.s))
    robot.append_s(problem.s)
    q, dq, ddq, dddq = (np.asarray(problem.spline(problem.s, nu=k)) for k in range(4))
    robot.set_q(q, dq, ddq, 0, dddq=dddq)
    robot.add_velocity_limits(problem.velocity, -problem.velocity, start_idx_s=0, length=len(q))
    robot.add_acceleration_limits(problem.acceleration, -problem.acceleration, start_idx_s=0, length=len(q))
    second = copp.solver.topp2_ra.Problem(robot.constraints, idx_s_interval=(0, len(q) - 1), a_boundary=(0.0, 0.0))
    a = copp.solver.topp2_ra.solve(second)
    if not jerk:
        return float(copp.interpolation.s_to_t_topp2(problem.s, a)[0])
    robot.add_jerk_limits(problem.jerk, -problem.jerk, start_idx_s=0, length=len(q))
    third = copp.solver.topp3_lp.Problem(
        robot.constraints, a, idx_s_start=0, a_boundary=(0.0, 0.0), b_boundary=(0.0, 0.0), num_stationary_max=1
    )
    return float(copp.interpolation.s_to_t_topp3(problem.s, copp.solver.topp3_lp.solve(third))[0])


def measure(work: Callable[[], float]) -> str:
    """Return motion and processor seconds of the second of two runs, or why there is no motion."""
    try:
        work()
        start = time.process_time()
        seconds = work()
        return f"{seconds:8.2f} {time.process_time() - start:7.3f}"
    except Exception as problem:  # noqa: BLE001  # what a peer cannot solve is a result of the comparison
        return f"  none: {type(problem).__name__}"


def retime(run: RunInput) -> float:
    """Return the duration of machopt's motion in s."""
    out = retime_run(run)
    if not isinstance(out, RunTrajectory):
        raise TypeError(str(out))
    return float(out.duration)


def main() -> None:
    print("motion s and processor s of machopt | copp-py topp3_lp (jerk) | copp-py topp2_ra | toppra (no jerk)")
    for points in POINTS:
        for feed in FEEDS:
            run = make(*loop(points, LENGTH / points), feed=feed)
            problem = build_problem(run)
            columns = (
                measure(lambda run=run: retime(run)),  # type: ignore[misc]
                measure(lambda problem=problem: retime_with_copp(problem, jerk=True)),  # type: ignore[misc]
                measure(lambda problem=problem: retime_with_copp(problem, jerk=False)),  # type: ignore[misc]
                measure(lambda problem=problem: retime_with_toppra(problem)),  # type: ignore[misc]
            )
            print(f"{points:>6} points, {6e4 * feed:>6.0f} mm/min: " + " | ".join(columns))


if __name__ == "__main__":
    main()

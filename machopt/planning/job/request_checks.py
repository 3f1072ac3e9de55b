"""Requests that no plan can answer, and from a plan to its motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering import refuse_narrow_zones, resolve_steering
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import load_robot
from machopt.numerics.array_types import Array
from machopt.planning.motion.trajectory_builder import MotionTimeline, build_timeline
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.unit_check import compute_maximum_reach, explain_wrong_unit

SAMPLES = 2e7  # 67 h at 12 ms: more is no motion but a feed in another unit


def check_length_unit(cell: Cell, toolpath: Toolpath, file: Path, *, stated: bool) -> None:
    """Refuse a path whose numbers count another unit: all out of reach is no answer to it.

    Args:
        cell: the robot cell.
        toolpath: as it was read.
        file: what it was read from.
        stated: the user gave the unit: small or far is then meant.
    """
    robot = load_robot(cell)
    machine = load_machine(cell, robot)
    stands = machine.compute_T_base_workpiece(_corners(cell))
    why = [explain_wrong_unit(toolpath, robot, T, cell.tool.T_flange_tcp, stated=stated) for T in stands]
    if all(why):  # wherever the external joints stand
        raise InputError(why[0], file=file)


def add_reach_warning(cell: Cell, toolpath: Toolpath) -> Toolpath:
    """The path with a warning where cuts lie farther from the robot than it reaches, wherever external joints stand.

    Args:
        cell: the robot cell.
        toolpath: points in the workpiece frame.
    """
    robot = load_robot(cell)
    machine = load_machine(cell, robot)
    reach = compute_maximum_reach(robot, cell.tool.T_flange_tcp)
    cuts = toolpath.position[toolpath.cutting]
    distance = np.full(len(cuts), np.inf)
    for T in machine.compute_T_base_workpiece(_corners(cell)):
        distance = np.minimum(distance, np.linalg.norm(cuts @ T[:3, :3].T + T[:3, 3] - robot.point[0], axis=1))
    beyond = int((distance > reach).sum())
    if not beyond:
        return toolpath
    told = (
        f"{beyond} of {len(cuts)} cut points lie beyond the reach of the robot ({reach:.3g} m), the farthest at "
        f"{distance.max():.4g} m: are unit (--unit), decimals (--decimals) and the pose of the workpiece right?"
    )
    return replace(toolpath, warnings=(*toolpath.warnings, told))


def _corners(cell: Cell) -> Array:
    """(N, E) home of the external joints, and the places between the ends of their ranges."""
    ends = [np.linspace(a, b, 5) for a, b in zip(cell.limits.lower[6:], cell.limits.upper[6:], strict=True)]
    grid = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, len(ends)) if ends else np.empty((0, 0))
    return np.vstack([cell.external_home, grid])


def check_fixed_rotation_method(options: PlanOptions) -> None:
    """Refuse fixed rotations and other wishes beside a method that would not keep them."""
    if (options.fixed or options.steer) and options.method != "global":
        raise InputError(
            f"method {options.method} chooses every rotation by itself and would not keep fixed ones; method global "
            "would",
            file="options",
            where="fixed" if options.fixed else "steer",
        )


def check_fixed_rotation_points(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse fixed rotations and other wishes that no plan would keep."""
    check_fixed_rotation_method(options)
    for fixed in options.fixed:
        if fixed.point >= len(toolpath):
            raise InputError(
                f"point {fixed.point} is fixed, but {toolpath.source} has points 0 to {len(toolpath) - 1}",
                file="options",
                where="fixed",
            )
    resolve_steering(options, toolpath)
    refuse_narrow_zones(options)


def check_plannable(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse wishes that no plan would keep, and a motion without end."""
    check_fixed_rotation_points(toolpath, options)
    check_motion_length(toolpath, options)


def check_motion_length(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse feeds at which the motion has more samples than any file should hold: a feed in another unit."""
    feed = np.where(np.isfinite(toolpath.feed), toolpath.feed, options.approach_feed)
    feed = np.where(toolpath.move == MoveKind.RAPID, np.inf, feed)[1:]
    seconds = np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1) / feed
    total = float(seconds.sum())
    if total > SAMPLES * options.sample:
        at = 1 + int(np.argmax(seconds))
        raise InputError(
            f"at the programmed feeds the path takes {total / 3600.0:.3g} h, {total / options.sample:.2g} samples "
            f"of {1e3 * options.sample:g} ms; expected fewer than {SAMPLES / 1e6:.0f} million. "
            f"The longest move, to point {at}, has {60e3 * feed[at - 1]:.3g} mm/min. "
            "If the feeds are in another unit, write mm/min; "
            "where they are meant, split the path, or give a larger --sample-ms",
            file=toolpath.source,
        )


def plan_motion(
    the_plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: StageTimings
) -> MotionTimeline | None:
    """The motion, unless points are missing that the user did not allow to miss."""
    cut = the_plan.path.counted
    missing = the_plan.missing
    path = the_plan.path
    needed = missing[path.may_touch[missing] | path.is_point[missing]]  # between rapid points another way may be found
    if (len(needed) or the_plan.breaks) and not options.allow_gaps:
        return None
    if cut.any() and not np.setdiff1d(np.flatnonzero(cut), missing).size:
        return None
    with timings.stage("retime"):
        return build_timeline(the_plan, toolpath)

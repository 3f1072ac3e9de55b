"""Checks of requests that no plan can satisfy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import CuttingProcess
from machopt.data_types.steering_rules import refuse_narrow_zones, resolve_steering
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import CellError, suggest_nearest_word
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.planning.plan_output.unit_check import compute_maximum_reach, explain_wrong_unit
from machopt.planning.stability.depth_ratio import find_missing_input

SAMPLES = 2e7  # 67 h at 12 ms: more indicates a feed in another unit


def check_length_unit(cell: Cell, toolpath: Toolpath, file: Path, *, stated: bool) -> None:
    """Refuse a path whose numbers are probably in another unit, instead of reporting every point as out of reach.

    Args:
        cell: the robot cell.
        toolpath: as it was read.
        file: source file of the toolpath.
        stated: the user gave the unit, so that a very small or distant path is intended.

    Raises:
        InputError: all points are out of reach, and in another unit they would not be.
    """
    robot = load_robot(cell)
    machine = load_machine(cell, robot)
    workpiece_poses = machine.compute_T_base_workpiece(_list_grid_corners(cell))
    why = [explain_wrong_unit(toolpath, robot, T, cell.tool.T_flange_tcp, stated=stated) for T in workpiece_poses]
    if all(why):  # for all positions of the external joints
        raise CellError(why[0], file=file)


def add_reach_warning(cell: Cell, toolpath: Toolpath) -> Toolpath:
    """Return the path with a warning where cuts are out of the robot's reach for all external joint positions.

    Args:
        cell: the robot cell.
        toolpath: points in the workpiece frame.
    """
    distance, reach = _compare_with_reach(cell, toolpath)
    beyond = int((distance > reach).sum())
    if not beyond:
        return toolpath
    message = (
        f"{beyond} of {len(distance)} cut points lie beyond the reach of the robot ({reach:.3g} m), the farthest at "
        f"{distance.max():.4g} m: are unit (--unit), decimals (--decimals) and the pose of the workpiece right?"
    )
    return replace(toolpath, warnings=(*toolpath.warnings, message))


def state_reach(cell: Cell, toolpath: Toolpath) -> Toolpath:
    """Return the path with its largest distance from joint 1 and the robot's reach in ``meta["reach"]``.

    Args:
        cell: the robot cell.
        toolpath: points in the workpiece frame.
    """
    distance, reach = _compare_with_reach(cell, toolpath)
    if not len(distance):
        return toolpath
    reach_text = f"{reach:.3g} m; the farthest cut point lies {distance.max():.4g} m from joint 1 of {cell.name}"
    return replace(toolpath, meta={**toolpath.meta, "reach": reach_text})


def _compare_with_reach(cell: Cell, toolpath: Toolpath) -> tuple[Array, float]:
    """Distance of each cut point from joint 1 at the best external joint positions, and the reach, m."""
    robot = load_robot(cell)
    machine = load_machine(cell, robot)
    reach = compute_maximum_reach(robot, cell.tool.T_flange_tcp)
    cuts = toolpath.position[toolpath.cutting]
    distance = np.full(len(cuts), np.inf)
    for T in machine.compute_T_base_workpiece(_list_grid_corners(cell)):
        distance = np.minimum(distance, np.linalg.norm(cuts @ T[:3, :3].T + T[:3, 3] - robot.point[0], axis=1))
    return distance, float(reach)


def _list_grid_corners(cell: Cell) -> Array:
    """Return (N, E): home of the external joints, and the grid between the ends of their ranges."""
    ends = [np.linspace(a, b, 5) for a, b in zip(cell.limits.lower[6:], cell.limits.upper[6:], strict=True)]
    grid = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, len(ends)) if ends else np.empty((0, 0))
    return np.vstack([cell.external_home, grid])


def check_fixed_rotation_method(options: PlanOptions) -> None:
    """Refuse fixed rotations and other constraints with a method that does not support them.

    Args:
        options: plan options.

    Raises:
        InputError: the method chooses every rotation by itself.
    """
    if (options.fixed or options.steer) and not options.is_searched:
        raise CellError(
            f"method {options.method} chooses every rotation by itself and would not keep fixed ones; method global "
            "would",
            file="options",
            where="fixed" if options.fixed else "steer",
        )


def check_fixed_rotation_points(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse fixed rotations and other constraints that no plan can satisfy.

    Args:
        toolpath: toolpath of the job.
        options: plan options.

    Raises:
        InputError: a constraint names a point that does not exist, or the method does not support it.
    """
    check_fixed_rotation_method(options)
    for fixed in options.fixed:
        if fixed.point >= len(toolpath):
            raise CellError(
                f"point {fixed.point} is fixed, but {toolpath.source} has points 0 to {len(toolpath) - 1}",
                file="options",
                where="fixed",
            )
    resolve_steering(options, toolpath)
    refuse_narrow_zones(options)


def check_joint_method(process: CuttingProcess | None, options: PlanOptions) -> None:
    """Refuse method joint and ``advised_feed_share`` without a tolerance to keep, and with a shifted path.

    Args:
        process: process of the cell; None: it states none.
        options: plan options.

    Raises:
        InputError: what the method needs.
    """
    if options.method != "joint" and options.advised_feed_share is None:
        return
    what, does, where = "method joint", "finds the shortest time within", "method"
    if options.method != "joint":
        what, does, where = "advised_feed_share", "lowers feeds for", "advised_feed_share"
    if process is None or not any(one.tolerance.is_given for one in process.operations):
        found = "the cell states no process" if process is None else "no operation of the process states a tolerance"
        raise CellError(
            f"{what} {does} the tolerances of the process, and {found}; a process.yaml with a tolerance (process: in "
            "cell.yaml, or --process) would work",
            file="options",
            where=where,
        )
    if options.compensate:
        raise CellError(
            f"{what} drives the path of the file, not one shifted against the deflection; compensate: false would work",
            file="options",
            where="compensate",
        )


def check_reentry_options(options: PlanOptions) -> None:
    """Refuse re-entries together with options that do not know them.

    Args:
        options: plan options.

    Raises:
        InputError: the option, and what would work.
    """
    if not options.max_reentries:
        return
    wrong = None
    if options.method != "global":
        wrong = f"method {options.method} does not choose re-entries; method global, or max_reentries 0, would work"
    elif options.compensate:
        wrong = "a path shifted against the deflection has no re-entries; compensate: false would work"
    elif options.tilts:
        wrong = "a tilted tool has no re-entries; the plan without tilt_deg would work"
    elif options.allow_gaps:
        wrong = "with gaps the tool is lifted elsewhere, too; allow_gaps: false would work"
    if wrong:
        raise CellError(wrong, file="options", where="max_reentries")


def check_plannable(toolpath: Toolpath, options: PlanOptions, process: CuttingProcess | None = None) -> None:
    """Refuse constraints that no plan can satisfy, and a motion of excessive length.

    Args:
        toolpath: toolpath of the job.
        options: plan options.
        process: process of the cell; None: it states none.

    Raises:
        InputError: with the constraint or the point.
    """
    check_fixed_rotation_points(toolpath, options)
    check_motion_length(toolpath, options)
    check_joint_method(process, options)
    check_reentry_options(options)
    if options.compensate and not options.force.given:
        raise CellError(
            "there is no force to compensate for; the process force as force_N, e.g. force_N={normal: 200}, or a "
            "process.yaml would work",
            file="options",
            where="compensate",
        )


def check_stability_ratio(segments: Sequence[ToolSegment], options: PlanOptions) -> None:
    """Refuse a least ratio of stability that cannot be computed anywhere.

    Args:
        segments: the job, divided at tool changes.
        options: plan options.

    Raises:
        InputError: with what is missing.
    """
    if options.min_stability_ratio is None:
        return
    missing = [find_missing_input(s.cell, s.toolpath) for s in segments]
    if all(missing):
        needed = " or ".join(dict.fromkeys(missing))
        raise CellError(
            f"the stability of no cut can be computed: it needs {needed}", file="options", where="min_stability_ratio"
        )
    for s in segments:
        if not find_missing_input(s.cell, s.toolpath):
            load_dynamics(s.cell)


def check_tilt(segments: Sequence[ToolSegment], options: PlanOptions) -> None:
    """Refuse a tilt of the tool axis for cutters that would cut another surface with it.

    Args:
        segments: the job, divided at tool changes.
        options: plan options with the ranges.

    Raises:
        InputError: an operation that does not exist, a method that does not choose a tilt, or a cutter that is no ball.
    """
    labels = [operation.label for operation in segments[0].whole.operations]
    for label, _ in options.tilt_operations:
        if label not in labels:
            raise CellError(
                f"{label!r} is no operation of the toolpath; {suggest_nearest_word(label, labels)}",
                file="options",
                where="operations",
            )
    if options.tilts and not options.is_searched:
        raise CellError(
            f"method {options.method} keeps the tool axis of the CAM file; method global chooses a tilt",
            file="options",
            where="tilt_deg",
        )
    for segment in segments:
        for number in np.unique(segment.toolpath.operation[segment.toolpath.cutting]).tolist():
            if options.tilt_range_of(labels[number]).is_free:
                _refuse_flat_cutter(segment.cell, labels[number], options)


def _refuse_flat_cutter(cell: Cell, label: str, options: PlanOptions) -> None:
    cutter, tool = cell.tool.cutter, f" of tool {cell.tool_name}" if cell.tool_name is not None else ""
    if cutter is not None and cutter.is_ball:
        return
    shape = (
        f"the cell states no cutter{tool}"
        if cutter is None
        else f"the cutter{tool} has a corner radius of {1e3 * cutter.corner:g} mm and a diameter of "
        f"{1e3 * cutter.diameter:g} mm"
    )
    own = label in dict(options.tilt_operations)
    raise CellError(
        f"{shape}: only a ball cutter (corner_radius_mm = half the diameter) cuts the same surface with a tilted axis; "
        f"lead [0, 0] and side [0, 0] for operation {label!r} would work",
        file="options",
        where=f"operations.{label}.tilt_deg" if own else "tilt_deg",
    )


def check_motion_length(toolpath: Toolpath, options: PlanOptions) -> None:
    """Refuse feeds at which the motion has more samples than a file should contain: a feed in another unit.

    Args:
        toolpath: toolpath of the job.
        options: plan options with the sample time.

    Raises:
        InputError: with the longest move.
    """
    feed = np.where(np.isfinite(toolpath.feed), toolpath.feed, options.approach_feed)
    feed = np.where(toolpath.move == MoveKind.RAPID, np.inf, feed)[1:]
    seconds = np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1) / feed
    total = float(seconds.sum())
    if total > SAMPLES * options.sample:
        at = 1 + int(np.argmax(seconds))
        raise CellError(
            f"at the programmed feeds the path takes {total / 3600.0:.3g} h, {total / options.sample:.2g} samples "
            f"of {1e3 * options.sample:g} ms; expected fewer than {SAMPLES / 1e6:.0f} million. "
            f"The longest move, to point {at}, has {60e3 * feed[at - 1]:.3g} mm/min. "
            "If the feeds are in another unit, write mm/min; "
            "where they are meant, split the path, or give a larger --sample-ms",
            file=toolpath.source,
        )

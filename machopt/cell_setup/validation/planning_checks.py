"""Checks of a cell for what a planner would refuse or warn of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.cell_setup.validation.process_checks import list_process_problems
from machopt.cell_setup.workpiece_placement import (
    NO_ROTATION,
    compute_pointing_rpy,
    find_flange_direction,
    is_on_last_axis,
)
from machopt.collision.bodies import CollisionBody, build_tool_bodies, is_point_inside, triangulate_shape
from machopt.collision.collision_pairs import suggest_remedy
from machopt.data_types.cell import Cell, CollisionShape
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.kinematics.inverse.solver import compute_branch_reasons
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, invert_transform
from machopt.options.plan_option_reader import find_options_without_effect, load_options
from machopt.planning.collision_handling.gouge_check import get_cutter_and_part
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.job.request_checks import check_fixed_rotation_method
from machopt.planning.pipeline.planning_setup import PlanningSetup, prepare_planning
from machopt.program_export.selected_posts import select_posts
from machopt.workspace_map.postures import add_whole_turns

_SIDEWAYS = (
    0.2  # of its distance beside the flange that a TCP is off the flange axis, where the tool is turned by mistake
)
_BEYOND = 1e-3  # m that a tool's body may stand beyond the tip along the cutting direction
_LOOSE = 0.02  # m between the shank's end and the nearest body of the tool
_ANY = ArmStiffness(joints=np.full(6, 1e6))  # to look further where the cell has none; no finding rests on it
_NO_STIFFNESS = (
    "the cell names no stiffness file, and the plan rests on it; `stiffness: stiffness.yaml` with six numbers in "
    "N·m/rad would work (machopt identify writes it, machopt init an estimate)"
)
_ROTATIONS = np.radians(np.arange(0.0, 360.0, 30.0))
_AXES = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)  # tip to shank, in CAM coordinates


@dataclass(frozen=True)
class CellRemark:
    """One thing about a cell."""

    level: Literal["error", "warning"]  # error: there is no plan, or none that could be driven
    where: str  # key of cell.yaml
    text: str  # what was found, and what would work


def list_remarks(cell: Cell) -> Iterator[CellRemark]:
    """List everything that a planner would refuse or warn of, except the reader's own errors.

    Args:
        cell: The cell.

    Returns:
        The remarks.
    """
    try:
        options = load_options(cell.plan)
    except InputError as problem:
        yield CellRemark("error", "plan", str(problem))
        options = load_options(None)
    yield from _check_options(cell, options)
    for key, message in list_process_problems(cell):
        yield CellRemark("warning", "process", f"{key}: {message}")
    setup: PlanningSetup | None = None
    if cell.stiffness is None:
        yield CellRemark("error", "stiffness", _NO_STIFFNESS)
    try:
        setup = prepare_planning(cell if cell.stiffness else replace(cell, stiffness=_ANY), options)
    except InputError as problem:
        yield CellRemark("error", problem.where or "", str(problem))
    try:
        select_posts(cell, ())
    except InputError as problem:
        yield CellRemark("error", "controller", str(problem))
    if setup is None:
        return
    yield from _check_tool(cell, setup)
    if setup.collision is not None:
        hit = setup.collision.check_configurations(_list_home_joints(cell), np.zeros(1, bool))
        if hit.any:
            pair, near = setup.collision.pairs[int(hit.pair[0])], 1e3 * options.clearance
            yield CellRemark(
                "error",
                "robot.home_deg",
                f"{pair.name} touch at home, or are nearer than {near:g} mm; no motion begins there. "
                f"Another home would work{suggest_remedy(pair)}",
            )
    yield from _check_reach(cell, setup)


def _check_options(cell: Cell, options: PlanOptions) -> Iterator[CellRemark]:
    """What a plan would refuse of the cell's options whatever its toolpath is, and what has no effect."""
    try:
        resolve_axis_options(cell, options)
    except InputError as problem:
        yield CellRemark("error", "plan.external", str(problem))
    try:
        check_fixed_rotation_method(options)
    except InputError as problem:
        yield CellRemark("error", "plan.fixed", str(problem))
    if options.gouge is not None:
        try:
            get_cutter_and_part(cell)
        except InputError as problem:
            yield CellRemark("error", "plan.gouge_tolerance_mm", str(problem))
    for message in find_options_without_effect(options):
        yield CellRemark("warning", "plan", message)


def _check_tool(cell: Cell, setup: PlanningSetup) -> Iterator[CellRemark]:
    """The tool against the flange it sits on, and against its own bodies."""
    T = cell.tool.T_flange_tcp
    tip, z, out = T[:3, 3], T[:3, 2], find_flange_direction(setup.robot)
    if out is not None:
        along, beside = float(tip @ out), float(np.linalg.norm(tip - (tip @ out) * out))
        looks = f"the flange {cell.flange_link!r} looks along {_format_vector(out)} of its own frame"
        if along < -_BEYOND:
            yield CellRemark("warning", "tool.tcp", f"the TCP lies {-1e3 * along:.0f} mm behind the flange; {looks}")
        elif along < _SIDEWAYS * beside and beside > 0.05:
            rpy = ", ".join(f"{v + 0.0:g}" for v in np.round(np.degrees(compute_pointing_rpy(out)), 3).tolist())
            yield CellRemark(
                "warning",
                "tool.tcp",
                f"the TCP lies {1e3 * beside:.0f} mm from the flange axis and {1e3 * along:.0f} mm out of it; "
                f"{looks}. If "
                f"the tool's data are of a frame whose z points away from the robot (tool0), name that link as "
                "flange_link, or turn the "
                f"tool by rpy_deg: [{rpy}]",
            )
        elif float(z @ out) < math.cos(math.radians(120.0)):
            yield CellRemark("warning", "tool.tcp", f"the TCP's z points back at the arm; {looks}")
    if is_on_last_axis(setup.robot, T):
        yield CellRemark("warning", "tool.tcp", f"{NO_ROTATION}; a tool at an angle to the flange axis would have one")
    cut = 0.0 if cell.tool.cutter is None else cell.tool.cutter.length
    bodies = build_tool_bodies(cell)
    for body in bodies:
        ahead = float(((body.vertices - tip) @ z).max())
        if ahead > _BEYOND:
            yield CellRemark(
                "warning",
                "tool.geometry",
                f"{body.name} reaches {1e3 * ahead:.0f} mm beyond the TCP the way the cutter looks, so it meets the "
                "workpiece first; the TCP's z must point out of the tool",
            )
        if is_point_inside(body, tip + _BEYOND * z):
            yield CellRemark("warning", "tool.tcp", f"the TCP lies inside {body.name}; it is the tip of the cutter")
    shank = tip - cut * z
    gap = min((_compute_box_distance(body, shank) for body in bodies), default=0.0)
    if gap > _LOOSE:
        yield CellRemark(
            "warning",
            "tool.geometry",
            f"the cutter's upper end ({1e3 * cut:g} mm behind the TCP) is {1e3 * gap:.0f} mm from the nearest body of "
            "the tool: body and TCP are not of one frame, or the cutter is longer",
        )


def _check_reach(cell: Cell, setup: PlanningSetup) -> Iterator[CellRemark]:
    """Whether some of the workpiece can be reached with the tool standing on it or against its sides."""
    corners = _list_workpiece_corners(cell)
    T_part = build_transform(
        compute_tool_rotation(
            _AXES[:, None, None], np.array([[[[1, 1, 1]]]]) / math.sqrt(3), _ROTATIONS[None, None, :]
        ),
        np.broadcast_to(corners[None, :, None, :], (len(_AXES), len(corners), len(_ROTATIONS), 3)),
    ).reshape(-1, 4, 4)
    reached, missing = np.zeros(len(corners), bool), np.inf
    limits = cell.limits
    ends = [
        np.unique([cell.external_home[k], limits.lower[6 + k], limits.upper[6 + k]])
        for k in range(len(cell.external_joints))
    ]
    for external in itertools.product(*ends):
        T = setup.arm.in_base(np.broadcast_to(np.array(external, float), (len(T_part), len(ends))), T_part)
        found = setup.arm.solver.solve(T @ invert_transform(setup.arm.T_flange_tcp))
        reason = compute_branch_reasons(found, setup.arm.margins)
        q = add_whole_turns(found.q, setup.arm.lower, setup.arm.upper, cell.home)
        ok = (reason == InfeasibilityReason.OK) & np.isfinite(q).all(axis=-1)
        reached |= ok.any(axis=1).reshape(len(_AXES), len(corners), -1).any(axis=(0, 2))
        missing = min(missing, float(found.shortfall.min()))
    if reached.all():
        return
    what = "corners of the workpiece" if cell.workpiece.geometry else "corners of 100 mm around the workpiece's frame"
    how = "with the tool from above or from the side"
    if reached.any():
        text = f"{int(reached.sum())} of {len(reached)} {what} can be reached {how}"
        yield CellRemark("warning", "workpiece.pose", text)
        return
    far = f"; the nearest lacks {1e3 * missing:.0f} mm of reach" if missing > 0 else ""
    yield CellRemark("error", "workpiece.pose", f"none of the {what} can be reached {how}{far}")


def _list_workpiece_corners(cell: Cell) -> Array:
    """(8, 3) m, of the box around the workpiece's bodies in CAM coordinates; a small one around the frame without."""
    clouds = [_list_shape_vertices(s) for s in cell.workpiece.geometry]
    if not clouds:
        return np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    points = np.concatenate(clouds)
    return np.array(list(itertools.product(*zip(points.min(axis=0), points.max(axis=0), strict=True))))


def _list_shape_vertices(shape: CollisionShape) -> Array:
    """(V, 3) m, its vertices in the frame that it is placed in."""
    T = shape.T_parent_shape
    return np.asarray(triangulate_shape(shape)[0] @ T[:3, :3].T + T[:3, 3])


def _compute_box_distance(body: CollisionBody, point: Array) -> float:
    """m from a point (3,) to the box around a body: it is no nearer to the body."""
    local = np.abs(body.box_rotation.T @ (point - body.box_centre)) - body.box_half
    return float(np.linalg.norm(np.maximum(local, 0.0)))


def _list_home_joints(cell: Cell) -> Array:
    return np.append(cell.home, cell.external_home)[None, :]


def _format_vector(v: Array) -> str:
    return f"[{', '.join(f'{x + 0.0:g}' for x in np.round(v, 3).tolist())}]"

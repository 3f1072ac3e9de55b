"""Second half of ``machopt init``: post, workpiece and home, which a plan needs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.cell_setup.template.cell_text import NewCellContent, format_cell_yaml
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.post_choice import add_post
from machopt.cell_setup.workpiece_placement import build_sample_path, find_place_or_middle, report_last_axis
from machopt.collision.collision_model_cache import load_collision_model
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_rpy_matrix
from machopt.options.plan_option_reader import load_options
from machopt.toolpath.unknown_words import read_for_plan
from machopt.workspace_map.sample_posture_computation import build_reaching_arm

_NO_ROTATION = (0.0, 0.0, 0.0)
_TRIED_ROTATIONS = (_NO_ROTATION, (0.0, 0.0, 90.0), (0.0, 0.0, 180.0), (0.0, 0.0, -90.0), (0.0, -90.0, 0.0))
"""deg, roll, pitch and yaw tried for a workpiece without a given place: flat, then upright in front of the arm."""


def complete_for_plan(
    folder: Path, new: NewCellContent, request: InitRequest, cell: Cell, robot: Robot, span: float
) -> tuple[str, ...]:
    """Write what a plan needs: post, workpiece and home.

    Args:
        folder: The new cell.
        new: Its content so far.
        request: The user's request.
        cell: The cell as it was read back.
        robot: Its arm.
        span: m, of the arm's links end to end.

    Returns:
        What is a guess, one sentence each.
    """
    new, more = add_post(new, cell)
    notes = (*report_last_axis(robot, cell.tool.T_flange_tcp), *more)
    cell = write_cell_files(folder, new)
    if request.workpiece_mm is None:
        new, more = _place_workpiece(new, request, cell, span)
        notes += more
        write_cell_files(folder, new)
    return notes


def _place_workpiece(
    new: NewCellContent, request: InitRequest, cell: Cell, span: float
) -> tuple[NewCellContent, tuple[str, ...]]:
    """The workpiece where the arm reaches it well, and home above it."""
    options = load_options(None)
    robot, shapes = load_chain(cell)
    arm, bodies = build_reaching_arm(cell, robot, options), load_collision_model(cell, robot, shapes, options.clearance)
    rest = cell.external_home

    def free(q: Array) -> bool:
        x = np.concatenate([q, np.broadcast_to(rest, (len(q), len(rest)))], axis=1)
        return not bodies.check_configurations(x, np.ones(len(q), bool)).any

    if request.toolpath is not None:
        path = read_for_plan(request.toolpath, {**get_reading_options(cell), **request.reading})
        position, axis, of = path.position, path.axis, request.toolpath.name
    else:
        position, axis = build_sample_path(span)
        of = "a block"
    T_world_base = load_machine(cell, robot).compute_T_world_base(rest[None])[0]  # position of the rail at home
    turn = compute_rpy_matrix(np.radians(new.workpiece_rpy_deg))  # of the workpiece in world
    turns = _TRIED_ROTATIONS if request.workpiece_rpy_deg is None and request.toolpath is not None else (_NO_ROTATION,)
    R = T_world_base[:3, :3].T @ turn
    found = find_place_or_middle(arm, position @ R.T, axis @ R.T, span, free, turns=turns)
    lacking = f"no place before the arm was found where it reaches all of {of}"
    if found is None:
        return new, (f"{lacking}; put in workpiece.pose and home",)
    room = f"{math.degrees(found.margin):.0f} deg to joint limits and to a stretched wrist or elbow"
    if found.share == 0.0:
        note = f"GUESS: {lacking}; its middle lies in reach"
    elif found.share == 1.0:
        note = f"GUESS: where one posture reaches all of {of} with {room}"
    else:
        note = f"GUESS: where one posture reaches most of {of}, {100 * found.share:.0f} %; another place may reach all"
    home = [float(v) for v in np.round(np.degrees(found.home), 2)]
    turned = new.workpiece_rpy_deg if found.turn == _NO_ROTATION else found.turn
    note += "" if found.turn == _NO_ROTATION else "; as it lies in the CAM file no place was found"
    at = [float(v) for v in np.round(1e3 * (T_world_base @ found.T_base_workpiece)[:3, 3])]
    placed = replace(new, workpiece_mm=at, workpiece_rpy_deg=turned, workpiece_note=note, home=[*home, *new.home[6:]])
    if found.share == 0.0:
        return placed, (f"{lacking}, so workpiece.pose has its middle in reach; a smaller tool or larger arm may do",)
    return placed, ("workpiece.pose is where the arm reaches well, not where your workpiece is",)


def write_cell_files(folder: Path, new: NewCellContent, planned: bool = True) -> Cell:
    """Write cell.yaml and read the cell back.

    Args:
        folder: The new cell.
        new: Its content.
        planned: False for an arm of more than six joints, whose readings are diagnosed only.
    """
    (folder / "cell.yaml").write_text(format_cell_yaml(new), encoding="utf-8", newline="\n")
    return load_cell(folder, any_chain=not planned)

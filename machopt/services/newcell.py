"""``machopt init``: from a robot's URDF or xacro file to a cell folder that validates."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.cells.asked import InitRequest
from machopt.cells.draft import aimed, draft
from machopt.cells.place import outward, place_or_middle, report_last_axis, sample_path
from machopt.cells.post import with_post
from machopt.cells.robotfiles import copy_file, copy_meshes, copy_robot, named_as_given, new_folder
from machopt.cells.text import NewCell, cell_text, estimated_stiffness, stiffness_text
from machopt.cells.told import InitOutcome
from machopt.domain.cell import Cell
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.schema import schema_name, schema_text
from machopt.formats.unknownwords import read_for_plan
from machopt.formats.urdf import describe_alone, find_arm
from machopt.model.collision import CollisionModel
from machopt.model.machine import load_machine
from machopt.model.robot import load_chain, load_robot
from machopt.se3 import rpy_matrix
from machopt.services.knownrobot import reading_of
from machopt.workspace.mapping import arm_of

_AS_IT_IS = (0.0, 0.0, 0.0)
_TURNS = (_AS_IT_IS, (0.0, 0.0, 90.0), (0.0, 0.0, 180.0), (0.0, 0.0, -90.0), (0.0, -90.0, 0.0))
"""deg, roll, pitch and yaw in which a workpiece is tried whose place nobody gave: flat, then upright before the arm."""


def run_init(request: InitRequest) -> InitOutcome:
    """Write a new cell.

    Raises:
        InputError: the robot cannot be read or is no six-axis arm, an option is wrong, or the folder is taken.
    """
    description = describe_alone(
        request.robot, request.packages, request.xacro_args, allow_external=request.allow_external
    )
    links = find_arm(description.urdf, request.base_link, request.flange_link)
    span = sum(j.offset for j in description.urdf.chain(links.flange_link) if j not in links.external)
    new, guesses = draft(request, description.urdf, links, span)
    with new_folder(request.out) as folder, named_as_given(folder, request):
        notes = copy_robot(description, folder, request.packages, span)
        copy_meshes(request, folder)
        for schema in ("cell.yaml", "stiffness.yaml"):
            (folder / "schemas").mkdir(exist_ok=True)
            (folder / "schemas" / schema_name(schema)).write_text(schema_text(schema), encoding="utf-8")
        if request.stiffness is not None:
            copy_file(request.stiffness, folder / "stiffness.yaml")
        else:
            text = stiffness_text(estimated_stiffness(span), span=span)
            (folder / "stiffness.yaml").write_text(text, encoding="utf-8")
            guesses += ("stiffness.yaml is estimated from the arm's size; measure it (plan-poses, identify)",)
        cell = _written(folder, new)
        robot = load_robot(cell)
        new, said = aimed(new, request, outward(robot), span)
        cell = _written(folder, new)
        new, more = with_post(new, cell)
        said += (*report_last_axis(robot, cell.tool.T_flange_tcp), *more)
        cell = _written(folder, new)
        if request.workpiece_mm is None:
            new, more = _placed(new, request, cell, span)
            said += more
            cell = _written(folder, new)
        guesses += said
    return InitOutcome(load_cell(request.out), request.out, guesses, notes)


def _placed(new: NewCell, request: InitRequest, cell: Cell, span: float) -> tuple[NewCell, tuple[str, ...]]:
    """The workpiece where the arm reaches it well, and home above it."""
    options = load_options(None)
    robot, shapes = load_chain(cell)
    arm, bodies = arm_of(cell, robot, options), CollisionModel(cell, robot, shapes, options.clearance)
    rest = cell.external_home

    def free(q: Array) -> bool:
        x = np.concatenate([q, np.broadcast_to(rest, (len(q), len(rest)))], axis=1)
        return not bodies.check(x, np.ones(len(q), bool)).any

    if request.toolpath is not None:
        path = read_for_plan(request.toolpath, **reading_of(cell), **request.reading)
        position, axis, of = path.position, path.axis, request.toolpath.name
    else:
        position, axis = sample_path(span)
        of = "a block"
    T_world_base = load_machine(cell, robot).T_world_base(rest[None])[0]  # where the rail stands at home
    turn = rpy_matrix(np.radians(new.workpiece_rpy_deg))  # of the workpiece in world
    turns = _TURNS if request.workpiece_rpy_deg is None and request.toolpath is not None else (_AS_IT_IS,)
    R = T_world_base[:3, :3].T @ turn
    found = place_or_middle(arm, position @ R.T, axis @ R.T, span, free, turns=turns)
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
    turned = new.workpiece_rpy_deg if found.turn == _AS_IT_IS else found.turn
    note += "" if found.turn == _AS_IT_IS else "; as it lies in the CAM file no place was found"
    at = [float(v) for v in np.round(1e3 * (T_world_base @ found.T_base_workpiece)[:3, 3])]
    placed = replace(new, workpiece_mm=at, workpiece_rpy_deg=turned, workpiece_note=note, home=[*home, *new.home[6:]])
    if found.share == 0.0:
        return placed, (f"{lacking}, so workpiece.pose has its middle in reach; a smaller tool or larger arm may do",)
    return placed, ("workpiece.pose is where the arm reaches well, not where your workpiece is",)


def _written(folder: Path, new: NewCell) -> Cell:
    (folder / "cell.yaml").write_text(cell_text(new), encoding="utf-8", newline="\n")
    return load_cell(folder)

"""``machopt inspect`` of a cell or a robot: joint limits, home position, pairs that may touch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from machopt.cell.cell_reader import load_cell
from machopt.cell.robot_summary import describe_mounting, list_joint_limits, summarise_robot
from machopt.cell.urdf import read_standalone_description
from machopt.collision.collision_model_cache import load_collision_model
from machopt.data_types.cell import Cell
from machopt.data_types.documents.inspect_documents import (
    IgnoredPairEntry,
    InspectedCellDocument,
    InspectedRobotDocument,
    MimicJointEntry,
)
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import InputError, TooManyArmJointsError
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.inverse.spherical_wrist import SphericalWristSolver
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.options.plan_option_reader import load_options


def inspect_cell(
    path: Path,
    *,
    allow_external: bool = False,
    effects: Sequence[Path] = (),
    packages: Mapping[str, Path] | None = None,
    xacro_args: Mapping[str, str] | None = None,
) -> InspectedCellDocument | InspectedRobotDocument:
    """Everything worth a line; mm and degrees.

    Args:
        path: a cell's folder or its cell.yaml, or a robot's URDF or xacro file.
        allow_external: let the cell, or the xacro file, use files outside its folder.
        effects: Python files with effects of the user's own that the cell's files hold; runs the code in them.
        packages: folders of ROS packages by name, of a robot's file.
        xacro_args: values of the arguments of a xacro file.

    Raises:
        InputError: it cannot be planned with, and why.
    """
    with activate_user_effects(load_effect_files(effects)):
        if path.suffix.lower() in (".urdf", ".xacro"):
            return summarise_robot(
                read_standalone_description(path, packages, xacro_args, allow_external=allow_external).urdf
            )
        for option, given in (("--package", packages), ("--xacro-arg", xacro_args)):
            if given:
                raise InputError("found a cell, whose cell.yaml has packages and xacro_args", where=option)
        cell = _load_any_arm(path, allow_external)
        return InspectedCellDocument(
            cell=cell.name,
            robot=cell.urdf.name,
            mounting=describe_mounting(cell),
            joints=list_joint_limits(cell),
            followers=tuple(
                MimicJointEntry(name=m.joint, mimics=m.source, multiplier=m.multiplier, offset=m.offset)
                for m in cell.mimics
                if m.source != m.joint  # left out: a warning names it
            ),
            **_describe_model(cell),
            warnings=tuple(cell.warnings),
            notes=tuple(cell.notes),
        )


def _load_any_arm(path: Path, allow_external: bool) -> Cell:
    """Return a cell; its arm may have more than six joints."""
    try:
        return load_cell(path, allow_external=allow_external)
    except TooManyArmJointsError:
        return load_cell(path, allow_external=allow_external, any_chain=True)


def _describe_model(cell: Cell) -> dict[str, Any]:
    """The keys of CellInspected that follow from a model; with the reason where the planner refuses the cell."""
    out: dict[str, Any] = {}
    try:
        robot, shapes = load_chain(cell)
        solver = build_solver(robot)
        closed = "closed form (spherical wrist)" if SphericalWristSolver.is_applicable(robot) else "general"
        out["inverse_kinematics"] = f"{closed}, up to {solver.branches} branches"
        out["moving_mass_kg"] = round(float(load_masses(cell).mass.sum()), 3)
        options = load_options(cell.plan, None, [])
        if options.collision:
            model = load_collision_model(cell, robot, shapes, options.clearance)
            out["pairs_checked"] = len(model.pairs)
            out["pairs_ignored"] = tuple(
                IgnoredPairEntry(a=e.a, b=e.b, why=e.reason) for e in (*model.excluded, *model.adjacent)
            )
            out["touching_at_home"] = tuple(model.suspicious)
    except InputError as problem:
        out["cannot_be_planned"] = str(problem)
    return out

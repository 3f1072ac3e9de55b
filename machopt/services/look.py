"""``machopt inspect`` of a cell or a robot: what its joints may do, how it stands, what may touch what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from machopt.domain.cell import Cell
from machopt.domain.results.inspected import CellInspected, FollowerTold, PairIgnored, RobotInspected
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.inspect_robot import joints_in_force, mounting, robot_inspected
from machopt.formats.options import load_options
from machopt.formats.urdf import describe_alone
from machopt.model.collision import CollisionModel
from machopt.model.ik import solver_for
from machopt.model.ik_spherical import SphericalWristSolver
from machopt.model.robot import load_chain, load_masses


def look(
    path: Path,
    *,
    allow_external: bool = False,
    effects: Sequence[Path] = (),
    packages: Mapping[str, Path] | None = None,
    xacro_args: Mapping[str, str] | None = None,
) -> CellInspected | RobotInspected:
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
    with in_use(with_effects(effects)):
        if path.suffix.lower() in (".urdf", ".xacro"):
            return robot_inspected(describe_alone(path, packages, xacro_args, allow_external=allow_external).urdf)
        for option, given in (("--package", packages), ("--xacro-arg", xacro_args)):
            if given:
                raise InputError("found a cell, whose cell.yaml has packages and xacro_args", where=option)
        cell = load_cell(path, allow_external=allow_external)
        return CellInspected(
            cell=cell.name,
            robot=cell.urdf.name,
            mounting=mounting(cell),
            joints=joints_in_force(cell),
            followers=tuple(
                FollowerTold(name=m.joint, mimics=m.source, multiplier=m.multiplier, offset=m.offset)
                for m in cell.mimics
                if m.source != m.joint  # left out: a warning names it
            ),
            **_model(cell),
            warnings=tuple(cell.warnings),
            notes=tuple(cell.notes),
        )


def _model(cell: Cell) -> dict[str, Any]:
    """The keys of CellInspected that follow from a model; a cell that the planner refuses is told why."""
    out: dict[str, Any] = {}
    try:
        robot, shapes = load_chain(cell)
        solver = solver_for(robot)
        closed = "closed form (spherical wrist)" if SphericalWristSolver.fits(robot) else "general"
        out["inverse_kinematics"] = f"{closed}, up to {solver.branches} branches"
        out["moving_mass_kg"] = round(float(load_masses(cell).mass.sum()), 3)
        options = load_options(cell.plan, None, [])
        if options.collision:
            model = CollisionModel(cell, robot, shapes, options.clearance)
            out["pairs_checked"] = len(model.pairs)
            out["pairs_ignored"] = tuple(
                PairIgnored(a=e.a, b=e.b, why=e.reason) for e in (*model.excluded, *model.adjacent)
            )
            out["touching_at_home"] = tuple(model.suspicious)
    except InputError as problem:
        out["cannot_be_planned"] = str(problem)
    return out

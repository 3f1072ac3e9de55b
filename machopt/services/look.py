"""``machopt inspect`` of a cell or a robot: what its joints may do, how it stands, what may touch what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from machopt.domain.cell import Cell
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.urdf import UrdfJoint, read_robot
from machopt.model.collision import CollisionModel
from machopt.model.ik import solver_for
from machopt.model.ik_spherical import SphericalWristSolver
from machopt.model.robot import load_chain, load_masses

_LEVEL = math.radians(0.5)  # a robot nearer to upright counts as upright


def look(path: Path, *, allow_external: bool = False, effects: Sequence[Path] = ()) -> dict[str, Any]:
    """Everything worth a line, JSON-able; mm and degrees.

    Args:
        allow_external: let the cell use files outside its folder.
        effects: Python files with effects of the user's own that the cell's files hold; runs the code in them.

    Raises:
        InputError: it cannot be planned with, and why.
    """
    with in_use(with_effects(effects)):
        if path.suffix.lower() in (".urdf", ".xacro"):
            return _robot(path)
        cell = load_cell(path, allow_external=allow_external)
        stands = {"cell": cell.name, "robot": cell.urdf.name, "mounting": _mounting(cell)}
        return {**stands, **_joints(cell), **_model(cell)}


def _robot(path: Path) -> dict[str, Any]:
    """A URDF by itself."""
    urdf = read_robot(path)
    return {
        "robot": urdf.path.name,
        "links": len(urdf.parts),
        "collision_bodies": sum(p.collisions for p in urdf.parts),
        "mass_kg": round(sum(p.mass or 0.0 for p in urdf.parts), 3),
        "joints": [_joint(j) for j in urdf.joints if j.moves],
        "warnings": list(urdf.warnings),
        "not_used": dict(urdf.unused),
    }


def _joint(j: UrdfJoint) -> dict[str, Any]:
    unit, scale = ("mm", 1e3) if j.kind == "prismatic" else ("deg", 180.0 / math.pi)
    ends = (round(v * scale, 3) if math.isfinite(v) else None for v in (j.lower, j.upper, j.velocity))
    row: dict[str, Any] = {"name": j.name, "kind": j.kind, "parent": j.parent, "child": j.child}
    row |= dict(zip((f"lower_{unit}", f"upper_{unit}", f"velocity_{unit}_s"), ends, strict=True))
    if j.mimic is not None:
        row |= {"mimics": j.mimic.joint, "multiplier": j.mimic.multiplier, "offset_deg": math.degrees(j.mimic.offset)}
    return row


def _mounting(cell: Cell) -> dict[str, Any]:
    R, p = cell.T_world_base[:3, :3], cell.T_world_base[:3, 3]
    tilt = math.acos(max(-1.0, min(1.0, float(R[2, 2]))))
    words = "upright" if tilt < _LEVEL else "from the ceiling" if tilt > math.pi - _LEVEL else "tilted"
    if abs(tilt - math.pi / 2) < _LEVEL:
        words = "on a wall"
    down = np.round(R.T @ np.array([0.0, 0.0, -1.0]), 6) + 0.0
    return {"stands": words, "tilt_deg": round(math.degrees(tilt), 3), "xyz_mm": _mm(p), "down_in_base": down.tolist()}


def _joints(cell: Cell) -> dict[str, Any]:
    names = (*cell.arm_joints, *cell.external_joints)
    slides = (*(cell.arm_prismatic or (False,) * len(cell.arm_joints)), *cell.external_prismatic)
    home = np.concatenate([cell.home, cell.external_home])
    rows = []
    for k, (name, slide) in enumerate(zip(names, slides, strict=True)):
        unit, scale = ("mm", 1e3) if slide else ("deg", 180.0 / math.pi)
        limits = cell.limits
        values = (limits.lower[k], limits.upper[k], home[k], limits.velocity[k], limits.acceleration[k], limits.jerk[k])
        keys = ("lower", "upper", "home", "velocity", "acceleration", "jerk")
        units = (unit, unit, unit, f"{unit}_s", f"{unit}_s2", f"{unit}_s3")
        rows.append(
            {"name": name}
            | {f"{a}_{b}": round(float(v) * scale, 3) for a, b, v in zip(keys, units, values, strict=True)}
        )
    follow = [
        {"name": m.joint, "mimics": m.source, "multiplier": m.multiplier, "offset": m.offset} for m in cell.mimics
    ]
    return {"joints": rows, "followers": follow}


def _model(cell: Cell) -> dict[str, Any]:
    """What the planner makes of it; a cell that it refuses is told why beside what could be read."""
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
            out["pairs_ignored"] = [{"a": e.a, "b": e.b, "why": e.reason} for e in (*model.excluded, *model.adjacent)]
            out["touching_at_home"] = list(model.suspicious)
    except InputError as problem:
        out["cannot_be_planned"] = str(problem)
    return {**out, "warnings": list(cell.warnings), "notes": list(cell.notes)}


def _mm(p: Any) -> list[float]:
    return [round(1e3 * float(v), 3) + 0.0 for v in p]

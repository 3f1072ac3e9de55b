"""What a planner would refuse about a cell, and what it would plan with although it is odd."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.arrays import Array
from machopt.cells.place import NO_ROTATION, lies_on_last_axis, outward, pointing
from machopt.domain.cell import Cell, Shape
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.stiffness import Stiffness
from machopt.errors import InputError
from machopt.formats.options import load_options, without_effect
from machopt.model.bodies import Body, inside, tool_bodies, triangles_of
from machopt.model.collision import remedy
from machopt.model.ik import branch_reasons
from machopt.plan.contacts.gouge import cutter_and_part
from machopt.plan.external.axes import axes_of
from machopt.plan.job.drive import refuse_fixed_elsewhere
from machopt.plan.pipeline.setup import Setup, prepare
from machopt.postprocess.wanted import wanted_posts
from machopt.se3 import inverse, tool_rotation, transform
from machopt.workspace.postures import place_turns

_SIDEWAYS = 0.2  # of its distance beside the flange that a TCP stands out of it, where the tool is turned by mistake
_BEYOND = 1e-3  # m that a tool's body may stand beyond the tip along the cutting direction
_LOOSE = 0.02  # m between the shank's end and the nearest body of the tool
_ANY = Stiffness(joints=np.full(6, 1e6))  # to look further where the cell has none; no finding rests on it
_NO_STIFFNESS = (
    "the cell names no stiffness file, and the plan rests on it; `stiffness: stiffness.yaml` with six numbers in "
    "N·m/rad would work (machopt identify writes it, machopt init an estimate)"
)
_ROTATIONS = np.radians(np.arange(0.0, 360.0, 30.0))
_AXES = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)  # tip to shank, in CAM coordinates


@dataclass(frozen=True)
class Remark:
    """One thing about a cell."""

    level: Literal["error", "warning"]  # error: there is no plan, or none that could be driven
    where: str  # key of cell.yaml
    text: str  # what was found, and what would work


def review(cell: Cell) -> Iterator[Remark]:
    """Everything but what the reader says itself."""
    try:
        options = load_options(cell.plan)
    except InputError as problem:
        yield Remark("error", "plan", str(problem))
        options = load_options(None)
    yield from _options(cell, options)
    setup: Setup | None = None
    if cell.stiffness is None:
        yield Remark("error", "stiffness", _NO_STIFFNESS)
    try:
        setup = prepare(cell if cell.stiffness else replace(cell, stiffness=_ANY), options)
    except InputError as problem:
        yield Remark("error", problem.where or "", str(problem))
    try:
        wanted_posts(cell, ())
    except InputError as problem:
        yield Remark("error", "controller", str(problem))
    if setup is None:
        return
    yield from _tool(cell, setup)
    if setup.collision is not None:
        hit = setup.collision.check(_home(cell), np.zeros(1, bool))
        if hit.any:
            pair, near = setup.collision.pairs[int(hit.pair[0])], 1e3 * options.clearance
            yield Remark(
                "error",
                "robot.home_deg",
                f"{pair.name} touch at home, or are nearer than {near:g} mm; no motion begins there. "
                f"Another home would work{remedy(pair)}",
            )
    yield from _reach(cell, setup)


def _options(cell: Cell, options: PlanOptions) -> Iterator[Remark]:
    """What a plan would refuse of the cell's options whatever its toolpath is, and what has no effect."""
    try:
        axes_of(cell, options)
    except InputError as problem:
        yield Remark("error", "plan.external", str(problem))
    try:
        refuse_fixed_elsewhere(options)
    except InputError as problem:
        yield Remark("error", "plan.fixed", str(problem))
    if options.gouge is not None:
        try:
            cutter_and_part(cell)
        except InputError as problem:
            yield Remark("error", "plan.gouge_tolerance_mm", str(problem))
    for said in without_effect(options):
        yield Remark("warning", "plan", said)


def _tool(cell: Cell, setup: Setup) -> Iterator[Remark]:
    """The tool against the flange it sits on, and against its own bodies."""
    T = cell.tool.T_flange_tcp
    tip, z, out = T[:3, 3], T[:3, 2], outward(setup.robot)
    if out is not None:
        along, beside = float(tip @ out), float(np.linalg.norm(tip - (tip @ out) * out))
        looks = f"the flange {cell.flange_link!r} looks along {_row(out)} of its own frame"
        if along < -_BEYOND:
            yield Remark("warning", "tool.tcp", f"the TCP lies {-1e3 * along:.0f} mm behind the flange; {looks}")
        elif along < _SIDEWAYS * beside and beside > 0.05:
            rpy = ", ".join(f"{v + 0.0:g}" for v in np.round(np.degrees(pointing(out)), 3).tolist())
            yield Remark(
                "warning",
                "tool.tcp",
                f"the TCP lies {1e3 * beside:.0f} mm beside the flange and {1e3 * along:.0f} mm out of it; {looks}. If "
                f"the tool's data are of a frame whose z looks out (tool0), name that link as flange_link, or turn the "
                f"tool by rpy_deg: [{rpy}]",
            )
        elif float(z @ out) < math.cos(math.radians(120.0)):
            yield Remark("warning", "tool.tcp", f"the TCP's z points back at the arm; {looks}")
    if lies_on_last_axis(setup.robot, T):
        yield Remark("warning", "tool.tcp", f"{NO_ROTATION}; a tool at an angle to the flange axis would have one")
    cut = 0.0 if cell.tool.cutter is None else cell.tool.cutter.length
    bodies = tool_bodies(cell)
    for body in bodies:
        ahead = float(((body.vertices - tip) @ z).max())
        if ahead > _BEYOND:
            yield Remark(
                "warning",
                "tool.geometry",
                f"{body.name} reaches {1e3 * ahead:.0f} mm beyond the TCP the way the cutter looks, so it meets the "
                "workpiece first; the TCP's z must point out of the tool",
            )
        if inside(body, tip + _BEYOND * z):
            yield Remark("warning", "tool.tcp", f"the TCP lies inside {body.name}; it is the tip of the cutter")
    shank = tip - cut * z
    gap = min((_gap(body, shank) for body in bodies), default=0.0)
    if gap > _LOOSE:
        yield Remark(
            "warning",
            "tool.geometry",
            f"the cutter's upper end ({1e3 * cut:g} mm behind the TCP) is {1e3 * gap:.0f} mm from the nearest body of "
            "the tool: body and TCP are not of one frame, or the cutter is longer",
        )


def _reach(cell: Cell, setup: Setup) -> Iterator[Remark]:
    """Whether some of the workpiece can be reached with the tool standing on it or against its sides."""
    corners = _corners(cell)
    T_part = transform(
        tool_rotation(_AXES[:, None, None], np.array([[[[1, 1, 1]]]]) / math.sqrt(3), _ROTATIONS[None, None, :]),
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
        found = setup.arm.solver.solve(T @ inverse(setup.arm.T_flange_tcp))
        reason = branch_reasons(found, setup.arm.margins)
        q = place_turns(found.q, setup.arm.lower, setup.arm.upper, cell.home)
        ok = (reason == Reason.OK) & np.isfinite(q).all(axis=-1)
        reached |= ok.any(axis=1).reshape(len(_AXES), len(corners), -1).any(axis=(0, 2))
        missing = min(missing, float(found.shortfall.min()))
    if reached.all():
        return
    what = "corners of the workpiece" if cell.workpiece.geometry else "corners of 100 mm around the workpiece's frame"
    how = "with the tool from above or from the side"
    if reached.any():
        text = f"{int(reached.sum())} of {len(reached)} {what} can be reached {how}"
        yield Remark("warning", "workpiece.pose", text)
        return
    far = f"; the nearest lacks {1e3 * missing:.0f} mm of reach" if missing > 0 else ""
    yield Remark("error", "workpiece.pose", f"none of the {what} can be reached {how}{far}")


def _corners(cell: Cell) -> Array:
    """(8, 3) m, of the box around the workpiece's bodies in CAM coordinates; a small one around the frame without."""
    clouds = [_points(s) for s in cell.workpiece.geometry]
    if not clouds:
        return np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    points = np.concatenate(clouds)
    return np.array(list(itertools.product(*zip(points.min(axis=0), points.max(axis=0), strict=True))))


def _points(shape: Shape) -> Array:
    """(V, 3) m, its vertices in the frame that it is placed in."""
    T = shape.T_parent_shape
    return np.asarray(triangles_of(shape)[0] @ T[:3, :3].T + T[:3, 3])


def _gap(body: Body, point: Array) -> float:
    """m from a point (3,) to the box around a body: it is no nearer to the body."""
    local = np.abs(body.box_rotation.T @ (point - body.box_centre)) - body.box_half
    return float(np.linalg.norm(np.maximum(local, 0.0)))


def _home(cell: Cell) -> Array:
    return np.append(cell.home, cell.external_home)[None, :]


def _row(v: Array) -> str:
    return f"[{', '.join(f'{x + 0.0:g}' for x in np.round(v, 3).tolist())}]"

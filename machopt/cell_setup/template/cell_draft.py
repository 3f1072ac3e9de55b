"""Draft of a new cell from the URDF and the user's options."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.cell.plausibility_checks import check_velocity
from machopt.cell.urdf import ArmLinks, UrdfJoint, UrdfModel
from machopt.cell_setup.template.cell_text import NewCellContent
from machopt.cell_setup.template.default_tool import build_tool, select_tool_angle
from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.template.mesh_unit import detect_unit
from machopt.cell_setup.template.robot_files import URDF
from machopt.errors import InputError, OptionError
from machopt.numerics.array_types import Array

SLOW_DEG_S, SLOW_MM_S = 45.0, 200.0
"""Judgement, where a URDF says no velocity: too low costs cycle time, too high is no motion the drives can follow.
The arms of cells/ have 75 deg/s and more."""
TOOL_MM, TOOL_SHARE = (80.0, 200.0), 0.1
"""Where no length is given: a tenth of the arm's links end to end, not less or more than this, in steps of 10 mm."""


def estimate_tool_length(request: InitRequest, span: float) -> float:
    """mm from flange to TCP, as given or as an arm of that size would carry.

    Args:
        request: the validated input.
        span: m, of the arm's links end to end.
    """
    if request.tool_length_mm is not None:
        return request.tool_length_mm
    return float(np.clip(round(1e2 * TOOL_SHARE * span) * 10.0, *TOOL_MM))


def _list_guesses_of_links(links: ArmLinks) -> list[str]:
    if not links.gripper:
        return []
    return [
        f"{', '.join(j.name for j in links.gripper)} behind {links.flange_link} {_is_or_are(links.gripper)} "
        "assumed to belong to a gripper and fixed at zero (--flange-link)"
    ]


def _list_guesses_of_velocities(slow: Sequence[str]) -> list[str]:
    if not slow:
        return []
    return [
        f"the URDF has no velocity for {', '.join(slow)}: robot.limits.velocity_deg_s is a slow guess "
        "(--velocity-deg-s)"
    ]


def draft_cell(
    request: InitRequest, urdf: UrdfModel, links: ArmLinks, span: float
) -> tuple[NewCellContent, tuple[str, ...]]:
    """Links, limits and tool; the workpiece and home are provisional.

    Args:
        request: the options.
        urdf: the robot.
        links: its arm.
        span: m, of the arm's links end to end.

    Returns:
        The cell, and what of it is a guess.

    Raises:
        InputError: an option is wrong, or a joint of the URDF has no range.
    """
    _check_request(request)
    joints = (*links.arm, *links.external)
    slides = tuple(j.kind == "prismatic" for j in joints)
    scale = [1e3 if slide else 180.0 / math.pi for slide in slides]
    lower, upper = _list_joint_ranges(joints, scale, urdf)
    velocity, of, slow = _list_joint_velocities(request, joints, slides, urdf)
    body, part_body, of_bodies = _draft_bodies(request, span)
    guesses = [] if request.tool_mass_kg else ["tool.mass_kg is 0: the tool's weight is not counted"]
    guesses += [*of_bodies, *_list_guesses_of_links(links), *_list_guesses_of_velocities(slow)]
    new = NewCellContent(
        name=request.name or urdf.path.stem,
        urdf=URDF,
        source=urdf.path.name,
        base_link=links.base_link,
        flange_link=links.flange_link,
        flange_note=_format_flange_note(links),
        external=tuple(j.name for j in links.external),
        joints=tuple(j.name for j in joints),
        prismatic=slides,
        lower=lower,
        upper=upper,
        velocity=velocity,
        velocity_of=of,
        home=[0.0 if a < 0.0 < b else (a + b) / 2.0 for a, b in zip(lower, upper, strict=True)],
        tcp_mm=request.tcp_mm or (0.0, 0.0, TOOL_MM[1]),
        tcp_rpy_deg=request.tcp_rpy_deg or (0.0, 0.0, 0.0),
        tcp_note="",
        mass_kg=request.tool_mass_kg,
        com_mm=(0.0, 0.0, 0.0),
        body=body,
        body_note="in flange_link" if body else "GUESS: cylinders from the flange to the cutter",
        cutter_mm=(request.cutter_diameter_mm, request.cutter_length_mm),
        workpiece_mm=request.workpiece_mm or (1000.0, 0.0, 500.0),
        workpiece_rpy_deg=request.workpiece_rpy_deg or (0.0, 0.0, 0.0),
        workpiece_body=part_body,
        workpiece_note="as given: the CAM coordinates in world",
        stiffness_note="as given" if request.stiffness else "ESTIMATED: see there, and measure",
        post=request.post,
    )
    return new, tuple(guesses)


def _draft_bodies(request: InitRequest, span: float) -> tuple[str, str, list[str]]:
    """Return the bodies of tool and workpiece as text of cell.yaml, and what is a guess."""
    guesses: list[str] = []
    body = ""
    if request.tool_mesh is not None:
        unit = detect_unit(request.tool_mesh, "tool", span, request.mesh_unit)
        guesses += [unit.note] if unit.note else []
        body = _format_mesh_body("spindle", "tool" + request.tool_mesh.suffix.lower(), unit.scale)
    if not body:
        guesses.append("the tool's body is plain cylinders; give its mesh or its boxes")
    part, part_body = request.workpiece_mesh, ""
    if part is None:
        guesses.append("the workpiece has no body, so nothing is checked against it")
    else:
        unit = detect_unit(part, "workpiece", span, request.mesh_unit)
        guesses += [unit.note] if unit.note else []
        part_body = _format_mesh_body("part", "workpiece" + part.suffix.lower(), unit.scale)
    return body, part_body, guesses


def aim_tool(
    new: NewCellContent, request: InitRequest, out: Array | None, span: float
) -> tuple[NewCellContent, tuple[str, ...]]:
    """The tool along the flange direction (3,), in the flange frame; None: not known.

    Args:
        new: the cell so far.
        request: the validated input.
        out: the direction.
        span: m, of the arm's links end to end.

    Raises:
        InputError: the cutter is longer than the tool.
    """
    reach, angle = estimate_tool_length(request, span), select_tool_angle(request)
    guesses: list[str] = []
    if out is None:
        out, known = np.array([0.0, 0.0, 1.0]), "GUESS: along z of the flange; the URDF does not state its direction"
        guesses.append("the URDF does not state the direction of the flange; check tool.tcp")
    else:
        axis = np.round(out, 3) + 0.0
        known = f"the flange looks along [{', '.join(f'{v:g}' for v in axis)}] of {new.flange_link}"
    if request.tcp_mm is not None:  # the bodies end where its cutter begins
        reach = max(float(np.linalg.norm(request.tcp_mm)), request.cutter_length_mm + 1.0)
    made = build_tool(out, angle, reach, request.cutter_length_mm)
    if request.tcp_mm is None:
        known = f"{made.note}; {known}; GUESS: the length"
        guesses.append(f"the TCP is {reach:g} mm along the tool from the flange; put in the tool's own data")
    else:
        known = "as given" if request.tcp_rpy_deg is not None else f"as given; {known}"
    return replace(
        new,
        tcp_mm=request.tcp_mm or made.tcp_mm,
        tcp_rpy_deg=request.tcp_rpy_deg or made.rpy_deg,
        tcp_note=known,
        body=new.body or made.bodies,
        com_mm=made.middle_mm,
    ), tuple(guesses)


def _format_mesh_body(name: str, file: str, scale: float) -> str:
    """One line of YAML."""
    return f'{{name: {name}, mesh: "{file}"{"" if scale == 1.0 else f", scale: {scale:g}"}}}'


def _check_request(r: InitRequest) -> None:
    for option, row in (("--tcp-mm", r.tcp_mm), ("--tcp-rpy-deg", r.tcp_rpy_deg), ("--workpiece-mm", r.workpiece_mm)):
        if row is not None and len(row) != 3:
            raise InputError(f"found {len(row)} numbers; expected three", where=option)
    for name, value in (("--tool-length-mm", r.tool_length_mm), ("--cutter-diameter-mm", r.cutter_diameter_mm)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"found {value:g}; expected more than zero", where=name)
    for name, file in (("--tool-mesh", r.tool_mesh), ("--workpiece-mesh", r.workpiece_mesh)):
        if file is not None and not file.is_file():
            raise InputError("there is no such file", file=file, where=name)


def _list_joint_ranges(
    joints: tuple[UrdfJoint, ...], scale: list[float], urdf: UrdfModel
) -> tuple[list[float], list[float]]:
    lower, upper = [], []
    for j, s in zip(joints, scale, strict=True):
        if j.kind == "continuous":
            low, high = -360.0, 360.0
        elif j.lower < j.upper:
            low, high = float(j.lower * s), float(j.upper * s)
        else:
            raise InputError(
                f"joint {j.name!r} has no range; a <limit> with lower < upper would work",
                file=urdf.path,
                where=f"line {j.line}",
            )
        lower.append(round(low, 3))
        upper.append(round(high, 3))
    return lower, upper


def _list_joint_velocities(
    request: InitRequest, joints: tuple[UrdfJoint, ...], slides: tuple[bool, ...], urdf: UrdfModel
) -> tuple[list[float], str, tuple[str, ...]]:
    """Velocity in deg/s (mm/s), its origin, and the joints without a value."""
    given = request.velocity_deg_s
    if given is not None:
        if len(given) != len(joints):
            raise OptionError(f"found {len(given)} numbers; expected {len(joints)}", where="--velocity-deg-s")
        return [float(v) for v in given], "as given", ()
    for j in joints:
        check_velocity(j, urdf, "--velocity-deg-s with one value a joint")
    missing = tuple(j.name for j in joints if not j.velocity > 0.0)
    slow = [SLOW_MM_S if slide else SLOW_DEG_S for slide in slides]
    own = [j.velocity * (1e3 if slide else 180.0 / math.pi) for j, slide in zip(joints, slides, strict=True)]
    velocity = [round(float(v if v > 0.0 else low), 3) for v, low in zip(own, slow, strict=True)]
    if not missing:
        return velocity, "of the URDF", ()
    rule = f"ESTIMATED for {', '.join(missing)}, for which the URDF gives no limit: {SLOW_DEG_S:g} deg/s"
    rule += f" ({SLOW_MM_S:g} mm/s where it slides)" if any(slides) else ""
    return velocity, f"{rule}, slow on purpose", missing


def _is_or_are(some: tuple[UrdfJoint, ...]) -> str:
    return "is" if len(some) == 1 else "are"


def _format_flange_note(links: ArmLinks) -> str:
    if not links.flanges:
        return "the last link of the arm"
    return f"not {' or '.join(links.flanges)}, which may look another way; tool data must be of the link named here"

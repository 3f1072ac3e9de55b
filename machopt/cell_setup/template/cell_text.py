"""Text of a new cell: cell.yaml and stiffness.yaml with the origin of each number."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array

RUN_UP_S, JERK_S = 0.35, 0.14
"""s to full speed, and to full acceleration: what stands for limits that a URDF has no word for."""
REFERENCE_NM_PER_RAD = (1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5)
"""N·m/rad of a KUKA KR 240-2 (Dumas et al., 2011), the arm that the estimate is scaled from."""
REFERENCE_SPAN_M = 3.454
"""m, of that arm's links end to end from base to flange (cells/kr240_drilling)."""
RELATIVE_COMPLIANCE_SIGMA = (
    0.5  # 1 sigma of an estimated compliance, as a share of it: arms of one size differ by a factor of two
)
SCHEMA, STIFFNESS_SCHEMA = "schemas/cell.schema.json", "schemas/stiffness.schema.json"


@dataclass(frozen=True, kw_only=True)
class NewCellContent:
    """What is written; mm, degrees, N·m/rad. Per joint: the arm's, then the external ones."""

    name: str
    urdf: str  # file in the cell folder
    source: str  # it was made from
    base_link: str
    flange_link: str
    flange_note: str  # why this link, in one sentence
    external: tuple[str, ...]
    joints: tuple[str, ...]
    prismatic: tuple[bool, ...]
    lower: Sequence[float]
    upper: Sequence[float]
    velocity: Sequence[float]
    velocity_of: str  # origin of the value
    home: Sequence[float]
    tcp_mm: Sequence[float]
    tcp_rpy_deg: Sequence[float]
    tcp_note: str
    mass_kg: float
    com_mm: Sequence[float]
    body: str  # one line of YAML: the tool's geometry
    body_note: str
    cutter_mm: tuple[float, float]  # diameter, length
    workpiece_mm: Sequence[float]
    workpiece_rpy_deg: Sequence[float]
    workpiece_body: str  # one line of YAML, empty: none
    workpiece_note: str
    stiffness_note: str
    post: str
    post_note: str = ""


def estimate_joint_stiffness(span: float, joints: int = 6) -> tuple[float, ...]:
    """(n,) N·m/rad of a geometrically similar arm: torsional stiffness GJ/L grows with the cube of the size.

    Args:
        span: m, of the arm's links end to end from base to flange.
        joints: of the arm; those of other arms than six lie between the reference's, evenly along the chain.
    """
    places = np.linspace(0.0, len(REFERENCE_NM_PER_RAD) - 1.0, joints)
    reference = np.exp(np.interp(places, np.arange(len(REFERENCE_NM_PER_RAD)), np.log(REFERENCE_NM_PER_RAD)))
    return tuple(float(f"{k * (span / REFERENCE_SPAN_M) ** 3:.3g}") for k in reference)


def format_stiffness_yaml(joints: Sequence[float], *, span: float) -> str:
    """Format stiffness.yaml of an estimate.

    Args:
        joints: Joint stiffness of the arm, N·m/rad.
        span: Length of the arm's links from base to flange, m.

    Returns:
        Text of the file.
    """
    rows = [[0.0] * len(joints) for _ in joints]
    for i, k in enumerate(joints):
        rows[i][i] = float(f"{(RELATIVE_COMPLIANCE_SIGMA / k) ** 2:.4g}")
    matrix = "\n".join(f"  - {_format_row(row)}" for row in rows)
    return "\n".join(
        [
            f"# yaml-language-server: $schema={STIFFNESS_SCHEMA}",
            "# ESTIMATED, not measured: a KUKA KR 240-2 (Dumas et al., 2011), scaled with the cube of its links'",
            f"# length ({span:.3g} m against {REFERENCE_SPAN_M:g} m), as torsional stiffness of similar arms grows.",
            "# Arms of one size differ by a factor of two: the covariance has half of each compliance as 1 sigma, and",
            "# smaller gains are reported as not distinguishable. `machopt plan-poses` plans the measurement, and",
            "# `machopt identify` writes this file from it.",
            "machopt_stiffness: 1",
            f"joints_Nm_per_rad: {_format_row(joints)}",
            "covariance:  # of the joint compliances, (rad/(N·m))²",
            matrix,
            "estimated: true",
            "",
        ]
    )


def format_cell_yaml(c: NewCellContent) -> str:
    """Format cell.yaml; guessed numbers are marked GUESS, numbers computed by a rule ESTIMATED.

    Args:
        c: Content of the new cell.

    Returns:
        Text of the file.
    """
    acceleration = [v / RUN_UP_S for v in c.velocity]
    jerk = [a / JERK_S for a in acceleration]
    arrays = ", ".join(f"{n}{' (mm)' if slide else ''}" for n, slide in zip(c.joints, c.prismatic, strict=True))
    ranges = ", ".join(f"[{_format_number(a)}, {_format_number(b)}]" for a, b in zip(c.lower, c.upper, strict=True))
    lines = [
        f"# yaml-language-server: $schema={SCHEMA}",
        f"# Written by `machopt init` from {c.source}. GUESS: replace by your own value. ESTIMATED: by the rule given "
        "next to it.",
        "# Frames: world -> base_link -> joints -> flange -> tcp; workpiece is the frame of the CAM coordinates.",
        "# `machopt validate` on this folder lists its errors and warnings, with a picture.",
        "machopt_cell: 1",
        f"name: {_format_yaml_word(c.name)}",
        "robot:",
        f"  urdf: {_format_yaml_word(c.urdf)}",
        f"  base_link: {_format_yaml_word(c.base_link)}",
        f"  flange_link: {_format_yaml_word(c.flange_link)}  # {c.flange_note}",
        f"  pose: {{xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}}  # GUESS: {_format_robot_pose(c)} in world",
        *([f"  external_joints: [{', '.join(_format_yaml_word(e) for e in c.external)}]"] if c.external else []),
        f"  # one value a joint below: {arrays}; deg (mm where it slides)",
        f"  home_deg: {_format_row(c.home)}  # GUESS: above the workpiece; programs begin and end there",
        "  limits:",
        f"    position_deg: [{ranges}]  # of the URDF; may be narrowed",
        f"    velocity_deg_s: {_format_row(c.velocity)}  # {c.velocity_of}",
        f"    acceleration_deg_s2: {_format_row(acceleration)}  # ESTIMATED: full speed in {RUN_UP_S} s",
        f"    jerk_deg_s3: {_format_row(jerk)}  # ESTIMATED: full acceleration in {JERK_S} s",
        "tool:",
        f"  tcp: {{xyz_mm: {_format_row(c.tcp_mm)}, rpy_deg: {_format_row(c.tcp_rpy_deg)}}}  # {c.tcp_note}",
        f"  mass_kg: {_format_number(c.mass_kg)}  # {'GUESS: ' if c.mass_kg == 0 else ''}spindle, holder and "
        f"cutter together",
        f"  com_mm: {_format_row(c.com_mm)}  # GUESS: their centre of mass in flange_link",
        f"  geometry: [{c.body}]  # {c.body_note}",
        "  # from the TCP back along -z, the part that may touch the workpiece; GUESS where you have not given it",
        f"  cutter: {{diameter_mm: {_format_number(c.cutter_mm[0])}, length_mm: {_format_number(c.cutter_mm[1])}}}",
        "  # forces and tolerances need here: point_deg (and teeth, web_mm) of a drill, teeth and helix_deg of an end "
        "mill",
        "workpiece:",
        f"  pose: {{xyz_mm: {_format_row(c.workpiece_mm)}, rpy_deg: {_format_row(c.workpiece_rpy_deg)}}}  # "
        f"{c.workpiece_note}",
        *([f"  geometry: [{c.workpiece_body}]"] if c.workpiece_body else _NO_PART),
        "obstacles: []  # fixtures, table, walls, in world: {name: table, box_mm: [900, 800, 50], xyz_mm: [1e3, 0, 0]}",
        f"stiffness: stiffness.yaml  # {c.stiffness_note}",
        "# accuracy: {absolute_mm: 0.3, repeatability_mm: 0.03, source: data sheet}  # 1 sigma a coordinate: "
        "without it the outcome of a tolerance is unknown",
        *(
            [f"controller: {{post: {_format_yaml_word(c.post)}}}{f'  # {c.post_note}' if c.post_note else ''}"]
            if c.post
            else _NO_POST
        ),
        "# under controller, absolute_accuracy: on | off | unknown; on: it corrects geometry and gravity sag itself",
    ]
    return "\n".join(lines) + "\n"


def _format_robot_pose(c: NewCellContent) -> str:
    """What ``robot.pose`` places."""
    return "the URDF's root link, below the rail," if c.external else "base_link"


_NO_PART = ("  # geometry: [{mesh: part.stl}]  # nothing is checked against the workpiece until it is here",)
_NO_POST = ("# controller: {post: krl}  # krl, rapid, fanuc, urscript, val3, jbi …: the robot program to write",)


def _format_row(values: Sequence[float] | Array) -> str:
    return f"[{', '.join(_format_number(v) for v in np.asarray(values, float).tolist())}]"


def _format_number(value: float) -> str:
    """Short, without a negative zero; a float of YAML 1.2."""
    return f"{value + 0.0:.6g}"


def _format_yaml_word(text: str) -> str:
    """A scalar that is a word in YAML 1.2, whatever it looks like."""
    plain = text.replace("_", "").replace("-", "").replace(".", "").replace(" ", "").replace("/", "")
    plain_start = text[:1].isalpha() and text.lower() not in ("true", "false", "null", "yes", "no", "on", "off")
    return text if plain.isalnum() and plain.isascii() and plain_start and text == text.strip() else json.dumps(text)

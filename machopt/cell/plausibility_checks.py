"""Plausibility checks of cell values: impossible ones are refused, unusual ones give a warning.

Most errors are wrong units: metres instead of mm, radians instead of degrees, degrees in a URDF. A message names the
key, the number and the value in the other unit. Refused values exceed existing machines by a factor of ten or more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from machopt.cell.cell_schema import CellKeys, CutterKeys, PoseKeys, ToolKeys
from machopt.cell.joints.joint_chain import JointChain
from machopt.cell.joints.joint_limits import read_velocity_limits
from machopt.cell.urdf import UrdfJoint, UrdfModel
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import CellError
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument

_GRAVITY = 9.80665  # m/s²
_METRES_LOOK = 5.0  # mm; a tool or workpiece frame this near its parent, yet not on it, is rather in metres
_FARTHEST = 1e6  # mm; coordinates of a whole plant are less
_TCP = (3.0, 5.0)  # reaches, or m if that is more: the longest lances stay below
_HEAVY, _HEAVIEST = 2_500.0, 1e4  # kg; the strongest robots carry 2.3 t
_CUTTER = ((0.1, 1_000.0), (1.0, 3_000.0))  # mm, least and most diameter and length
_REACH = (0.05, 30.0)  # m of a six-axis arm; built are 0.3 to 6
_REVOLUTIONS = 8 * math.pi  # rad; wrists with two turns and a little more stay below, a range in degrees does not
_ENDLESS = 1e3  # rad; more than the hoses of any joint bear, "continuous" is meant
_RAIL = 200.0  # m
_FASTEST = {
    "velocity_deg_s": 1e4,
    "acceleration_deg_s2": 1e6,
    "jerk_deg_s3": 1e8,
}  # ten times a small SCARA's, and more
_FAST = 2_000.0  # deg/s; the joints of the fastest six-axis arms turn at 1,500 by their data sheets
_SLOWEST = 1e-2  # deg/s (mm/s): a move of a quarter turn would take hours
_RUN_UP = 5.0  # s to full speed, or full acceleration; built are 0.1 to 1
_ODD = 3  # values of a home with more than one decimal
_RIGHT_ANGLE = 2e-3  # rad by which a printed multiple of π/4 may miss it
_SAG, _BREAK = 0.01, 0.1  # rad that a joint gives under the tool's weight at arm's length; built is 0.001
_ARMS_LOOK = 2e4  # N·m/rad; each joint of a robot of a metre and more is stiffer
_RIGID = 5e7  # N·m/rad; the stiffest joint measured has a fifth


def estimate_reach(urdf: UrdfModel, keys: CellKeys, chain: JointChain) -> float:
    """Estimate the reach: the sum of all joint offsets from base to flange.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        keys: Validated keys of cell.yaml.
        chain: Arm joints and external joints of the cell.

    Returns:
        Reach, m.
    """
    to_base = len(urdf.chain(keys.robot.base_link))
    return sum(j.offset for j in urdf.chain(keys.robot.flange_link)[to_base:] if j not in chain.external)


def check_arm(urdf: UrdfModel, chain: JointChain, arm_reach: float, document: YamlDocument) -> None:
    """Check the size and the ranges of the arm.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        chain: Arm joints and external joints of the cell.
        arm_reach: Reach of the arm from base to flange, m.
        document: Parsed YAML file, with the line of each key for errors.

    Raises:
        InputError: no robot has them.
    """
    loc: KeyPath = ("robot", "urdf")
    lines = {j.name: f"{urdf.path.name} line {j.line}" for j in chain.moving}
    if len(chain.arm) == 6 and not _REACH[0] <= arm_reach <= _REACH[1]:
        factor = 1e-3 if arm_reach > _REACH[1] else 1e3
        unit = "mm" if factor < 1 else "km"
        raise document.build_error(
            loc,
            f"the origins of the joints of {urdf.path.name} make an arm of {arm_reach:.4g} m; "
            f"expected {_REACH[0]:g} to {_REACH[1]:g} m (if they are in {unit}: "
            f"{arm_reach * factor:.4g} m)",
        )
    wide = [j for j in chain.moving if j.kind == "revolute" and max(abs(j.lower), abs(j.upper)) > _REVOLUTIONS]
    for j in chain.moving:
        far = max(abs(j.lower), abs(j.upper))
        if j.kind == "prismatic" and far > _RAIL:
            raise document.build_error(
                loc,
                f"{lines[j.name]}: joint {j.name!r} slides from {j.lower:g} to {j.upper:g} m; expected at most "
                f"{_RAIL:g} m"
                + _suggest_unit("mm", f"{j.lower / 1e3:g} to {j.upper / 1e3:g}", accepted=far / 1e3 <= _RAIL),
            )
        if j in wide and (far > _ENDLESS or sum(w in chain.arm for w in wide) > 1):
            raise document.build_error(
                loc,
                f"{lines[j.name]}: joint {j.name!r} turns from {j.lower:g} to {j.upper:g} rad; "
                f"if that is degrees, {math.radians(j.lower):.5g} to {math.radians(j.upper):.5g} would work; "
                'without limits, type="continuous"',
            )


def check_limits(
    keys: CellKeys, chain: JointChain, urdf: UrdfModel, document: YamlDocument, warnings: list[str]
) -> None:
    """Check velocities, accelerations, jerks, home and the ranges of the cell.

    Args:
        keys: Validated keys of cell.yaml.
        chain: Arm joints and external joints of the cell.
        urdf: The robot: links, joints, bodies and masses.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.

    Raises:
        InputError: no machine reaches them.
    """
    limits, loc = keys.robot.limits, ("robot", "limits")
    limits_by_key = {
        "velocity_deg_s": read_velocity_limits(chain, keys, document),
        "acceleration_deg_s2": limits.acceleration_deg_s2,
        "jerk_deg_s3": limits.jerk_deg_s3,
    }
    for key, most in _FASTEST.items():
        values = limits_by_key[key]
        for i, value in enumerate(values):
            joint = chain.moving[i]
            if key == "velocity_deg_s" and limits.velocity_deg_s is None:
                _check_velocity(joint, urdf, warnings)
                continue
            found = f"found {value:g} for joint {joint.name!r}"
            if not value <= most:
                raise document.build_error((*loc, key, i), f"{found}; expected at most {most:g}: no drive does more")
            if key == "velocity_deg_s" and value < _SLOWEST:
                raise document.build_error((*loc, key, i), f"{found}; expected at least {_SLOWEST:g}")
            if key == "velocity_deg_s" and value > _FAST and joint.kind != "prismatic":
                warnings.append(
                    f"{document.locate_key((*loc, key, i))}: {found} is faster than any arm; is its unit meant?"
                )
    steps = (("velocity_deg_s", "acceleration_deg_s2", "speed"), ("acceleration_deg_s2", "jerk_deg_s3", "acceleration"))
    for lower, upper, what in steps:
        slow = max(a / b for a, b in zip(limits_by_key[lower], limits_by_key[upper], strict=True))
        if slow > _RUN_UP:
            warnings.append(
                f"robot.limits.{upper} {limits_by_key[upper]}: full {what} takes {slow:.3g} s; is its unit meant?"
            )
    turning = [i for i, j in enumerate(chain.moving) if j.kind != "prismatic"]
    if limits.position_deg is not None and turning:
        most = max(abs(v) for i in turning for v in limits.position_deg[i])
        if most < 2 * math.pi:
            warnings.append(
                f"robot.limits.position_deg lies within ±{most:g}°, which looks like radians; degrees are expected"
            )
    home = keys.robot.home_deg
    odd = sum(abs(v - round(v, 1)) > 1e-9 for v in home)  # a home is never within hundredths of a degree of zero
    if home and max(map(abs, home)) <= math.pi + 0.1 and (any(_is_radian_right_angle(v) for v in home) or odd >= _ODD):
        warnings.append(
            f"{document.locate_key(('robot', 'home_deg'))}: {home} looks like radians; degrees are expected"
        )


def check_velocity(joint: UrdfJoint, urdf: UrdfModel, remedy: str) -> str | None:
    """A warning where the velocity that a URDF states is odd; nothing where it states none.

    Args:
        joint: of the URDF.
        urdf: the robot.
        remedy: what would work, in words.

    Raises:
        InputError: of no drive; names the line of the URDF.
    """
    if not joint.velocity > 0.0:
        return None
    slides = joint.kind == "prismatic"
    unit, per = ("mm/s", 1e3) if slides else ("deg/s", math.degrees(1.0))
    value = joint.velocity * per
    found = (
        f"joint {joint.name!r} has the velocity {joint.velocity:g} {'m/s' if slides else 'rad/s'}, {value:.6g} {unit}"
    )
    if not _SLOWEST <= value <= _FASTEST["velocity_deg_s"]:
        raise CellError(
            f"{found}; expected {_SLOWEST:g} to {_FASTEST['velocity_deg_s']:g} {unit}; {remedy} would work",
            file=urdf.path,
            where=f"line {joint.line}",
        )
    if value > _FAST and not slides:
        return f"{urdf.path.name}: line {joint.line}: {found}, which is faster than any arm; is its unit meant?"
    return None


def _check_velocity(joint: UrdfJoint, urdf: UrdfModel, warnings: list[str]) -> None:
    message = check_velocity(joint, urdf, "a velocity in rad/s there, or robot.limits.velocity_deg_s in cell.yaml,")
    warnings += [message] if message else []


def check_pose(keys: PoseKeys, loc: KeyPath, document: YamlDocument, warnings: list[str], *, near: bool = True) -> None:
    """Check a frame.

    Args:
        keys: Keys of the frame.
        loc: Key path of the value in the document.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.
        near: Whether its distance from the parent is that of a tool or a cell rather than a body.

    Raises:
        InputError: farther than a plant is wide, or more than ten full turns.
    """
    xyz, rpy = keys.xyz_mm, keys.rpy_deg
    most = max(map(abs, xyz))
    if most > _FARTHEST:
        raise document.build_error(
            (*loc, "xyz_mm"), f"found {xyz}, {most / 1e3:g} m away; expected mm, at most {_FARTHEST:g}"
        )
    if near and 0.0 < most < _METRES_LOOK:
        warnings.append(f"{document.locate_key((*loc, 'xyz_mm'))}: {xyz} looks like metres; mm is expected")
    if max(map(abs, rpy)) > 3600:
        raise document.build_error((*loc, "rpy_deg"), f"found {rpy}; expected degrees, and not ten turns")
    if any(_is_radian_right_angle(v) for v in rpy) and max(map(abs, rpy)) <= 2 * math.pi + 0.1:
        warnings.append(
            f"{document.locate_key((*loc, 'rpy_deg'))}: {rpy} looks like radians; degrees are expected "
            f"({[round(math.degrees(v), 2) for v in rpy]})"
        )


def check_tool(keys: ToolKeys, loc: KeyPath, arm_reach: float, document: YamlDocument, warnings: list[str]) -> None:
    """Check TCP, mass and cutter.

    Args:
        keys: Keys of the tool.
        loc: Key path of the value in the document.
        arm_reach: Reach of the arm from base to flange, m.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.

    Raises:
        InputError: no tool has them.
    """
    xyz = keys.tcp.xyz_mm
    off = math.hypot(*xyz) / 1e3
    most = max(_TCP[0] * arm_reach, _TCP[1])
    if off > most:
        raise document.build_error(
            (*loc, "tcp", "xyz_mm"),
            f"found {xyz}, {off:.4g} m from the flange; expected mm and at most {most:.3g} m"
            + _suggest_unit("µm", [v / 1e3 for v in xyz], accepted=off / 1e3 <= most),
        )
    if keys.cutter is not None:
        _check_cutter(keys.cutter, (*loc, "cutter"), document)
        if 0.0 < max(map(abs, xyz)) < _METRES_LOOK and off * 1e3 < keys.cutter.length_mm:
            raise document.build_error(
                (*loc, "tcp", "xyz_mm"),
                f"found {xyz} mm: the cutter is {keys.cutter.length_mm:g} mm long and would "
                "reach back through the flange"
                + _suggest_unit(
                    "m", [v * 1e3 for v in xyz], accepted=keys.cutter.length_mm <= off * 1e6 and off * 1e3 <= most
                ),
            )
    if keys.mass_kg > _HEAVIEST:
        raise document.build_error((*loc, "mass_kg"), f"found {keys.mass_kg:g}; expected kg, at most {_HEAVIEST:g}")
    if keys.mass_kg > _HEAVY:
        warnings.append(
            f"{document.locate_key((*loc, 'mass_kg'))}: {keys.mass_kg:g} kg is more than the strongest robots carry"
        )
    com = max(map(abs, keys.com_mm))
    if com / 1e3 > most:
        raise document.build_error((*loc, "com_mm"), f"found {keys.com_mm}; expected mm and at most {most:.3g} m")
    if keys.mass_kg > 0.0 and 0.0 < com < 1.0:
        warnings.append(f"{document.locate_key((*loc, 'com_mm'))}: {keys.com_mm} looks like metres; mm is expected")


def _suggest_unit(unit: str, value: object, *, accepted: bool) -> str:
    """The value as it would be written if it were meant in another unit, only where that one is accepted."""
    return f"; if that is {unit}, {value} would work" if accepted else ""


def _check_cutter(keys: CutterKeys, loc: KeyPath, document: YamlDocument) -> None:
    for key, (least, most) in zip(("diameter_mm", "length_mm"), _CUTTER, strict=True):
        value = getattr(keys, key)
        if not least <= value <= most:
            other = value * 1e3 if value < least else value / 1e3
            unit = "m" if value < least else "µm"
            raise document.build_error(
                (*loc, key),
                f"found {value:g}; expected mm, {least:g} to {most:g}"
                + (f" (if it is in {unit}, {other:g} would work)" if least <= other <= most else ""),
            )


def check_stiffness(
    stiffness: ArmStiffness, keys: CellKeys, arm_reach: float, document: YamlDocument, warnings: list[str]
) -> None:
    """Check joint stiffness against the tool's weight at full reach, and against usual values of arms.

    Args:
        stiffness: Joint stiffness of the arm, SI units.
        keys: Validated keys of cell.yaml.
        arm_reach: Reach of the arm from base to flange, m.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.

    Raises:
        InputError: the weight of the tool alone would turn a joint by 6°.
    """
    rows = [stiffness.joints] if stiffness.grid is None else [stiffness.joints, *stiffness.grid.joints]
    heaviest = max(tool.mass_kg for tool in ((keys.tool,) if keys.tool is not None else keys.tools.values()))
    torque = heaviest * _GRAVITY * arm_reach
    least = float(min(row[:3].min() for row in rows))  # the wrist does not bear the weight at arm's length
    sag = torque / least
    shown = [float(f"{v:.4g}") for v in stiffness.joints]
    units = "is it in kN·m/rad or in N·m/deg? N·m/rad is expected"
    file = document.locate_key(("stiffness",))
    where = f"{file}: joint stiffness {shown}"
    if sag > _BREAK:
        raise document.build_error(
            ("stiffness",),
            f"joint stiffness {shown} gives {math.degrees(sag):.3g}° under the tool's "
            f"{heaviest:g} kg at {arm_reach:.3g} m (softest of joints 1 to 3: {least:g}); {units}",
        )
    if sag > _SAG:
        warnings.append(f"{where} gives {math.degrees(sag):.3g}° under the tool's weight alone; {units}")
    elif arm_reach > 1.5 and float(max(row.max() for row in rows)) < _ARMS_LOOK:
        warnings.append(f"{where} is softer than any arm of this size; {units}")
    if float(min(row.min() for row in rows)) > _RIGID:
        warnings.append(f"{where} is stiffer than any arm; is it in N·mm/rad? N·m/rad is expected")
    if stiffness.grid is not None:
        extent = stiffness.grid.cell * max(stiffness.grid.shape)
        if extent < arm_reach / 100.0:
            warnings.append(
                f"{file}: the stiffness grid spans {extent * 1e3:.4g} mm of an arm that "
                f"reaches {arm_reach:.3g} m; cell_mm is in mm"
            )
        if float(np.linalg.norm(stiffness.grid.origin)) > 20.0 * max(arm_reach, 1.0):
            warnings.append(f"{file}: the stiffness grid lies beyond the arm's reach; origin_mm is in mm")
    if stiffness.covariance is not None:
        share = float((np.sqrt(np.diag(stiffness.covariance)) * stiffness.joints).max())
        if share > 1.0:
            warnings.append(
                f"{file}: covariance makes a joint's compliance uncertain by "
                f"{share:.3g} times itself; (rad/(N·m))² of the compliances is expected"
            )


def _is_radian_right_angle(value: float) -> bool:
    """An odd number of degrees that is a multiple of π/4 in radians."""
    part = value / (math.pi / 4)
    return (
        abs(value) > 0.5 and abs(part - round(part)) * math.pi / 4 < _RIGHT_ANGLE and abs(value - round(value)) > 1e-9
    )


def compute_longest_side(sizes: Sequence[float], kind: str) -> float:
    """Compute the longest side of a body.

    Args:
        sizes: Sides of a box, radius and height of a cylinder, or radius of a sphere, m.
        kind: ``box``, ``cylinder`` or ``sphere``.

    Returns:
        Length, m.
    """
    if kind == "box":
        return max(sizes)
    return 2 * sizes[0] if kind == "sphere" else max(2 * sizes[0], sizes[1])

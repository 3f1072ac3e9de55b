"""Limits of the joints of a chain, from the URDF and the cell file, and the joint positions that the cell states."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from machopt.cell.cell_schema import CellKeys
from machopt.cell.joints.joint_chain import JointChain
from machopt.cell.urdf import UrdfJoint, UrdfModel
from machopt.data_types.cell import JointLimits
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument
from machopt.numerics.array_types import Array

_CONTINUOUS = 2 * math.pi  # rad, taken on both sides for a continuous joint
_SLACK = math.radians(0.01)  # rad (or 0.17 mm); a position limit may exceed the URDF's by its rounding
_TURNED = 3 * math.pi + 1e-9  # rad; the planner looks for one whole turn more to either side of ±180°
_RAD_GUESS = 7.0  # deg/s; industrial arms are slower than 7 rad/s and faster than 7 deg/s
_SAME = 0.5, 1.5  # of the URDF's number: a cell's speeds are mostly its own, or somewhat below
_FASTER = 1.001  # share of the URDF's velocity above which a warning is given


def read_limits(chain: JointChain, keys: CellKeys, document: YamlDocument, warnings: list[str]) -> JointLimits:
    """Read the joint limits; for positions the narrower of URDF and cell applies.

    Args:
        chain: Arm joints and external joints of the cell.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.
        warnings: List that takes the warnings.

    Returns:
        Limits in the order of ``chain.moving``, SI units.

    Raises:
        InputError: a limit is missing or contradictory.
    """
    limits = keys.robot.limits
    rates = {}
    limits_by_key = {
        "velocity_deg_s": read_velocity_limits(chain, keys, document),
        "acceleration_deg_s2": limits.acceleration_deg_s2,
        "jerk_deg_s3": limits.jerk_deg_s3,
    }
    for key, values in limits_by_key.items():
        loc: KeyPath = ("robot", "limits", key)
        _build_length_error(chain, document, loc, len(values))
        for i, value in enumerate(values):
            if value <= 0:
                raise document.build_error(
                    (*loc, i), f"found {value:g} for joint {chain.moving[i].name!r}; expected above 0"
                )
        rates[key] = np.array(values) * chain.unit
    lower, upper = np.array(
        [_read_urdf_range(j, document, warnings, given=limits.position_deg is not None) for j in chain.moving]
    ).T
    if limits.position_deg is not None:
        loc = ("robot", "limits", "position_deg")
        _build_length_error(chain, document, loc, len(limits.position_deg))
        for i, j in enumerate(chain.moving):
            lo, hi = (v * chain.unit[i] for v in limits.position_deg[i])
            found = f"found {limits.position_deg[i]} for joint {j.name!r}"
            if not lo < hi:
                raise document.build_error((*loc, i), f"{found}; expected [lowest, highest] with lowest < highest")
            if j.kind != "continuous" and (lo < lower[i] - _SLACK or hi > upper[i] + _SLACK):
                urdf_range = [round(float(v / chain.unit[i]), 3) for v in (lower[i], upper[i])]
                raise document.build_error(
                    (*loc, i), f"{found}; the URDF allows {urdf_range}, which may only be narrowed"
                )
            lower[i], upper[i] = (lo, hi) if j.kind == "continuous" else (max(lo, lower[i]), min(hi, upper[i]))
    if limits.velocity_deg_s is not None:  # else the URDF's, in rad/s by its own definition
        warnings += _list_velocity_warnings(chain, limits.velocity_deg_s, rates["velocity_deg_s"])
    return JointLimits(lower, upper, rates["velocity_deg_s"], rates["acceleration_deg_s2"], rates["jerk_deg_s3"])


def _list_velocity_warnings(chain: JointChain, velocity_deg_s: Sequence[float], speed: Array) -> list[str]:
    """Return warnings of velocities that look like rad/s, and of those above the URDF's; ``speed`` (n,) in SI units."""
    warnings = []
    given = zip(chain.moving, velocity_deg_s, strict=True)
    turning = [(v, j.velocity) for j, v in given if j in chain.arm and j.kind != "prismatic"]
    # The URDF has rad/s by its own definition: much the same numbers are that, too. NaN compares false.
    as_in_urdf = all(_SAME[0] * urdf < v < _SAME[1] * urdf for v, urdf in turning)
    if turning and (max(v for v, _ in turning) < _RAD_GUESS or as_in_urdf):
        warnings.append(f"robot.limits.velocity_deg_s {velocity_deg_s} looks like rad/s; deg/s is expected")
    fast = [
        j.name for i, j in enumerate(chain.moving) if speed[i] > _FASTER * j.velocity > 0
    ]  # NaN compares false; 0: it has none
    if fast:
        warnings.append(f"robot.limits.velocity_deg_s is above the URDF's velocity for {', '.join(fast)}")
    return warnings


def read_velocity_limits(chain: JointChain, keys: CellKeys, document: YamlDocument) -> list[float]:
    """Read the velocity limits: those of the cell, else of the URDF.

    Args:
        chain: Arm joints and external joints of the cell.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.

    Returns:
        Limits in the order of ``chain.moving``, units of the file.

    Raises:
        InputError: neither gives one.
    """
    given = keys.robot.limits.velocity_deg_s
    if given is not None:
        return given
    for j in chain.moving:
        if not j.velocity > 0.0:  # also NaN, where there is no <limit>
            found = "no <limit>" if math.isnan(j.velocity) else f"velocity {j.velocity:g}"
            raise document.build_error(
                ("robot", "limits"),
                f"velocity_deg_s is not given, and joint {j.name!r} of the URDF has {found}; "
                f"expected velocity_deg_s, one per moving joint ({chain.names}), or a velocity above 0 in the URDF",
            )
    return [float(j.velocity / unit) for j, unit in zip(chain.moving, chain.unit, strict=True)]


def describe_urdf_limits(chain: JointChain, keys: CellKeys) -> tuple[str, ...]:
    """Describe the limits that the cell takes from the URDF, with their values.

    Args:
        chain: Arm joints and external joints of the cell.
        keys: Validated keys of cell.yaml.

    Returns:
        One sentence each.
    """
    limits, out = keys.robot.limits, []
    if limits.velocity_deg_s is None:
        values = ", ".join(
            f"{j.name} {j.velocity / u:.4g} {'mm/s' if j.kind == 'prismatic' else 'deg/s'}"
            for j, u in zip(chain.moving, chain.unit, strict=True)
        )
        out.append(f"robot.limits.velocity_deg_s is not given; the URDF's velocities hold: {values}")
    if limits.position_deg is None:
        values = ", ".join(
            f"{j.name} {j.lower / u:.4g} to {j.upper / u:.4g} {'mm' if j.kind == 'prismatic' else 'deg'}".replace(
                "-", "−"
            )
            for j, u in zip(chain.moving, chain.unit, strict=True)
            if j.kind != "continuous"
        )
        if values:
            out.append(f"robot.limits.position_deg is not given; the URDF's ranges hold: {values}")
    return tuple(out)


def describe_unused_motion(urdf: UrdfModel, chain: JointChain, limits: JointLimits) -> tuple[str, ...]:
    """What of the robot is not used to the full: joints that nothing drives, and turns beyond those that are searched.

    Args:
        limits: in the order of ``chain.moving``.
    """
    out = []
    idle = [j.name for j in urdf.joints if j.moves and j.mimic is None and j not in chain.moving]
    if idle:
        out.append(f"not driven: the joints {', '.join(idle)} of {urdf.path.name}, fixed at zero")
    far = np.maximum(np.abs(limits.lower), np.abs(limits.upper))
    wide = [j.name for i, j in enumerate(chain.moving) if j in chain.arm and j.kind != "prismatic" and far[i] > _TURNED]
    if wide:
        out.append(f"of the range of {', '.join(wide)} the planner uses -540 to 540 deg")
    return tuple(out)


def read_home(chain: JointChain, limits: JointLimits, keys: CellKeys, document: YamlDocument) -> Array:
    """Read the home position; with as many values as the arm has joints, the external joints are zero.

    Args:
        chain: Arm joints and external joints of the cell.
        limits: Joint limits in the order of ``chain.moving``, SI units.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.

    Returns:
        Position in the order of ``chain.moving``, rad or m.
    """
    return _read_joint_position(chain, limits, keys.robot.home_deg, "home_deg", document)


def read_tool_change_position(
    chain: JointChain, limits: JointLimits, keys: CellKeys, document: YamlDocument
) -> Array | None:
    """Read the tool change position, as :func:`read_home`.

    Args:
        chain: Arm joints and external joints of the cell.
        limits: Joint limits in the order of ``chain.moving``, SI units.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.

    Returns:
        Position in the order of ``chain.moving``, rad or m; None where the cell gives none.
    """
    values = keys.robot.tool_change_deg
    return None if values is None else _read_joint_position(chain, limits, values, "tool_change_deg", document)


def _read_joint_position(
    chain: JointChain, limits: JointLimits, values: list[float], key: str, document: YamlDocument
) -> Array:
    full = values
    if len(values) == len(chain.arm) < len(chain.moving):
        full = [*values, *([0.0] * len(chain.external))]
    _build_length_error(chain, document, ("robot", key), len(full))
    position = np.array(full) * chain.unit
    for i, j in enumerate(chain.moving):
        if not limits.lower[i] <= position[i] <= limits.upper[i]:
            lo, hi = (round(float(v / chain.unit[i]), 3) for v in (limits.lower[i], limits.upper[i]))
            loc: KeyPath = ("robot", key, i) if full is values else ("robot", key)
            raise document.build_error(loc, f"found {full[i]:g} for joint {j.name!r}; its range is [{lo:g}, {hi:g}]")
    return position


def _read_urdf_range(
    joint: UrdfJoint, document: YamlDocument, warnings: list[str], *, given: bool
) -> tuple[float, float]:
    """``given``: the cell has a range of its own."""
    if joint.kind == "continuous":
        if not given:
            warnings.append(
                f"joint {joint.name!r} is continuous; its range is taken as ±360°, and robot.limits.position_deg may "
                "say another"
            )
        return -_CONTINUOUS, _CONTINUOUS
    if not joint.lower < joint.upper:  # also where <limit> is missing
        found = "no <limit>" if math.isnan(joint.lower) else f"lower {joint.lower:g}, upper {joint.upper:g}"
        raise document.build_error(
            ("robot", "urdf"), f"joint {joint.name!r} has {found}; expected a <limit> with lower < upper"
        )
    return joint.lower, joint.upper


def _build_length_error(chain: JointChain, document: YamlDocument, loc: KeyPath, found: int) -> None:
    n = len(chain.moving)
    if found != n:
        raise document.build_error(loc, f"found {found} values; expected {n}, one per moving joint ({chain.names})")

"""Default tool of a new cell: a spindle along the flange axis, or on a bracket at 45 or 90 degrees.

With a spindle along axis 6 the rotation about the tool axis has no effect, because axis 6 alone performs it. With a
bracket the rotation moves all joints, so machopt can optimise it. The default is therefore 45 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.cell_setup.template.init_request import InitRequest
from machopt.cell_setup.workpiece_placement import compute_pointing_rpy
from machopt.errors import OptionError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_rpy_matrix

ANGLE_DEG = 45.0  # of the bracket where no option states the tool
_METRES_LOOK = 5.0  # mm; a tool as short is rather stated in metres
_BRACKET = 0.4  # share of the tool's length from the flange to the place where the spindle axis begins
_RADIUS_MM, _SHARE = (20.0, 40.0), 0.2  # of bracket and spindle: a share of the tool's length within these


@dataclass(frozen=True)
class DefaultTool:
    """A tool in the flange frame; mm and degrees."""

    tcp_mm: tuple[float, ...]
    rpy_deg: tuple[float, ...]
    middle_mm: tuple[float, ...]  # of the spindle
    bodies: str  # one line of YAML, empty where there is no room for a body
    note: str


def select_tool_angle(request: InitRequest) -> float:
    """Select the angle between spindle and flange axis: as given, 0 where another option gives the tool, else 45.

    Args:
        request: Validated options of the command.

    Returns:
        Angle, degrees.

    Raises:
        OptionError: the tool is given twice, or the angle is not 0, 45 or 90.
    """
    stated = [n for n in ("tcp_mm", "tcp_rpy_deg") if getattr(request, n) is not None]
    if request.tool_angle_deg is not None:
        if request.tool_angle_deg not in (0.0, 45.0, 90.0):
            raise OptionError(f"found {request.tool_angle_deg:g}; expected 0, 45 or 90", where="--tool-angle-deg")
        if stated and request.tool_angle_deg:
            option = "--" + stated[0].replace("_", "-")
            raise OptionError(f"found together with {option}, which states the tool already", where="--tool-angle-deg")
        return request.tool_angle_deg
    return 0.0 if stated or request.tool_length_mm is not None or request.tool_mesh is not None else ANGLE_DEG


def build_tool(out: Array, angle_deg: float, length: float, cutter: float) -> DefaultTool:
    """Return a spindle on a bracket, whose bodies end where the cutter begins.

    Args:
        out: (3,) unit, the direction in which the flange looks, in the flange frame.
        angle_deg: between it and the spindle.
        length: mm, along bracket and spindle from the flange to the TCP.
        cutter: mm, from the TCP back.

    Raises:
        InputError: the cutter is longer than the spindle.
    """
    radius = float(np.clip(_SHARE * length, *_RADIUS_MM))
    R = compute_rpy_matrix(compute_pointing_rpy(out))
    angle = np.radians(angle_deg)
    along = np.cos(angle) * out + np.sin(angle) * R[:, 0]
    begin = (_BRACKET * length if angle_deg else 0.0) * out
    reach = length - float(np.linalg.norm(begin))
    if length <= cutter and 0.0 < length < _METRES_LOOK:
        other = f"; if that is m, {length * 1e3:g} would work" if length * 1e3 > 2.0 * cutter else ""
        raise OptionError(
            f"found {length:g} mm; expected mm, and more than the cutter's {cutter:g} mm (--cutter-length-mm){other}",
            where="--tool-length-mm",
        )
    if not 0 < cutter < reach:
        raise OptionError(
            f"found {cutter:g}; expected more than zero and less than the spindle's {reach:g} mm (--tool-length-mm)",
            where="--cutter-length-mm",
        )
    back = radius if angle_deg else 0.0  # the spindle's rear end lies behind the bracket's axis
    spindle = _format_cylinder(
        "spindle", begin - back * along, begin + (reach - cutter) * along, radius if angle_deg else 40.0
    )
    bracket = f"{_format_cylinder('bracket', np.zeros(3), begin, radius)}, " if angle_deg else ""
    return DefaultTool(
        tcp_mm=_round_vector(begin + reach * along),
        rpy_deg=_round_vector(np.degrees(compute_pointing_rpy(along)), 4),
        middle_mm=_round_vector(begin + 0.5 * (reach - cutter) * along),
        bodies=bracket + spindle,
        note=f"z along the spindle, {angle_deg:g} deg from where the flange looks"
        if angle_deg
        else "z out of the flange",
    )


def _format_cylinder(name: str, first: Array, last: Array, radius: float) -> str:
    """One body as YAML, between two points (3,) mm."""
    way = last - first
    angles = list(_round_vector(np.degrees(compute_pointing_rpy(way)), 4))
    height = round(float(np.linalg.norm(way)), 3)
    middle = list(_round_vector((first + last) / 2.0))
    return f"{{name: {name}, cylinder_mm: [{radius:g}, {height:g}], xyz_mm: {middle}, rpy_deg: {angles}}}"


def _round_vector(v: Array, digits: int = 3) -> tuple[float, ...]:
    return tuple(float(x) + 0.0 for x in np.round(v, digits))

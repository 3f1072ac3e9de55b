"""Size check of a body against its robot, to detect wrong units (mm for m, or m for mm)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from machopt.cell.mesh.mesh_errors import ErrorFactory

_LARGE, _SMALL = 10.0, 1 / 500.0  # of the robot's reach: a thousand times off any part lies far beyond, both ways
_LARGEST = 50.0  # m; objects in a hall around the robot
_SMALLEST = 3e-3  # m; the longest side of nothing in a cell that collides is shorter; a link of 3 m in mm has that
_ODD = 5e-3  # m; few things are

Role = Literal["link", "tool", "workpiece", "obstacle"]


@dataclass(frozen=True)
class SceneSize:
    """What sizes are measured by: how far the arm and its rail reach, in m; 0 where that is not known."""

    reach: float


@dataclass(frozen=True)
class SizedBody:
    """A body by its longest side."""

    what: str  # "mesh spindle.stl", "box_mm"
    role: Role
    extent: float  # m
    remedy: Callable[[float], str]  # how to make it so many times as large, e.g. ``scale: 0.001``


def check_body_size(body: SizedBody, scene: SceneSize, fail: ErrorFactory) -> str | None:
    """Check that a body fits its robot in size; a factor of a thousand indicates a wrong unit (mm for m).

    Args:
        body: Name and size of the body.
        scene: Sizes of robot and cell.
        fail: Function that builds an error from a message.

    Returns:
        A warning for an unusual size, else None.

    Raises:
        InputError: the size is impossible for this robot.
    """
    wide = f"{body.what} is {body.extent:.4g} m wide"
    beside = f", the robot reaches {scene.reach:.3g} m" if scene.reach else ""
    large = _LARGE * scene.reach if scene.reach and body.role != "obstacle" else _LARGEST
    if body.extent > min(large, _LARGEST):
        other = f"; if it is in mm, {body.remedy(1e-3)} would work" if body.extent / 1e3 <= min(large, _LARGEST) else ""
        raise fail(f"{wide}{beside}; expected at most {min(large, _LARGEST):.3g} m{other}")
    # an adapter plate is small, too: only below what any body has is a unit wrong for sure
    small = _SMALL * scene.reach if body.role == "link" else 0.0
    if body.extent < _SMALLEST:
        other = f"; if it is in m, {body.remedy(1e3)} would work" if body.extent * 1e3 >= _SMALLEST else ""
        raise fail(f"{body.what} is only {body.extent * 1e3:.3g} mm wide{beside}{other}")
    if body.extent < max(_ODD, small):
        return f"{body.what} is only {body.extent * 1e3:.3g} mm wide{beside}; is its unit meant?"
    if scene.reach and body.extent > _LARGE * scene.reach:
        return f"{wide}{beside}; is its unit meant?"
    return None

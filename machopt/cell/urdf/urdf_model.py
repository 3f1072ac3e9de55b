"""URDF model as a cell needs it: links, joints, bodies and masses, and their tree."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from machopt.errors import InputError, RobotModelError

MOVING = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclass(frozen=True)
class UrdfMimic:
    """A joint whose value is ``multiplier`` times another's value plus ``offset``."""

    joint: str
    multiplier: float
    offset: float  # rad or m


@dataclass(frozen=True, kw_only=True)
class UrdfJoint:
    name: str
    kind: str  # revolute, continuous, prismatic, fixed, planar, floating
    parent: str
    child: str
    lower: float  # rad or m; NaN where the URDF gives none
    upper: float
    velocity: float  # rad/s or m/s; NaN where the URDF gives none
    mimic: UrdfMimic | None
    xyz: tuple[float, ...]  # m, of the joint in the parent link's frame
    rpy: tuple[float, ...]  # rad
    line: int

    @property
    def offset(self) -> float:
        """m from the parent link's frame to the joint's."""
        return math.hypot(*self.xyz)

    @property
    def moves(self) -> bool:
        return self.kind in MOVING


@dataclass(frozen=True)
class UrdfMesh:
    """A collision mesh as the URDF names it."""

    link: str
    uri: str
    scale: float  # m per unit of the file
    line: int


@dataclass(frozen=True)
class UrdfSolid:
    """A collision box, cylinder or sphere."""

    link: str
    kind: str
    size: float  # m, its longest edge, height or diameter
    line: int


@dataclass(frozen=True)
class UrdfLink:
    name: str
    mass: float | None  # kg; None where the link has no <inertial>
    visuals: int
    collisions: int
    line: int


@dataclass(frozen=True, kw_only=True)
class UrdfModel:
    path: Path
    parts: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]
    meshes: tuple[UrdfMesh, ...]  # collision only: pictures may be missing
    solids: tuple[UrdfSolid, ...]
    unused_elements: dict[str, int] = field(default_factory=dict)  # element → how often; nothing in them is used
    warnings: tuple[str, ...] = ()
    empty_dynamics: bool = False  # some <dynamics> without values, which the model's parser does not accept

    @property
    def links(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parts)

    @property
    def has_collision(self) -> bool:
        return any(p.collisions for p in self.parts)

    def chain(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return every joint from the root of the tree to a link, in order.

        Args:
            link: Name of the link.
        """
        above = {j.child: j for j in self.joints}
        out: list[UrdfJoint] = []
        while link in above:
            out.append(above[link])
            link = out[-1].parent
        return tuple(reversed(out))


def check_tree(path: Path, links: tuple[str, ...], joints: tuple[UrdfJoint, ...]) -> None:
    """Check the tree: links of joints exist, no link has two parent joints, one root, no loop.

    Args:
        path: Path of the file.
        links: Names of the links.
        joints: The joints.

    Raises:
        RobotModelError: names file and line.
    """
    above: dict[str, UrdfJoint] = {}
    for j in joints:
        for link in (j.parent, j.child):
            if link not in links:
                raise _build_joint_error(
                    path, j, f"joint {j.name!r} names the link {link!r}, which the URDF does not have"
                )
        if j.child in above:
            raise _build_joint_error(
                path, j, f"link {j.child!r} hangs on two joints, {above[j.child].name!r} and {j.name!r}"
            )
        above[j.child] = j
    for j in joints:
        seen, link = {j.child}, j.parent
        while link in above:
            if link in seen:
                raise _build_joint_error(path, j, f"joint {j.name!r} is part of a closed loop; a tree would work")
            seen.add(link)
            link = above[link].parent
    roots = [link for link in links if link not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none"
        raise RobotModelError(f"found {len(roots)} root links ({found}); expected one tree of links", file=path)


def _build_joint_error(path: Path, joint: UrdfJoint, message: str) -> InputError:
    return RobotModelError(message, file=path, where=f"line {joint.line}")

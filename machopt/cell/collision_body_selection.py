"""Selection of the robot's collision bodies: bodies of joints outside the chain are removed.

Where only the kinematics is needed, bodies whose mesh is missing are removed too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from machopt.cell.joints.mimic_joints import OffChainMimicJoint
from machopt.cell.urdf import RobotDescription, UrdfModel, find_mesh, remove_bodies, remove_model_bodies
from machopt.errors import InputError
from machopt.file_formats.file_reading import MARKUP, read_text


@dataclass(frozen=True)
class UsedRobotBodies:
    """A robot as it is used."""

    urdf: UrdfModel
    text: str | None  # of it; None where the file itself is used
    warnings: tuple[str, ...]  # what is left out


def select_bodies(
    description: RobotDescription, side: tuple[OffChainMimicJoint, ...], missing: dict[str, str] | None = None
) -> UsedRobotBodies:
    """Return a robot without the bodies that are left out.

    Args:
        description: of the robot.
        side: joints outside of the chain.
        missing: mesh by link that is not there, as :func:`find_missing_meshes` gives it.
    """
    urdf, missing = description.urdf, missing or {}
    warnings = [warning for s in side if (warning := s.warning(urdf)) is not None]
    warnings += [
        f"{urdf.path.name}: the collision mesh {uri} of link {link!r} is missing; only the kinematics is used here, so "
        "its bodies are left out"
        for link, uri in missing.items()
    ]
    links = {link for s in side for link in s.links} | set(missing)
    if not any(p.collisions for p in urdf.parts if p.name in links):
        return UsedRobotBodies(urdf, description.text, tuple(warnings))
    text = read_text(urdf.path, expected="a URDF", most=MARKUP) if description.text is None else description.text
    return UsedRobotBodies(remove_model_bodies(urdf, links), remove_bodies(text, links), tuple(warnings))


def find_missing_meshes(urdf: UrdfModel, packages: dict[str, Path], folder: Path) -> dict[str, str]:
    """Return the first collision mesh of each link whose package or file does not exist, by link.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        packages: ROS package → folder.
        folder: Cell folder.

    Returns:
        Link → URI of its first missing mesh.
    """
    out: dict[str, str] = {}
    for mesh in urdf.meshes:
        try:
            there = find_mesh(urdf, mesh.uri, packages, folder, InputError).path.is_file()
        except InputError:
            there = False
        if not there:
            out.setdefault(mesh.link, mesh.uri)
    return out

"""Removal of URDF elements: collision bodies of some links, elements without content."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from xml.etree import ElementTree

from machopt.cell.urdf.urdf_model import UrdfModel


def remove_bodies(text: str, links: Collection[str]) -> str:
    """Return the text of a URDF, already checked, without the ``<collision>`` elements of some links.

    Args:
        text: Text of a checked URDF.
        links: Names of the links.

    Returns:
        The shorter text.
    """
    root = ElementTree.fromstring(text)
    for link in root.findall("link"):
        if link.get("name") in links:
            for body in link.findall("collision"):
                link.remove(body)
    return ElementTree.tostring(root, encoding="unicode")


def remove_empty_dynamics(text: str) -> str:
    """Return the text of a URDF, already checked, without ``<dynamics>`` that have neither damping nor friction.

    Args:
        text: Text of a checked URDF.

    Returns:
        The shorter text.
    """
    root = ElementTree.fromstring(text)
    for joint in root.findall("joint"):
        for dynamics in joint.findall("dynamics"):
            if not {"damping", "friction"} & set(dynamics.attrib):
                joint.remove(dynamics)
    return ElementTree.tostring(root, encoding="unicode")


def remove_model_bodies(urdf: UrdfModel, links: Collection[str]) -> UrdfModel:
    """Return the same robot without the collision bodies of some links.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        links: Names of the links.

    Returns:
        The robot without these bodies.
    """
    return replace(
        urdf,
        parts=tuple(replace(p, collisions=0, visuals=0) if p.name in links else p for p in urdf.parts),
        meshes=tuple(m for m in urdf.meshes if m.link not in links),
        solids=tuple(s for s in urdf.solids if s.link not in links),
    )

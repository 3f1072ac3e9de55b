"""Inventory of bodies and masses from a second reading of the URDF, compared with what was loaded and is checked.

A parser may ignore an element that it cannot read. A link would then have no collision shape or no mass. Here the
file is plain XML: each ``<collision>`` must be loaded with its kind and size, each link's mass must count, and every
body must be in at least one checked pair.
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from machopt.data_types.cell import Cell
from machopt.verification.check_results import VerificationCheck, build_count_check
from machopt.verification.motion.collision.bodies import CoalBody
from machopt.verification.motion.collision.checked_pairs import list_allowed_contacts, list_checked_pairs
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

SIZE_ATTRIBUTES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
}
SIZE_TOLERANCE_M = 1e-6
MASS_TOLERANCE = 1e-6  # of the total mass


def check_inventory(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody], checked: list[tuple[CoalBody, CoalBody]]
) -> list[VerificationCheck]:
    """Check that every body and mass of the URDF is included in the contact check.

    Args:
        cell: The robot cell.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        checked: Pairs that are checked for contacts.
    """
    try:
        root = ElementTree.fromstring(cell.urdf_text)
    except (OSError, ElementTree.ParseError) as error:
        return [
            VerificationCheck(
                name="bodies of the URDF",
                passed=False,
                value=np.nan,
                limit=0.0,
                unit="bodies",
                where=f"{cell.urdf.name} cannot be read: {error}",
            )
        ]
    return [
        build_count_check("bodies of the URDF", _find_lost_bodies(root, bodies), "bodies"),
        build_count_check("joints and masses of the URDF", _find_lost_masses(root, arm), "links"),
        build_count_check("bodies checked for contacts", _find_unchecked_bodies(cell, arm, bodies, checked), "bodies"),
    ]


def _find_lost_bodies(root: ElementTree.Element, bodies: list[CoalBody]) -> list[str]:
    loaded: dict[str, CoalBody] = {b.name: b for b in bodies if b.kind == "link"}
    wrong, expected = [], set()
    for link in root.findall("{*}link"):
        name = str(link.get("name"))
        for n, element in enumerate(link.findall("{*}collision")):
            label = f"{name}_{n}"
            expected.add(label)
            geometry = element.find("{*}geometry")
            shapes = [] if geometry is None else [g for g in geometry if isinstance(g.tag, str)]
            if len(shapes) != 1:
                wrong.append(f"collision {n + 1} of link {name!r} has {len(shapes)} shapes, one would work")
            elif label not in loaded:
                wrong.append(f"collision {n + 1} of link {name!r} was not loaded")
            else:
                why = _describe_difference(shapes[0], loaded[label])
                wrong += [f"collision {n + 1} of link {name!r}: {why}"] if why else []
    wrong += [f"{name!r} was loaded but belongs to no link" for name in loaded if name not in expected]
    return wrong


def _describe_difference(shape: ElementTree.Element, body: CoalBody) -> str:
    """In what the loaded shape is not that of the file; meshes must have triangles and some size."""
    word = shape.tag.rpartition("}")[2]
    kind = type(body.shape).__name__
    extent = 2.0 * body.half_size
    if word == "mesh":
        if not kind.startswith("BVH"):
            return f"is a mesh, loaded as {kind}"
        triangles = int(body.shape.num_tris)
        if triangles < 4 or not (np.isfinite(extent).all() and extent.max() > 0.0):
            return f"its mesh has {triangles} triangles and {1e3 * extent.max():.3g} mm"
        return ""
    if word not in SIZE_ATTRIBUTES:
        return f"a <{word}> is not known"
    if kind.lower() != word:
        return f"is a {word}, loaded as {kind}"
    try:
        size = [float(v) for key in SIZE_ATTRIBUTES[word] for v in str(shape.get(key)).split()]
    except ValueError:
        return f"its size {dict(shape.attrib)} is no number"
    wanted = {
        "box": size,
        "cylinder": [2 * size[0]] * 2 + size[1:],
        "sphere": [2 * size[0]] * 3,
        "capsule": [2 * size[0]] * 2 + [size[-1] + 2 * size[0]],
    }[word]
    if len(wanted) != 3 or np.abs(np.array(wanted) - extent).max() > SIZE_TOLERANCE_M:
        return f"has {[round(1e3 * v, 3) for v in wanted]} mm, loaded with {np.round(1e3 * extent, 3).tolist()} mm"
    return ""


def _find_lost_masses(root: ElementTree.Element, arm: UrdfKinematics) -> list[str]:
    """Each moving joint is there, and every joint carries the masses of the links that are fixed to it."""
    wrong = []
    moving, parent = {}, {}
    for joint in root.findall("{*}joint"):
        child, above = (
            str(getattr(joint.find(f"{{*}}{end}"), "attrib", {}).get("link")) for end in ("child", "parent")
        )
        parent[child] = above
        if joint.get("type") != "fixed":
            moving[child] = joint
    for joint in moving.values():
        if not arm.model.existJointName(str(joint.get("name"))):
            wrong.append(f"joint {joint.get('name')!r} was not loaded")
    stated: dict[str, float] = {}
    named: dict[str, list[str]] = {}
    for link in root.findall("{*}link"):
        for inertial in link.findall("{*}inertial"):
            mass = inertial.find("{*}mass")
            try:
                value = float(str(None if mass is None else mass.get("value")))
            except ValueError:
                wrong.append(f"the mass of link {link.get('name')!r} is no number")
                continue
            at = str(link.get("name"))
            while at not in moving and at in parent:
                at = parent[at]
            carrier = str(moving[at].get("name")) if at in moving else "universe"
            stated[carrier] = stated.get(carrier, 0.0) + value
            named.setdefault(carrier, []).append(str(link.get("name")))
    total = max(sum(abs(v) for v in stated.values()), 1e-9)
    for carrier, weight in stated.items():
        if carrier == "universe" or not arm.model.existJointName(carrier):
            continue
        have = float(arm.model.inertias[arm.model.getJointId(carrier)].mass)
        if abs(have - weight) > MASS_TOLERANCE * total:
            wrong.append(f"links {', '.join(named[carrier])} weigh {weight:g} kg, {have:g} kg were loaded")
    return wrong


def _find_unchecked_bodies(
    cell: Cell, arm: UrdfKinematics, bodies: list[CoalBody], checked: list[tuple[CoalBody, CoalBody]]
) -> list[str]:
    """Bodies in no pair, though something moves against them that the cell does not let them touch; a second copy of
    one that is in a pair (the cutter drawn in) counts with it."""
    used = {b.name for pair in checked for b in pair}
    idle = [b for b in bodies if b.name not in used and any(_is_moving_against(arm, a, b) for a in bodies)]
    may = list_allowed_contacts(cell)
    if any(b.name in pair for pair in may for b in idle):
        every = [(a.name, b.name) for a, b in list_checked_pairs(replace(cell, may_touch=()), arm, bodies)]
        own = {b.name: [pair for pair in every if b.name in pair] for b in idle}
        idle = [b for b in idle if not own[b.name] or any(pair not in may for pair in own[b.name])]
    return [f"{b.kind} {b.name!r} is in no pair that is checked" for b in idle]


def _is_moving_against(arm: UrdfKinematics, a: CoalBody, b: CoalBody) -> bool:
    """Neither are the two fixed to each other, nor neighbours on the arm, which are built touching."""
    if a.link >= 0 and b.link >= 0:
        return abs(a.link - b.link) >= 2
    return arm.list_moving_joints(a.carrier) != arm.list_moving_joints(b.carrier)

"""Moving joints of a cell and their arrays: arm joints in chain order, then external joints in cell order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.cell.cell_schema import CellKeys
from machopt.cell.urdf import UrdfJoint, UrdfModel
from machopt.errors import TooManyArmJointsError, suggest_nearest_word
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class JointChain:
    """``moving`` as the file's arrays are: arm joints, then external joints as listed."""

    arm: tuple[UrdfJoint, ...]
    external: tuple[UrdfJoint, ...]
    moving: tuple[UrdfJoint, ...]

    @property
    def unit(self) -> Array:
        """SI per unit of the file, for each moving joint."""
        return np.array([1e-3 if j.kind == "prismatic" else math.pi / 180 for j in self.moving])

    @property
    def names(self) -> str:
        return ", ".join(j.name for j in self.moving)


def read_chain(urdf: UrdfModel, keys: CellKeys, document: YamlDocument, *, any_chain: bool = False) -> JointChain:
    """Find the arm and the external joints, and check that nothing else moves flange or workpiece.

    The arm has six revolute joints, and mimic joints between them that follow one of these. With ``any_chain`` it has
    one or more revolute or prismatic joints.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        keys: Validated keys of cell.yaml.
        document: Parsed YAML file, with the line of each key for errors.
        any_chain: Whether the arm may have other than six revolute joints.

    Returns:
        The chain.

    Raises:
        InputError: the joints form no such chain.
    """
    robot = keys.robot
    for key, link in (("base_link", robot.base_link), ("flange_link", robot.flange_link)):
        if link not in urdf.links:
            raise document.build_error(
                ("robot", key),
                f"link {link!r} is not in {urdf.path.name}; {suggest_nearest_word(link, list(urdf.links))}",
            )
    to_flange, to_base = urdf.chain(robot.flange_link), urdf.chain(robot.base_link)
    if to_flange[: len(to_base)] != to_base:
        raise document.build_error(
            ("robot", "flange_link"),
            f"{robot.flange_link!r} is not connected behind base_link {robot.base_link!r}: "
            f"the chain to it is {' → '.join(j.child for j in to_flange) or 'empty'}",
        )
    own = [j for j in to_flange[len(to_base) :] if j.moves and (any_chain or j.mimic is None)]
    external = _find_external_joints(urdf, keys, document)
    arm = _find_arm_joints([j for j in own if j not in external], urdf, keys, document, any_chain)
    behind = next((j for j in external if j in to_flange[len(to_base) :]), None)
    if behind is not None:
        raise document.build_error(
            ("robot", "external_joints"),
            f"joint {behind.name!r} is between base_link {robot.base_link!r} and the flange; expected a rail that "
            f"carries base_link, so that base_link would be {behind.child!r} or a link behind it",
        )
    to_part = () if keys.workpiece.link == "world" else _find_workpiece_joints(urdf, arm, keys, document)
    moves = tuple(dict.fromkeys(j for j in (*to_flange, *to_part) if j.moves))
    followers = [j for j in to_flange[len(to_base) :] if j.mimic is not None]
    moving = tuple(j for j in moves if any_chain or j not in followers)
    _check_moving_joints(moving, arm, external, document, any_chain=any_chain)
    if not any_chain:
        _check_followers(followers, arm, document)
    idle = [j.name for j in external if j not in moving]
    if idle:
        raise document.build_error(
            ("robot", "external_joints"), f"joint {idle[0]!r} moves neither the flange nor the workpiece link"
        )
    return JointChain(tuple(arm), tuple(external), (*arm, *external))


def _check_followers(followers: Sequence[UrdfJoint], arm: Sequence[UrdfJoint], document: YamlDocument) -> None:
    """Raise InputError where a mimic joint follows no joint of the arm."""
    sources = {a.name for a in arm}
    for j in followers:
        if j.mimic is not None and j.mimic.joint not in sources:
            raise document.build_error(
                ("robot", "urdf"),
                f"joint {j.name!r} mimics {j.mimic.joint!r}, which is no joint of the arm; it has "
                f"{', '.join(a.name for a in arm)}",
            )


def _check_moving_joints(
    moving: Sequence[UrdfJoint],
    arm: Sequence[UrdfJoint],
    external: Sequence[UrdfJoint],
    document: YamlDocument,
    *,
    any_chain: bool,
) -> None:
    """Raise InputError where a joint that moves flange or workpiece is a mimic joint, or is not listed."""
    for j in moving:
        if j.mimic is not None:
            kind = "moves the base or the workpiece" if not any_chain else "is in the chain"
            raise document.build_error(
                ("robot", "urdf"),
                f"joint {j.name!r} mimics {j.mimic.joint!r} and {kind}; only a joint between base_link and "
                "flange_link may follow another, and none where a motion is diagnosed",
            )
        if j not in arm and j not in external:
            raise document.build_error(
                ("robot", "external_joints"),
                f"{j.kind} joint {j.name!r} moves the base or the workpiece but is not listed; "
                "add it to external_joints",
            )


def _find_external_joints(urdf: UrdfModel, keys: CellKeys, document: YamlDocument) -> list[UrdfJoint]:
    out: list[UrdfJoint] = []
    for i, name in enumerate(keys.robot.external_joints):
        loc: KeyPath = ("robot", "external_joints", i)
        joint = _find_joint(urdf, name, document, loc)
        if joint in out or name in (keys.robot.arm_joints or ()):
            raise document.build_error(loc, f"joint {name!r} is named twice")
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise document.build_error(
                loc, f"joint {name!r} is {joint.kind}; expected revolute, continuous or prismatic"
            )
        out.append(joint)
    return out


def _find_arm_joints(
    chain: list[UrdfJoint], urdf: UrdfModel, keys: CellKeys, document: YamlDocument, any_chain: bool
) -> list[UrdfJoint]:
    """The arm's joints among the moving joints base → flange that are not external."""
    kinds = ("revolute", "continuous", "prismatic") if any_chain else ("revolute", "continuous")
    wanted = "revolute or prismatic" if any_chain else "revolute"
    names = keys.robot.arm_joints
    for i, name in enumerate(names or ()):
        loc: KeyPath = ("robot", "arm_joints", i)
        joint = _find_joint(urdf, name, document, loc)
        if name in (names or ())[:i]:
            raise document.build_error(loc, f"joint {name!r} is named twice")
        if joint.kind not in kinds:
            raise document.build_error(loc, f"joint {name!r} is {joint.kind}; expected a {wanted} joint")
        if joint.mimic is not None:
            raise document.build_error(
                loc, f"joint {name!r} mimics {joint.mimic.joint!r}, so it is no joint of its own; leave it out"
            )
    found = ", ".join(f"{j.name} ({j.kind})" for j in chain) or "no moving joint"
    follow = [j for j in urdf.chain(keys.robot.flange_link) if j.mimic is not None]
    if follow:
        found += " beside " + ", ".join(f"{j.name} (mimics {j.mimic.joint!r})" for j in follow if j.mimic is not None)
    span = f"from {keys.robot.base_link!r} to {keys.robot.flange_link!r}"
    where: KeyPath = ("robot", "arm_joints") if names is not None else ("robot", "flange_link")
    if len(chain) > 6 and not any_chain and all(j.kind in kinds for j in chain):
        raise TooManyArmJointsError(
            f"the chain {span} has {len(chain)} joints that turn ({', '.join(j.name for j in chain)}); a motion can be "
            "planned for six (a rail or positioner joint goes into external_joints). machopt identify and machopt "
            f"diagnose take recordings of such an arm, with columns q1_deg … q{len(chain)}_deg",
            file=document.file,
            where=".".join(map(str, where)),
        )
    if not chain or (len(chain) != 6 and not any_chain) or any(j.kind not in kinds for j in chain):
        raise document.build_error(
            where,
            f"the chain {span} has {found}; expected {'one or more' if any_chain else 'six'} {wanted} joints "
            "(a rail or positioner joint goes into external_joints)",
        )
    if names is not None and names != [j.name for j in chain]:
        raise document.build_error(where, f"found {', '.join(names)}; the chain {span} has, in order, {found}")
    return chain


def check_carrier(link: str, urdf: UrdfModel, chain: JointChain, document: YamlDocument, loc: KeyPath) -> None:
    """Check that a link may carry an obstacle.

    Args:
        link: Name of the link.
        urdf: The robot: links, joints, bodies and masses.
        chain: Arm joints and external joints of the cell.
        document: Parsed YAML file, with the line of each key for errors.
        loc: Key path of the value in the document.

    Raises:
        InputError: there is no such link, or the arm moves it.
    """
    if link not in urdf.links:
        raise document.build_error(
            loc, f"link {link!r} is not in {urdf.path.name}; {suggest_nearest_word(link, ['world', *urdf.links])}"
        )
    carried = [j.name for j in urdf.chain(link) if j in chain.arm]
    if carried:
        raise document.build_error(
            loc,
            f"link {link!r} is moved by the arm's joint {carried[-1]!r}; expected world or a link of a rail or "
            "positioner (a body of the arm belongs into the URDF or under tool.geometry)",
        )


def _find_workpiece_joints(
    urdf: UrdfModel, arm: list[UrdfJoint], keys: CellKeys, document: YamlDocument
) -> tuple[UrdfJoint, ...]:
    link = keys.workpiece.link
    if link not in urdf.links:
        raise document.build_error(
            ("workpiece", "link"),
            f"link {link!r} is not in {urdf.path.name}; {suggest_nearest_word(link, ['world', *urdf.links])}",
        )
    path = urdf.chain(link)
    carried = [j.name for j in path if j in arm]
    if carried:
        raise document.build_error(
            ("workpiece", "link"),
            f"link {link!r} is moved by the arm's joint {carried[-1]!r}; expected world or a positioner",
        )
    return path


def _find_joint(urdf: UrdfModel, name: str, document: YamlDocument, loc: KeyPath) -> UrdfJoint:
    joint = next((j for j in urdf.joints if j.name == name), None)
    if joint is None:
        moving = [j.name for j in urdf.joints if j.moves]
        raise document.build_error(
            loc, f"joint {name!r} is not in {urdf.path.name}; {suggest_nearest_word(name, moving)}"
        )
    return joint

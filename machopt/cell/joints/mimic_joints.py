"""Mimic joints of a URDF: which of them follow the arm, and their effect on its limits.

A joint with ``<mimic joint="s" multiplier="m" offset="o"/>`` has the value m·q_s + o. Parallel linkages are written so:
an elbow that keeps its orientation while axis 2 turns is a joint in the chain with m = −1. A body on such a joint that
no arm joint moves has no position in the model of a serial arm.

A joint outside the chain from base to flange (the cylinder of a balancer, the rod of a linkage) does not move the
flange. Such joints are left out: their collision bodies are removed, their masses count at joint value zero, and a
warning names them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from machopt.cell.urdf import UrdfJoint, UrdfModel
from machopt.cell.urdf.urdf_model import UrdfMimic
from machopt.data_types.cell import JointLimits, MimicJoint
from machopt.errors import CellError, InputError

TURNING = ("revolute", "continuous")


@dataclass(frozen=True)
class OffChainMimicJoint:
    """A joint outside of the chain that moves with it, and what hangs on it."""

    joint: UrdfJoint
    source: UrdfJoint  # joint of the arm or external joint that moves it, at last
    links: tuple[str, ...]

    def warning(self, urdf: UrdfModel) -> str | None:
        """Describe what is not checked and not modelled.

        Args:
            urdf: The robot: links, joints, bodies and masses.

        Returns:
            The warning, None where the joint carries nothing.
        """
        parts = [p for p in urdf.parts if p.name in self.links]
        bodies = [p.name for p in parts if p.collisions]
        mass = sum(p.mass or 0.0 for p in parts)
        if not bodies and not mass:
            return None
        message = (
            [f"the collision bodies of {', '.join(bodies)} are left out: what touches them is not seen"]
            if bodies
            else []
        )
        message += [f"its {mass:g} kg count where they are at zero"] if mass else []
        return (
            f"{urdf.path.name}: line {self.joint.line}: joint {self.joint.name!r} follows {self.source.name!r} outside "
            f"of the chain to the flange (as the cylinder of a balancer does); {'; '.join(message)}"
        )


def find_side_followers(
    urdf: UrdfModel, arm: tuple[UrdfJoint, ...], external: tuple[UrdfJoint, ...], chain: tuple[UrdfJoint, ...]
) -> tuple[OffChainMimicJoint, ...]:
    """Joints outside of the chain that follow a joint of the arm or an external one, directly or by another follower.

    Args:
        urdf: the robot.
        arm, external: the driven joints.
        chain: every joint from the root to the flange, and to the workpiece.
    """
    by_name = {j.name: j for j in urdf.joints}
    out = []
    for j in urdf.joints:
        source, seen = j, {j.name}
        while source.mimic is not None and source.mimic.joint in by_name and source.mimic.joint not in seen:
            source = by_name[source.mimic.joint]
            seen.add(source.name)
        if j.mimic is None or j in chain or source not in (*arm, *external):
            continue
        links = [j.child]
        for link in links:  # grows while it is walked
            links += [k.child for k in urdf.joints if k.parent == link]
        out.append(OffChainMimicJoint(j, source, tuple(links)))
    return tuple(out)


def _check_mimic_joint(
    urdf: UrdfModel,
    j: UrdfJoint,
    m: UrdfMimic,
    listed: tuple[UrdfJoint, ...],
    external: tuple[UrdfJoint, ...],
) -> UrdfJoint:
    """Return the joint that a mimic joint follows; raise InputError where this is not supported."""
    by_name = {j.name: j for j in urdf.joints}
    if m.joint not in by_name:
        raise _build_joint_error(urdf, j, f"joint {j.name!r} mimics {m.joint!r}, which the URDF does not have")
    if j.kind not in (*TURNING, "prismatic"):
        raise _build_joint_error(
            urdf, j, f"joint {j.name!r} is {j.kind} and mimics {m.joint!r}; a revolute one would work"
        )
    source = by_name[m.joint]
    if source.mimic is not None:
        raise _build_joint_error(
            urdf,
            j,
            f"joint {j.name!r} mimics {m.joint!r}, which mimics {source.mimic.joint!r} itself; "
            f"to mimic {source.mimic.joint!r} with the product of both multipliers would work",
        )
    if not source.moves:
        raise _build_joint_error(
            urdf, j, f"joint {j.name!r} mimics {m.joint!r}, which is fixed; a fixed joint would do the same"
        )
    if j in listed:
        raise _build_joint_error(
            urdf,
            j,
            f"joint {j.name!r} mimics {m.joint!r}, so it is no joint of its own; "
            "arm_joints and external_joints without it would work",
        )
    if source in external:
        raise _build_joint_error(
            urdf, j, f"joint {j.name!r} mimics the external joint {m.joint!r}; only joints of the arm are followed"
        )
    return source


def find_mimic_joints(
    urdf: UrdfModel,
    arm: tuple[UrdfJoint, ...],
    external: tuple[UrdfJoint, ...],
    side: tuple[OffChainMimicJoint, ...] = (),
) -> tuple[MimicJoint, ...]:
    """Find every mimic joint; those that do not follow the arm, and those of ``side``, stay fixed.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        arm: Arm joints in chain order.
        external: External joints.
        side: Mimic joints outside of the chain.

    Returns:
        The mimic joints.

    Raises:
        InputError: one that follows the arm is not supported; names it and what would work.
    """
    beside = {s.joint.name for s in side}
    out = []
    for j in urdf.joints:
        if j.mimic is None:
            continue
        m = j.mimic
        if j.name in beside:
            out.append(MimicJoint(j.name, j.name, 0.0, m.offset))  # its own source: nothing drives it
            continue
        source = _check_mimic_joint(urdf, j, m, (*arm, *external), external)
        if source in arm:
            _check_plannable(urdf, j, source, arm)
        out.append(MimicJoint(j.name, m.joint, m.multiplier, m.offset))
    return tuple(out)


def narrow_limits(
    limits: JointLimits,
    urdf: UrdfModel,
    moving: tuple[UrdfJoint, ...],
    mimics: tuple[MimicJoint, ...],
    side: tuple[OffChainMimicJoint, ...] = (),
) -> tuple[JointLimits, tuple[str, ...]]:
    """Limits of the arm that keep the places and speeds of its followers in theirs, and what was narrowed, in words.

    Args:
        limits: in SI, in the order of ``moving``.

    Raises:
        InputError: nothing is left of a range.
    """
    lower, upper, velocity, warnings = limits.lower.copy(), limits.upper.copy(), limits.velocity.copy(), []
    by_name = {j.name: j for j in urdf.joints}
    given = [s.joint for s in side if s.joint.mimic is not None and s.joint.mimic.multiplier != 0.0]
    direct = [
        MimicJoint(j.name, j.mimic.joint, j.mimic.multiplier, j.mimic.offset) for j in given if j.mimic is not None
    ]
    for m in (*mimics, *direct):
        follower, n = by_name[m.joint], next((k for k, j in enumerate(moving) if j.name == m.source), None)
        if n is None:
            continue
        if 0.0 < follower.velocity < velocity[n] * abs(m.multiplier):  # NaN and zero: the URDF gives none
            velocity[n] = follower.velocity / abs(m.multiplier)
            warnings.append(
                f"the velocity limit of {m.joint!r}, which follows {m.source!r}, lowers that one's to "
                f"{math.degrees(velocity[n]):.4g} deg/s"
            )
        if follower.kind == "continuous" or not follower.lower < follower.upper:
            continue
        ends = sorted((end - m.offset) / m.multiplier for end in (follower.lower, follower.upper))
        if ends[0] <= lower[n] and upper[n] <= ends[1]:
            continue
        lower[n], upper[n] = max(lower[n], ends[0]), min(upper[n], ends[1])
        if not lower[n] < upper[n]:
            raise _build_joint_error(
                urdf,
                follower,
                f"joint {m.joint!r} mimics {m.source!r} and would leave its own range "
                f"[{follower.lower:g}, {follower.upper:g}] at any position of {m.source!r}",
            )
        warnings.append(
            f"the range of {m.joint!r}, which follows {m.source!r}, narrows that one to "
            f"{math.degrees(lower[n]):.4g} to {math.degrees(upper[n]):.4g} deg"
        )
    return replace(limits, lower=lower, upper=upper, velocity=velocity), tuple(warnings)


def _check_plannable(urdf: UrdfModel, j: UrdfJoint, source: UrdfJoint, arm: tuple[UrdfJoint, ...]) -> None:
    """That joint ``j``, which follows the arm, turns, and that nothing rides on it but the arm itself."""
    found = f"joint {j.name!r} mimics {source.name!r}"
    if j.kind not in TURNING or source.kind not in TURNING:
        raise _build_joint_error(
            urdf, j, f"{found} and is {j.kind}; a revolute joint that follows a revolute one would work"
        )
    assert j.mimic is not None
    if j.mimic.multiplier == 0.0 or not float(j.mimic.multiplier).is_integer():
        raise _build_joint_error(
            urdf,
            j,
            f"{found} with the multiplier {j.mimic.multiplier:g}; a whole number other than 0 would work "
            "(a parallel linkage has 1 or -1)",
        )
    riding = [j.child]
    for link in riding:  # grows while it is walked
        riding += [k.child for k in urdf.joints if k.parent == link and k not in arm and k.mimic is None]
    for part in urdf.parts:
        if part.name in riding and (part.collisions or part.mass):
            what = ["a collision body"] if part.collisions else []
            what += [f"a mass of {part.mass:g} kg"] if part.mass else []
            raise CellError(
                f"link {part.name!r} has {' and '.join(what)} on joint {j.name!r}, which mimics {source.name!r} inside "
                "of the chain to the flange; an arm is planned where such a link has neither (as at the elbow of a "
                "parallel linkage), and not where the wrist itself is coupled so",
                file=urdf.path,
                where=f"line {part.line}",
            )


def _build_joint_error(urdf: UrdfModel, j: UrdfJoint, message: str) -> InputError:
    return CellError(message, file=urdf.path, where=f"line {j.line}")

"""Mimic joints of a URDF: which of them follow the arm, and what they do to its limits.

A joint with ``<mimic joint="s" multiplier="m" offset="o"/>`` stands at m·q_s + o. Parallel linkages are written so: an
elbow that keeps its attitude while axis 2 turns is a joint behind it with m = −1. What such a joint may carry is only
what a joint of the arm moves on: a body or a mass of its own would need a place that the model of a serial arm has not.
"""

from __future__ import annotations

import math
from dataclasses import replace

from machopt.domain.cell import JointLimits, Mimic
from machopt.errors import InputError
from machopt.formats.urdf import Urdf, UrdfJoint

TURNING = ("revolute", "continuous")


def followers(urdf: Urdf, arm: tuple[UrdfJoint, ...], external: tuple[UrdfJoint, ...]) -> tuple[Mimic, ...]:
    """Every mimic joint of the URDF, those of other joints than the arm's too (they stand still).

    Raises:
        InputError: one that follows the arm and cannot be planned: names it, and what would work.
    """
    by_name = {j.name: j for j in urdf.joints}
    out = []
    for j in urdf.joints:
        if j.mimic is None:
            continue
        m = j.mimic
        if m.joint not in by_name:
            raise _at(urdf, j, f"joint {j.name!r} mimics {m.joint!r}, which the URDF does not have")
        if j.kind not in (*TURNING, "prismatic"):
            raise _at(urdf, j, f"joint {j.name!r} is {j.kind} and mimics {m.joint!r}; a revolute one would work")
        source = by_name[m.joint]
        if source.mimic is not None:
            raise _at(
                urdf,
                j,
                f"joint {j.name!r} mimics {m.joint!r}, which mimics {source.mimic.joint!r} itself; "
                f"to mimic {source.mimic.joint!r} with the product of both multipliers would work",
            )
        if not source.moves:
            raise _at(urdf, j, f"joint {j.name!r} mimics {m.joint!r}, which is fixed; a fixed joint would do the same")
        if j in arm or j in external:
            raise _at(
                urdf,
                j,
                f"joint {j.name!r} mimics {m.joint!r}, so it is no joint of its own; "
                "arm_joints and external_joints without it would work",
            )
        if source in external:
            raise _at(
                urdf, j, f"joint {j.name!r} mimics the external joint {m.joint!r}; only joints of the arm are followed"
            )
        if source in arm:
            _plannable(urdf, j, source, arm)
        out.append(Mimic(j.name, m.joint, m.multiplier, m.offset))
    return tuple(out)


def narrowed(
    limits: JointLimits, urdf: Urdf, moving: tuple[UrdfJoint, ...], mimics: tuple[Mimic, ...]
) -> tuple[JointLimits, tuple[str, ...]]:
    """Limits of the arm that keep the places and speeds of its followers in theirs, and what was narrowed, in words.

    Args:
        limits: in SI, in the order of ``moving``.

    Raises:
        InputError: nothing is left of a range.
    """
    lower, upper, velocity, said = limits.lower.copy(), limits.upper.copy(), limits.velocity.copy(), []
    by_name = {j.name: j for j in urdf.joints}
    for m in mimics:
        follower, n = by_name[m.joint], next((k for k, j in enumerate(moving) if j.name == m.source), None)
        if n is None:
            continue
        if 0.0 < follower.velocity < velocity[n] * abs(m.multiplier):  # NaN and zero: the URDF gives none
            velocity[n] = follower.velocity / abs(m.multiplier)
            said.append(
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
            raise _at(
                urdf,
                follower,
                f"joint {m.joint!r} mimics {m.source!r} and would leave its own range "
                f"[{follower.lower:g}, {follower.upper:g}] wherever {m.source!r} stands",
            )
        said.append(
            f"the range of {m.joint!r}, which follows {m.source!r}, narrows that one to "
            f"{math.degrees(lower[n]):.4g} to {math.degrees(upper[n]):.4g} deg"
        )
    return replace(limits, lower=lower, upper=upper, velocity=velocity), tuple(said)


def _plannable(urdf: Urdf, j: UrdfJoint, source: UrdfJoint, arm: tuple[UrdfJoint, ...]) -> None:
    """That joint ``j``, which follows the arm, turns, and that nothing rides on it but the arm itself."""
    found = f"joint {j.name!r} mimics {source.name!r}"
    if j.kind not in TURNING or source.kind not in TURNING:
        raise _at(urdf, j, f"{found} and is {j.kind}; a revolute joint that follows a revolute one would work")
    assert j.mimic is not None
    if j.mimic.multiplier == 0.0 or not float(j.mimic.multiplier).is_integer():
        raise _at(
            urdf,
            j,
            f"{found} with the multiplier {j.mimic.multiplier:g}; a whole number other than 0 would work "
            "(a parallel linkage has 1 or -1)",
        )
    riding = [j.child]
    for link in riding:  # grows while it is walked
        riding += [k.child for k in urdf.joints if k.parent == link and k not in arm]
    for part in urdf.parts:
        if part.name in riding and (part.collisions or part.mass):
            bodies = "a collision body" if part.collisions == 1 else f"{part.collisions} collision bodies"
            what = [bodies] if part.collisions else []
            what += [f"a mass of {part.mass:g} kg"] if part.mass else []
            raise InputError(
                f"link {part.name!r} rides on joint {j.name!r}, which mimics {source.name!r}, and has "
                f"{' and '.join(what)}: the rods of a linkage are not followed; without its <collision> and <inertial> "
                "it would be planned (give the mass, and a body that holds both, to the link of the arm beside it)",
                file=urdf.path,
                where=f"line {part.line}",
            )


def _at(urdf: Urdf, j: UrdfJoint, message: str) -> InputError:
    return InputError(message, file=urdf.path, where=f"line {j.line}")

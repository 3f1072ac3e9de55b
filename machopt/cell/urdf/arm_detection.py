"""Detection of the arm's links and joints in a URDF, where the user does not give them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.urdf.urdf_model import UrdfJoint, UrdfModel
from machopt.errors import InputError, OptionError, RobotModelError, suggest_nearest_word

FLANGES = ("tool0", "flange", "tool_flange", "ee_link")
"""Names of the link that carries the tool, the one that tool data refer to first (ROS-Industrial: z out of tool0)."""
GRIPS = ("grip", "finger", "hand", "jaw", "claw", "knuckle")
"""In the name of a joint that is none of the arm's, though it turns behind it."""
_TURNS = ("revolute", "continuous")


@dataclass(frozen=True)
class ArmChoice:
    """An option that leaves six joints to the arm."""

    option: str  # --base-link or --flange-link
    link: str
    effect: str  # what the option then does


class TooManyJointsError(RobotModelError):
    """More than six joints turn one behind the other.

    Attributes:
        joints: names of the joints, from the root outwards.
        flange: link that the last one carries.
        choices: options that leave six joints; ``machopt init`` keeps those that it has tried.
    """

    def __init__(self, path: Path, joints: tuple[str, ...], flange: str, choices: tuple[ArmChoice, ...]) -> None:
        self.joints, self.flange, self.choices = joints, flange, choices
        super().__init__(self.describe([f"{c.option} {c.link} {c.effect}" for c in choices]), file=path)

    def describe(self, advice: list[str]) -> str:
        """Return the message with the given advice.

        Args:
            advice: What would work, one sentence each.
        """
        message = (
            f"{len(self.joints)} joints turn or slide one behind the other up to {self.flange!r} "
            f"({', '.join(self.joints)}); machopt plans for arms of six and up to three external axes"
        )
        return f"{message}. {'; '.join(advice)}" if advice else message


@dataclass(frozen=True, kw_only=True)
class ArmLinks:
    """The six joints from ``base_link`` to ``flange_link``, and what else the URDF offers."""

    base_link: str
    flange_link: str
    arm: tuple[UrdfJoint, ...]  # six, or more where only readings are diagnosed, in chain order
    external: tuple[UrdfJoint, ...]  # between the root and the base, as a rail's
    flanges: tuple[str, ...]  # further links fixed to the last joint's
    gripper: tuple[UrdfJoint, ...] = ()  # joints behind the flange that were taken for a gripper's


def find_arm(
    urdf: UrdfModel, base_link: str | None = None, flange_link: str | None = None, *, any_number: bool = False
) -> ArmLinks:
    """Find the arm of a URDF.

    Without ``flange_link``, the flange is the first of :data:`FLANGES` behind six revolute joints, else the outermost
    link fixed to the sixth. Joints behind the sixth whose names are those of a gripper do not count; the link that
    carries them is then the flange. Without ``base_link``, the base is the link named
    ``base_link`` where nothing moves between it and the arm, else the parent link of the first joint.

    Args:
        urdf: The robot: links, joints, bodies and masses.
        base_link: Base link given by the user, None to detect it.
        flange_link: Flange link given by the user, None to detect it.
        any_number: Whether the arm may have more than six joints that turn.

    Returns:
        Base, flange and joints.

    Raises:
        InputError: no such link, no chain of six revolute joints, or more than one.
    """
    _check_links_exist(urdf, base_link, flange_link)
    flange = _find_flange(urdf) if flange_link is None else flange_link
    moving = _list_moving_joints(urdf, flange)
    gripper: tuple[UrdfJoint, ...] = ()
    if flange_link is None and all(j.kind in _TURNS for j in moving[:6]):
        behind = moving[6:]
        if behind and all(any(word in j.name.lower() for word in GRIPS) for j in behind):
            gripper, moving = behind, moving[:6]
            flange = next((f for f in FLANGES if f in _list_fixed_links(urdf, moving[-1].child)), behind[0].parent)
    external = _find_external_joints(urdf, flange, moving, base_link, any_number=any_number)
    arm = moving[len(external) :]
    if (len(arm) < 6 if any_number else len(arm) != 6) or any(j.kind not in _TURNS for j in arm):
        raise _build_chain_error(urdf, flange, moving, base_link)
    fixed = tuple(f for f in _list_fixed_links(urdf, arm[-1].child) if f != flange)
    return ArmLinks(
        base_link=base_link or _find_base(urdf, arm[0]),
        flange_link=flange,
        arm=arm,
        external=external,
        flanges=fixed,
        gripper=gripper,
    )


def _check_links_exist(urdf: UrdfModel, base_link: str | None, flange_link: str | None) -> None:
    """Raise RobotModelError where a link that the user named is not in the URDF."""
    for option, link in (("--base-link", base_link), ("--flange-link", flange_link)):
        if link is not None and link not in urdf.links:
            raise RobotModelError(
                f"link {link!r} is not there; {suggest_nearest_word(link, list(urdf.links))}",
                file=urdf.path,
                where=option,
            )


def _find_external_joints(
    urdf: UrdfModel, flange: str, moving: tuple[UrdfJoint, ...], base_link: str | None, *, any_number: bool
) -> tuple[UrdfJoint, ...]:
    """Return the moving joints in front of the arm: those above the base link, else all but the last six."""
    if base_link is not None:
        above = urdf.chain(base_link)
        return tuple(j for j in moving if j in above)
    external = moving[:-6]
    if not any(j.kind in _TURNS for j in external):
        return external
    if not any_number:
        raise _build_too_many_joints_error(urdf, flange, moving)
    return tuple(itertools.takewhile(lambda j: j.kind not in _TURNS, moving))


def _build_chain_error(
    urdf: UrdfModel, flange: str, moving: tuple[UrdfJoint, ...], base_link: str | None
) -> OptionError:
    """Return the error of a chain to the flange that is none of six joints that turn."""
    joints = ", ".join(f"{j.name} ({j.kind})" for j in moving) or "no moving joint"
    others = [link for link in urdf.links if _is_arm_end(urdf, link, base_link)]
    advice = f", as to {', '.join(others)}" if others else "; the URDF has no link with such a chain"
    return OptionError(
        f"the chain to {flange!r} has {joints}; six joints that turn would work{advice}",
        file=urdf.path,
        where="--flange-link",
    )


def _build_too_many_joints_error(urdf: UrdfModel, flange: str, moving: tuple[UrdfJoint, ...]) -> InputError:
    """More than six joints that turn: a seven-axis arm, a turntable below one, a hand behind one."""
    before = moving[:-6]
    choices: list[ArmChoice] = []
    if len(before) <= 3:
        kind = "an external axis" if len(before) == 1 else "external axes"
        effect = f"plans with {', '.join(j.name for j in before)} as {kind}"
        choices.append(ArmChoice("--base-link", before[-1].child, effect))
    if all(j.kind in _TURNS for j in moving[:6]):
        effect = f"ends the arm at {moving[5].name}, where what follows is a gripper's"
        choices.append(ArmChoice("--flange-link", moving[5].child, effect))
    return TooManyJointsError(urdf.path, tuple(j.name for j in moving), flange, tuple(choices))


def _is_arm_end(urdf: UrdfModel, link: str, base_link: str | None) -> bool:
    """Whether six joints that turn, and nothing else that moves, lead to a link from the base (else the root)."""
    above = urdf.chain(base_link) if base_link is not None else ()
    moving = [j for j in _list_moving_joints(urdf, link) if j not in above]
    return len(moving) == 6 and all(j.kind in _TURNS for j in moving)


def _list_moving_joints(urdf: UrdfModel, link: str) -> tuple[UrdfJoint, ...]:
    return tuple(j for j in urdf.chain(link) if j.moves and j.mimic is None)


def _find_flange(urdf: UrdfModel) -> str:
    ends: dict[str, list[str]] = {}  # last moving joint → the links fixed behind it
    for link in urdf.links:
        moving = _list_moving_joints(urdf, link)
        if len(moving) >= 6 and all(j.kind in _TURNS for j in moving[-6:]):
            ends.setdefault(moving[-1].name, []).append(link)
    outer = {name: links for name, links in ends.items() if not _has_outer_end(urdf, name, list(ends))}
    if not outer:
        free = [j.name for j in urdf.joints if j.kind in _TURNS and j.mimic is None]
        follow = [f"{j.name} mimics {j.mimic.joint}" for j in urdf.joints if j.mimic is not None]
        turning = "; ".join([", ".join(free) or "none", *follow])
        raise RobotModelError(f"has no chain of six joints that turn (joints that turn: {turning})", file=urdf.path)
    named = [links for links in ends.values() if any(f in links for f in FLANGES)]
    groups = named or list(outer.values())
    if len(groups) > 1:
        raise OptionError(
            f"has more than one arm; name one of {', '.join(links[-1] for links in groups)}",
            file=urdf.path,
            where="--flange-link",
        )
    (links,) = groups
    return next((f for f in FLANGES if f in links), links[-1])


def _has_outer_end(urdf: UrdfModel, joint: str, ends: list[str]) -> bool:
    """A seven-axis arm's sixth joint, or one that carries a gripper's; the chain goes on."""
    child = {j.name: j.child for j in urdf.joints}
    return any(name != joint and any(c.name == joint for c in urdf.chain(child[name])) for name in ends)


def _list_fixed_links(urdf: UrdfModel, link: str) -> list[str]:
    """The link and all that hang on it without a joint that moves, from the inside out."""
    out = [link]
    for at in out:
        out += [j.child for j in urdf.joints if not j.moves and j.parent == at]
    return out


def _find_base(urdf: UrdfModel, first: UrdfJoint) -> str:
    path = urdf.chain(first.child)
    still: list[str] = []
    for joint in reversed(path[:-1]):  # from the first arm joint down to what moves below it
        if joint.moves:
            break
        still += [joint.child, joint.parent]
    still = [*dict.fromkeys(still)] or [first.parent]
    return "base_link" if "base_link" in still else first.parent

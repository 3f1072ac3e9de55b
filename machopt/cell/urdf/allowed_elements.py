"""Known elements and attributes of a URDF, and the treatment of all others.

The parser of the robot model logs and drops what it does not know or cannot read. A link is then lighter, or missing
in the collision check. So unknown content is refused wherever it may stand for something that is read. This applies to
an element whose name is near a URDF name or that contains links, joints or bodies. It applies to an attribute whose
name is near a missing one, and to every unknown attribute of an element that places, scales or couples
(:data:`EXACT`). No URDF parser uses the rest: elements on :data:`ELSEWHERE` are counted, others are named in a warning.
"""

from __future__ import annotations

import difflib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.urdf.xml_tree import XmlElement
from machopt.errors import InputError, RobotModelError

ELSEWHERE = frozenset(
    {
        "material",
        "transmission",
        "gazebo",
        "ros2_control",
        "ros_control",
        "sensor",
        "plugin",
        "mujoco",
        "group",
        "webots",
        "isaac_sim",
        "rviz",
        "compiler",
        "actuator",
        "kinematic",
    }
)
"""Of a robot: appearance, drives, simulators, sensors."""


EXACT = frozenset(
    {"origin", "mesh", "box", "sphere", "cylinder", "capsule", "mass", "inertia", "parent", "child", "mimic"}
)
"""Elements of which an attribute more may be a place, a size or a factor that would be dropped."""


@dataclass(frozen=True)
class ElementRule:
    """What an element may hold: ``one`` at most once, ``ignored`` elements are unused and not opened."""

    attributes: tuple[str, ...] = ()
    one: tuple[str, ...] = ()
    many: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()


_SHAPE = ("mesh", "box", "cylinder", "sphere", "capsule")
RULES = {
    "robot": ElementRule(("name", "version"), many=("link", "joint")),
    "link": ElementRule(
        ("name", "type"),
        ("inertial",),
        ("visual", "collision"),
        ("sensor", "gazebo", "self_collision_checking", "contact"),
    ),
    "inertial": ElementRule((), ("origin", "mass", "inertia")),
    "visual": ElementRule(("name",), ("origin", "geometry"), ignored=("material", "gazebo")),
    "collision": ElementRule(
        ("name", "group"), ("origin", "geometry"), ignored=("material", "contact_coefficients", "verbose", "surface")
    ),
    "geometry": ElementRule((), _SHAPE),
    "origin": ElementRule(("xyz", "rpy")),
    "mass": ElementRule(("value",)),
    "inertia": ElementRule(("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "mesh": ElementRule(("filename", "scale")),
    "box": ElementRule(("size",)),
    "sphere": ElementRule(("radius",)),
    "cylinder": ElementRule(("radius", "length")),
    "capsule": ElementRule(("radius", "length")),
    "joint": ElementRule(
        ("name", "type"),
        ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
        ignored=("sensor", "gazebo", "transmission", "actuator"),
    ),
    "parent": ElementRule(("link",)),
    "child": ElementRule(("link",)),
    "axis": ElementRule(("xyz",)),
    "limit": ElementRule(("lower", "upper", "velocity", "effort", "acceleration", "deceleration", "jerk")),
    "mimic": ElementRule(("joint", "multiplier", "offset")),
    "dynamics": ElementRule(("damping", "friction", "armature")),
    "calibration": ElementRule(("rising", "falling", "reference_position")),
    "safety_controller": ElementRule(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")),
}
_NEAR = 0.6  # share of letters in common from which a word is offered for another
_NEARER = 0.7  # and from which it is taken for a misspelling of it: "lnik" has 0.75, "acceleration" less of anything
_BODIES = {"link", "joint", "inertial", "visual", "collision", "geometry"}


@dataclass(frozen=True)
class UnusedContent:
    """Content of a URDF besides links and joints."""

    counts: dict[str, int]  # element → how often; nothing in them is used
    warnings: tuple[str, ...]  # of unknown elements


def check_vocabulary(path: Path, robot: XmlElement) -> UnusedContent:
    """Refuse every unknown word that may describe a body, a mass or a joint.

    Args:
        path: Path of the file.
        robot: Root element.

    Returns:
        Elements that are known and not used.

    Raises:
        InputError: names file, line and element, what was found and what would work.
    """
    counts: Counter[str] = Counter()
    warnings: list[str] = []
    for child in robot.children:
        if child.tag in RULES["robot"].many:
            _check_element(path, child, child.tag, counts, warnings)
        elif child.tag in ELSEWHERE or (":" in child.tag and not _is_like_urdf_word(_strip_prefix(child.tag))):
            counts[child.tag] += 1
        elif _is_like_urdf_word(child.tag) or any(d.tag in _BODIES for d in child.descendants()):
            raise _build_unknown_word_error(path, child, "robot")
        else:
            counts[child.tag] += 1
            warnings.append(f"{path.name}: line {child.line}: <{child.tag}> is no element of a URDF; it was not read")
    _check_attributes(path, robot, "robot", warnings)
    if robot.text:
        warnings.append(
            f"{path.name}: line {robot.line}: the text {robot.text[:40]!r} between the elements was not read"
        )
    return UnusedContent(dict(+counts), tuple(warnings))


def _check_element(path: Path, element: XmlElement, context: str, counts: Counter[str], warnings: list[str]) -> None:
    """An element of a link or joint, and all in it."""
    rule = RULES[element.tag]
    _check_attributes(path, element, context, warnings)
    if element.text:
        raise RobotModelError(
            f"the text {element.text[:40]!r} inside {context} is not read by any URDF parser; "
            "an attribute, or leaving it out, would work",
            file=path,
            where=f"line {element.line}",
        )
    for k, child in enumerate(element.children):
        inside = child.tag if context == child.tag else f"{context} > {child.tag}"
        if child.tag in rule.one:
            if any(c.tag == child.tag for c in element.children[:k]):
                raise RobotModelError(
                    f"{inside} is given twice, and only the first would be read; keep one",
                    file=path,
                    where=f"line {child.line}",
                )
            _check_element(path, child, inside, counts, warnings)
        elif child.tag in rule.many:
            _check_element(path, child, inside, counts, warnings)
        elif child.tag in rule.ignored or (":" in child.tag and not _is_like_urdf_word(_strip_prefix(child.tag))):
            counts[child.tag] += child.tag != "material"
        elif _is_unused(element, child, (*rule.one, *rule.many)):
            counts[child.tag] += 1
            warnings.append(
                f"{path.name}: line {child.line}: <{child.tag}> inside {context} is used by no URDF parser and was not "
                "read"
            )
        else:
            raise _build_unknown_word_error(path, child, context, (*rule.one, *rule.many))


def _is_unused(parent: XmlElement, child: XmlElement, valid: tuple[str, ...]) -> bool:
    """Whether an element inside of a link or joint holds nothing that is read anywhere."""
    if parent.tag == "link" and child.tag == "origin":  # a link has no place of its own: its joint places it
        return True
    words = [child.tag, *(d.tag for d in child.descendants())]
    near = difflib.get_close_matches(_strip_prefix(child.tag).lower(), valid, n=1, cutoff=_NEAR)
    return parent.tag in ("link", "joint") and not near and not any(w in RULES or _is_like_urdf_word(w) for w in words)


def _check_attributes(path: Path, element: XmlElement, context: str, warnings: list[str]) -> None:
    known = RULES[element.tag].attributes
    missing = [k for k in known if k not in element.attributes]
    for name in element.attributes:
        if name in known or name == "xmlns" or ":" in name:
            continue
        if element.tag in EXACT or difflib.get_close_matches(_strip_prefix(name).lower(), missing, n=1, cutoff=_NEAR):
            raise RobotModelError(
                f"<{element.tag}> of {context} has an unknown attribute {name!r}"
                f"{_suggest_word(name, known)}; valid: {', '.join(known) or 'none'}",
                file=path,
                where=f"line {element.line}",
            )
        warnings.append(
            f"{path.name}: line {element.line}: {name!r} of <{element.tag}> in {context} is used by no URDF parser and "
            "was not read"
        )


def _build_unknown_word_error(
    path: Path, element: XmlElement, context: str, valid: tuple[str, ...] = ("link", "joint")
) -> InputError:
    return RobotModelError(
        f"<{element.tag}> inside {context} is no element of a URDF and would be dropped"
        f"{_suggest_word(element.tag, valid)}; valid: {', '.join(v for v in valid if v != 'capsule') or 'nothing'}",
        file=path,
        where=f"line {element.line}",
    )


def _suggest_word(word: str, valid: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(_strip_prefix(word).lower(), valid, n=1, cutoff=_NEAR)
    return f"; did you mean {close[0]!r}?" if close else ""


def _is_like_urdf_word(tag: str) -> bool:
    """Whether a name may be meant for a link, a joint or a body."""
    return bool(difflib.get_close_matches(tag.lower(), list(_BODIES), n=1, cutoff=_NEARER))


def _strip_prefix(tag: str) -> str:
    return tag.rpartition(":")[2]

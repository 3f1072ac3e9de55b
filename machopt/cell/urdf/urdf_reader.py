"""Strict URDF reader: a malformed number or unknown element refuses the file with its line."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.urdf.allowed_elements import check_vocabulary
from machopt.cell.urdf.urdf_model import (
    MOVING,
    UrdfJoint,
    UrdfLink,
    UrdfMesh,
    UrdfMimic,
    UrdfModel,
    UrdfSolid,
    check_tree,
)
from machopt.cell.urdf.xml_tree import XmlElement, parse_markup, read_markup
from machopt.errors import InputError, RobotModelError

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+", re.ASCII)
_HEAVIEST = 1e5  # kg of one link; the heaviest robots weigh 10 t altogether
_TURNS = 4 * math.pi  # rad of roll, pitch or yaw; degrees soon exceed it, radians never need it
_FARTHEST = 1e3  # m from one frame to the next; a rail in a hall is a tenth of that
_UNIT = 1e-3  # by which a printed unit vector may miss its length
_LEAST_AXIS = 1e-6  # length of an axis below which it has no direction


def read_urdf(path: Path, text: str | None = None) -> UrdfModel:
    """Parse a URDF.

    Args:
        path: the file.
        text: what it expands to, where it is a xacro file.

    Raises:
        InputError: names file, line and element: not XML, not a ``<robot>``, still xacro, entities; an element or
            attribute that is unknown, missing or is given twice; a number that is none, not finite or out of its range;
            links or joints of one name, a link with two parents, a loop.
    """
    root = read_markup(path, "a URDF") if text is None else parse_markup(text, path, "a URDF")
    if root.tag != "robot":
        raise RobotModelError(
            f"found the root element <{root.tag}>; a URDF starts with <robot>", file=path, where=f"line {root.line}"
        )
    if not root.attributes.get("name"):
        raise RobotModelError('<robot> has no name; <robot name="…"> would work', file=path, where=f"line {root.line}")
    for e in (root, *root.descendants()):
        if e.tag.startswith("xacro:"):
            raise RobotModelError(
                "holds xacro elements that nothing expands; a macro of that name would work",
                file=path,
                where=f"line {e.line}",
            )
    unused = check_vocabulary(path, root)
    reader = _UrdfReader(path, list(unused.warnings))
    _check_unique_names(path, root.find_children("link"), "link")
    _check_unique_names(path, root.find_children("joint"), "joint")
    parts = tuple(reader.link(e) for e in root.find_children("link"))
    joints = tuple(reader.joint(e) for e in root.find_children("joint"))
    check_tree(path, tuple(p.name for p in parts), joints)
    return UrdfModel(
        path=path,
        parts=parts,
        joints=joints,
        meshes=tuple(reader.meshes),
        solids=tuple(reader.solids),
        unused_elements=unused.counts,
        warnings=tuple(reader.warnings),
        empty_dynamics=reader.empty_dynamics,
    )


def _check_unique_names(path: Path, elements: list[XmlElement], what: str) -> None:
    seen: dict[str, int] = {}
    for e in elements:
        name = e.attributes.get("name", "")
        if name in seen:
            raise RobotModelError(
                f"{what} {name!r} is given twice, first in line {seen[name]}; names must differ",
                file=path,
                where=f"line {e.line}",
            )
        seen[name] = e.line


@dataclass
class _UrdfReader:
    path: Path
    warnings: list[str]

    def __post_init__(self) -> None:
        self.meshes: list[UrdfMesh] = []
        self.solids: list[UrdfSolid] = []
        self.empty_dynamics = False  # some <dynamics> for which the model's parser would refuse the file

    def error(self, e: XmlElement, message: str) -> InputError:
        return RobotModelError(message, file=self.path, where=f"line {e.line}")

    def warn(self, e: XmlElement, message: str) -> None:
        self.warnings.append(f"{self.path.name}: line {e.line}: {message}")

    # links ------------------------------------------------------------------------------------------------------

    def link(self, e: XmlElement) -> UrdfLink:
        name = self.word(e, "name", "a link")
        of = f"link {name!r}"
        inertial = e.find_first_child("inertial")
        mass = None if inertial is None else self.inertial(inertial, of)
        for kind in ("visual", "collision"):
            for body in e.find_children(kind):
                self.origin(body, f"{kind} of {of}")
                self.shape(body, name, kind)
        return UrdfLink(name, mass, len(e.find_children("visual")), len(e.find_children("collision")), e.line)

    def inertial(self, e: XmlElement, of: str) -> float:
        self.origin(e, f"inertial of {of}")
        mass, inertia = e.find_first_child("mass"), e.find_first_child("inertia")
        if mass is None:
            raise self.error(e, f'inertial of {of} has no <mass>; <mass value="…"/> in kg would work')
        kg = self.number(mass, "value", f"mass of {of}", "kg")
        if not 0.0 <= kg <= _HEAVIEST:
            raise self.error(mass, f"mass of {of} is {kg:g} kg; expected 0 to {_HEAVIEST:g}")
        if inertia is None:
            raise self.error(e, f"inertial of {of} has no <inertia>; ixx, ixy, ixz, iyy, iyz, izz in kg·m² would work")
        v = {
            k: self.number(inertia, k, f"inertia of {of}", "kg·m²") for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        }
        # Sylvester: the leading minors of a positive semi-definite matrix are not negative
        minors = (v["ixx"], v["iyy"], v["izz"], v["ixx"] * v["iyy"] - v["ixy"] ** 2)
        if min(minors) < 0.0:
            self.warn(inertia, f"inertia of {of} is that of no body (its matrix has a negative eigenvalue)")
        elif kg == 0.0 and max(minors) > 0.0:
            self.warn(inertia, f"{of} has inertia but no mass")
        return kg

    def shape(self, body: XmlElement, link: str, kind: str) -> None:
        of = f"{kind} of link {link!r}"
        geometry = body.find_first_child("geometry")
        if geometry is None:
            raise self.error(body, f"{of} has no <geometry>; a box, cylinder, sphere or mesh in it would work")
        if len(geometry.children) != 1:
            found = ", ".join(c.tag for c in geometry.children) or "nothing"
            raise self.error(geometry, f"geometry of {of} holds {found}; expected one of box, cylinder, sphere, mesh")
        e = geometry.children[0]
        if e.tag == "capsule":
            raise self.error(
                e,
                f"{of} is a <capsule>, which the robot model drops; a cylinder and two spheres, each a "
                f"<{kind}> of its own, would work",
            )
        if e.tag == "mesh":
            uri = self.word(e, "filename", f"mesh of {of}")
            scale = self.scale(e, uri, link)
            if kind == "collision":
                self.meshes.append(UrdfMesh(link, uri, scale, e.line))
            return
        if e.tag == "box":
            sizes = self.vector(e, "size", f"box of {of}")
            longest = max(sizes)
        elif e.tag == "sphere":
            sizes = [self.number(e, "radius", f"sphere of {of}", "m")]
            longest = 2 * sizes[0]
        else:
            sizes = [self.number(e, k, f"cylinder of {of}", "m") for k in ("radius", "length")]
            longest = max(2 * sizes[0], sizes[1])
        if min(sizes) <= 0.0:
            raise self.error(e, f"{e.tag} of {of} has the sizes {_format_plain(sizes)}; expected sizes above 0 in m")
        if kind == "collision":
            self.solids.append(UrdfSolid(link, e.tag, longest, e.line))

    def scale(self, e: XmlElement, uri: str, link: str) -> float:
        if "scale" not in e.attributes:
            return 1.0
        text = e.attributes["scale"]
        values = [float(v) for v in text.split() if _NUMBER.fullmatch(v)]
        if len(values) != 3 or len(text.split()) != 3 or not all(math.isfinite(v) and v > 0 for v in values):
            raise self.error(e, f"mesh {uri!r} of link {link!r} has scale {text!r}; expected three positive numbers")
        if max(values) > min(values) * (1 + 1e-9):
            raise self.error(e, f"mesh {uri!r} of link {link!r} is scaled unevenly ({text}); one scale would work")
        return values[0]

    # joints -----------------------------------------------------------------------------------------------------

    def joint(self, e: XmlElement) -> UrdfJoint:
        name, kind = self.word(e, "name", "a joint"), e.attributes.get("type", "")
        of = f"joint {name!r}"
        if kind not in (*MOVING, "fixed"):
            raise self.error(e, f"{of} has type {kind!r}; valid: {', '.join(MOVING)}, fixed")
        ends = []
        for tag in ("parent", "child"):
            end = e.find_first_child(tag)
            if end is None:
                raise self.error(e, f"{of} has no <{tag}>")
            ends.append(self.word(end, "link", f"<{tag}> of {of}"))
        xyz, rpy = self.origin(e, of)
        if kind != "fixed":
            self.axis(e, of, kind)
        lower, upper, velocity = self.limit(e, of, kind)
        mimic = self.mimic(e, of)
        self.unused_numbers(e, of)
        return UrdfJoint(
            name=name,
            kind=kind,
            parent=ends[0],
            child=ends[1],
            lower=lower,
            upper=upper,
            velocity=velocity,
            mimic=mimic,
            xyz=xyz,
            rpy=rpy,
            line=e.line,
        )

    def mimic(self, joint: XmlElement, of: str) -> UrdfMimic | None:
        e = joint.find_first_child("mimic")
        if e is None:
            return None
        given = [
            self.number(e, key, f"mimic of {of}", "") if key in e.attributes else default
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        ]
        return UrdfMimic(self.word(e, "joint", f"<mimic> of {of}"), *given)

    def axis(self, joint: XmlElement, of: str, kind: str) -> None:
        e = joint.find_first_child("axis")
        if e is None:
            if kind in ("revolute", "continuous", "prismatic"):
                self.warn(joint, f"{of} has no <axis>; it is taken along x, the URDF's default")
            return
        length = math.hypot(*self.vector(e, "xyz", f"axis of {of}"))
        if not length > _LEAST_AXIS:
            raise self.error(e, f'axis of {of} is {e.attributes["xyz"]!r}, which has no direction; "0 0 1" would work')
        if abs(length - 1.0) > _UNIT:
            self.warn(e, f"axis of {of} is {length:g} long; only its direction is taken")

    def limit(self, joint: XmlElement, of: str, kind: str) -> tuple[float, float, float]:
        e = joint.find_first_child("limit")
        if e is None:
            if kind in ("revolute", "prismatic"):
                raise self.error(joint, f"{of} has no <limit>; expected lower, upper, velocity and effort")
            return math.nan, math.nan, math.nan
        self.numbers(e, ("acceleration", "deceleration", "jerk"), f"limit of {of}")
        unit = "m" if kind == "prismatic" else "rad"
        # URDF's default for an omitted bound is 0, so an empty <limit> allows no motion; refused where it matters
        bounds = [self.number(e, k, f"limit of {of}", unit) if k in e.attributes else 0.0 for k in ("lower", "upper")]
        velocity = self.number(e, "velocity", f"limit of {of}", f"{unit}/s")
        self.number(e, "effort", f"limit of {of}", "N" if kind == "prismatic" else "N·m")
        return (math.nan, math.nan, math.nan) if kind == "fixed" else (bounds[0], bounds[1], velocity)

    def unused_numbers(self, joint: XmlElement, of: str) -> None:
        """What the model's parser reads and refuses the whole file for, though nothing here uses it."""
        dynamics, safety = joint.find_first_child("dynamics"), joint.find_first_child("safety_controller")
        calibration = joint.find_first_child("calibration")
        if dynamics is not None:
            self.numbers(dynamics, ("damping", "friction", "armature"), f"dynamics of {of}")
            if not {"damping", "friction"} & set(dynamics.attributes):
                self.warn(dynamics, f"dynamics of {of} has neither damping nor friction; it was not read")
                self.empty_dynamics = True
        if calibration is not None:
            self.numbers(calibration, ("rising", "falling", "reference_position"), f"calibration of {of}")
        if safety is not None:
            self.number(safety, "k_velocity", f"safety_controller of {of}", "any number")
            self.numbers(safety, ("soft_lower_limit", "soft_upper_limit", "k_position"), f"safety_controller of {of}")

    # words and numbers ------------------------------------------------------------------------------------------

    def origin(self, parent: XmlElement, of: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Checks the <origin>; returns its place in m and its angles in rad."""
        e = parent.find_first_child("origin")
        if e is None:
            return (0.0,) * 3, (0.0,) * 3
        xyz = self.vector(e, "xyz", f"origin of {of}") if "xyz" in e.attributes else [0.0] * 3
        rpy = self.vector(e, "rpy", f"origin of {of}") if "rpy" in e.attributes else [0.0] * 3
        if max(map(abs, rpy)) > _TURNS:
            raise self.error(
                e,
                f"rpy of the origin of {of} is {_format_plain(rpy)}; expected radians, and in degrees that "
                f"would be {_format_plain([round(math.radians(v), 7) for v in rpy])}",
            )
        if max(map(abs, xyz)) > _FARTHEST:
            raise self.error(
                e,
                f"xyz of the origin of {of} is {_format_plain(xyz)} m; expected at most {_FARTHEST:g} m"
                + (
                    f"; if it is in mm, {_format_plain([v / 1e3 for v in xyz])} would work"
                    if max(map(abs, xyz)) / 1e3 <= _FARTHEST
                    else ""
                ),
            )
        return tuple(xyz), tuple(rpy)

    def word(self, e: XmlElement, key: str, what: str) -> str:
        if not e.attributes.get(key):
            raise self.error(e, f"{what} has no {key!r}")
        return e.attributes[key]

    def numbers(self, e: XmlElement, keys: tuple[str, ...], what: str) -> None:
        for key in keys:
            if key in e.attributes:
                self.number(e, key, what, "")

    def number(self, e: XmlElement, key: str, what: str, unit: str) -> float:
        text = e.attributes.get(key)
        if text is None:
            raise self.error(e, f"{what} has no {key!r}" + (f"; expected a number in {unit}" if unit else ""))
        if not _NUMBER.fullmatch(text.strip()) or not math.isfinite(float(text)):
            raise self.error(e, f"{what}: {key} is {text!r}; expected a finite number{_format_point(text)}")
        return float(text)

    def vector(self, e: XmlElement, key: str, what: str) -> list[float]:
        text = e.attributes.get(key)
        if text is None:
            raise self.error(e, f"{what} has no {key!r}; expected three numbers")
        words = text.split()
        good = [w for w in words if _NUMBER.fullmatch(w) and math.isfinite(float(w))]
        if len(words) != 3 or len(good) != 3:
            raise self.error(
                e,
                f"{what}: {key} is {text!r}; expected three finite numbers with blanks between "
                f"them{_format_point(text)}",
            )
        return [float(w) for w in words]


def _format_point(text: str) -> str:
    return " (with decimal points)" if _DECIMAL_COMMA.search(text) else ""


def _format_plain(values: list[float]) -> str:
    return " ".join(f"{v:g}" for v in values)

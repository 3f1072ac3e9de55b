"""What a cell needs of a URDF: links, joints in chain order, collision meshes. Standard library only."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import InputError

Fail = Callable[[str], InputError]

_MOVING = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclass(frozen=True)
class UrdfJoint:
    name: str
    kind: str  # revolute, continuous, prismatic, fixed, planar, floating
    parent: str
    child: str
    lower: float  # rad or m; NaN where the URDF gives none
    upper: float
    velocity: float  # rad/s or m/s; NaN where the URDF gives none
    mimics: str | None

    @property
    def moves(self) -> bool:
        return self.kind in _MOVING


@dataclass(frozen=True)
class UrdfMesh:
    """A collision mesh as the URDF names it."""

    link: str
    uri: str
    scale: tuple[float, float, float]


@dataclass(frozen=True)
class FoundMesh:
    path: Path
    package: str | None  # the package:// name it was found through
    folder: Path | None  # and that package's folder


@dataclass(frozen=True)
class Urdf:
    path: Path
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    meshes: tuple[UrdfMesh, ...]  # collision only: pictures may be missing
    has_collision: bool

    def chain(self, link: str) -> tuple[UrdfJoint, ...]:
        """Every joint from the root of the tree to ``link``, in order."""
        above = {j.child: j for j in self.joints}
        out: list[UrdfJoint] = []
        while link in above:
            out.append(above[link])
            link = out[-1].parent
        return tuple(reversed(out))


def read_urdf(path: Path) -> Urdf:
    """Parse a URDF.

    Raises:
        InputError: not XML, not a ``<robot>``, still xacro, a joint without links or with numbers that are
            none, links or joints of one name, a link with two parents, a loop.
    """
    try:
        data = path.read_bytes()
    except OSError as err:
        raise InputError(f"cannot be read: {err.strerror}", file=path) from None
    if b"<!ENTITY" in data:
        raise InputError("declares XML entities; a plain URDF would work", file=path)
    try:
        root = ET.fromstring(data)
    except ET.ParseError as err:
        line, column = err.position
        raise InputError(f"is not XML: {err.msg}", file=path, where=f"line {line}, column {column + 1}") from None
    except (ValueError, LookupError) as err:  # an encoding nobody knows
        raise InputError(f"is not XML: {err}", file=path) from None
    if root.tag != "robot":
        raise InputError(f"found the root element <{root.tag}>; a URDF starts with <robot>", file=path)
    if any("xacro" in e.tag for e in root.iter() if isinstance(e.tag, str)):
        raise InputError("still holds xacro elements; expand it first (xacro file.xacro > robot.urdf)", file=path)
    links = tuple(_attribute(path, e, "name", "link") for e in root.findall("link"))
    joints = tuple(_joint(path, e) for e in root.findall("joint"))  # direct children: ros2_control has its own
    for what, names in (("link", links), ("joint", tuple(j.name for j in joints))):
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError(f"{what} {twice[0]!r} stands twice; names must differ", file=path)
    _check_tree(path, links, joints)
    collisions = [(link.attrib["name"], c) for link in root.findall("link") for c in link.findall("collision")]
    meshes = tuple(_mesh(path, link, m) for link, c in collisions for m in c.findall("geometry/mesh"))
    return Urdf(path, links, joints, meshes, bool(collisions))


def find_mesh(urdf: Urdf, uri: str, packages: dict[str, Path], cell_folder: Path, fail: Fail) -> FoundMesh:
    """File behind a mesh URI.

    ``package://name/rest`` is looked up in ``packages``, else as a folder ``name`` beside the URDF or in the
    cell folder; ``file://`` is absolute; anything else is relative to the URDF.
    """
    if not uri.startswith(("package://", "model://")):
        return FoundMesh(urdf.path.parent / uri.removeprefix("file://"), None, None)
    name, _, rest = uri.split("://", 1)[1].partition("/")
    folders = [packages[name]] if name in packages else [urdf.path.parent / name, cell_folder / name]
    folder = next((f for f in folders if f.is_dir()), None)
    if folder is None:
        raise fail(
            f"{uri}: package {name!r} is not in the cell's packages ({', '.join(packages) or 'none'}) and no "
            f"folder of that name stands beside the URDF; `packages: {{{name}: its_folder}}` would work"
        )
    return FoundMesh(folder / rest, name, folder)


def _joint(path: Path, e: ET.Element) -> UrdfJoint:
    name = _attribute(path, e, "name", "joint")
    kind = e.attrib.get("type", "")
    if kind not in (*_MOVING, "fixed"):
        raise InputError(f"joint {name!r} has type {kind!r}; valid: {', '.join(_MOVING)}, fixed", file=path)
    ends = []
    for tag in ("parent", "child"):
        child = e.find(tag)
        if child is None:
            raise InputError(f"joint {name!r} has no <{tag}>", file=path)
        ends.append(_attribute(path, child, "link", f"<{tag}> of joint {name!r}"))
    limit, mimic = e.find("limit"), e.find("mimic")
    # URDF's default for an omitted bound is 0, so an empty <limit> allows no motion; refused where it matters
    bounds = [math.nan] * 2 if limit is None else [_number(path, limit, a, name, 0.0) for a in ("lower", "upper")]
    speed = math.nan if limit is None else _number(path, limit, "velocity", name, math.nan)
    return UrdfJoint(
        name, kind, ends[0], ends[1], bounds[0], bounds[1], speed,
        None if mimic is None else mimic.attrib.get("joint", "?"),
    )  # fmt: skip


def _mesh(path: Path, link: str, e: ET.Element) -> UrdfMesh:
    uri = _attribute(path, e, "filename", f"collision mesh of link {link!r}")
    text = e.attrib.get("scale", "1 1 1")
    try:
        scale = tuple(float(v) for v in text.split())
    except ValueError:
        scale = ()
    if len(scale) != 3 or not all(math.isfinite(v) and v > 0 for v in scale):
        raise InputError(
            f"mesh {uri!r} of link {link!r} has scale {text!r}; expected three positive numbers", file=path
        )
    return UrdfMesh(link, uri, (scale[0], scale[1], scale[2]))


def _attribute(path: Path, e: ET.Element, key: str, what: str) -> str:
    if not e.attrib.get(key):
        raise InputError(f"{what} has no {key!r}", file=path)
    return e.attrib[key]


def _number(path: Path, e: ET.Element, key: str, joint: str, default: float) -> float:
    text = e.attrib.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"joint {joint!r}: {key} is {text!r}; expected a finite number", file=path)
    return value


def _check_tree(path: Path, links: tuple[str, ...], joints: tuple[UrdfJoint, ...]) -> None:
    above: dict[str, UrdfJoint] = {}
    for j in joints:
        for link in (j.parent, j.child):
            if link not in links:
                raise InputError(f"joint {j.name!r} names the link {link!r}, which the URDF does not have", file=path)
        if j.child in above:
            raise InputError(f"link {j.child!r} hangs on two joints, {above[j.child].name!r} and {j.name!r}", file=path)
        above[j.child] = j
    for j in joints:
        seen, link = {j.child}, j.parent
        while link in above:
            if link in seen:
                raise InputError(f"joint {j.name!r} is part of a closed loop; a tree would work", file=path)
            seen.add(link)
            link = above[link].parent
    roots = [link for link in links if link not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none"
        raise InputError(f"found {len(roots)} root links ({found}); expected one tree of links", file=path)

"""Mistakes about the robot, which cannot be put aside: what is written is replaced by what it seems to mean.

A mended cell is only looked at for further mistakes; nobody plans with it.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from machopt.errors import InputError
from machopt.formats.kinematics import load_kinematics
from machopt.formats.stiffness import load_stiffness
from machopt.formats.urdf import Urdf, UrdfJoint, describe_alone
from machopt.formats.yamlstrict import Document, Loc

_ORDINARY = {"acceleration_deg_s2": 500.0, "jerk_deg_s3": 5000.0}  # of any arm; deg, or mm of a rail
_BODIES: tuple[Loc, ...] = (("tool", "geometry"), ("workpiece", "geometry"), ("obstacles",))
_CUTOFF = 0.5  # of difflib


@dataclass(frozen=True)
class Mend:
    """A key that got another value."""

    place: Loc
    document: Document


def mends(document: Document) -> Iterator[Mend]:
    """Every value of ``robot:`` that can be replaced, each by itself."""
    robot = document.value["robot"] if isinstance(document.value, dict) else {}
    folder = Path(document.file).resolve().parent
    files = sorted(f.name for pattern in ("*.urdf", "*.xacro") for f in folder.glob(pattern))
    yield from _renamed(document, ("robot", "urdf"), files)
    urdf = _read(folder / str(robot["urdf"]))
    if urdf is None:
        return
    for key in ("base_link", "flange_link"):
        yield from _renamed(document, ("robot", key), list(urdf.links))
    yield from _renamed(document, ("workpiece", "link"), ["world", *urdf.links])
    moving = [j.name for j in urdf.joints if j.moves]
    external = robot.get("external_joints") or []
    for i in range(len(external)):
        yield from _renamed(document, ("robot", "external_joints", i), moving)
    chain = _chain(urdf, robot)
    own = _at(robot, ("limits", "position_deg")) or [None] * len(chain)
    if len(own) == len(chain):
        yield _with(document, ("robot", "home_deg"), [_inside(j, r) for j, r in zip(chain, own, strict=True)])
    for key, value in _ORDINARY.items():
        yield _with(document, ("robot", "limits", key), [value] * len(chain))


def alone(document: Document, told: set[str]) -> Iterator[InputError]:
    """What is wrong beside a robot that cannot be read: files that the cell names, and what needs no robot of them.

    Args:
        document: cell.yaml, of the right form.
        told: messages that stand already.
    """
    folder = Path(document.file).resolve().parent
    yield from _counted(document)
    named: list[tuple[Loc, str]] = []
    for key in ("stiffness", "kinematics"):
        if isinstance(name := _at(document.value, (key,)), str):
            named.append(((key,), name))
    for loc in _BODIES:
        for n, body in enumerate(_at(document.value, loc) or []):
            if isinstance(body, dict) and "mesh" in body:
                named.append(((*loc, n, "mesh"), str(body["mesh"])))
    for loc, name in named:
        found = folder / name
        problem: InputError | None = None
        if not found.is_file():
            problem = document.error(loc, f"no such file: {name} (looked for {found})")
        elif loc[0] in ("stiffness", "kinematics"):
            try:
                load_stiffness(found) if loc[0] == "stiffness" else load_kinematics(found)
            except InputError as refused:
                problem = refused
        if problem is not None and str(problem) not in told:
            yield problem


def _counted(document: Document) -> Iterator[InputError]:
    """Lists of one value a joint that have another length than the arm's six and the external joints named."""
    external = _at(document.value, ("robot", "external_joints")) or []
    n = 6 + len(external)
    limits = _at(document.value, ("robot", "limits"))
    keys: list[Loc] = [("robot", "home_deg")]
    keys += [("robot", "limits", str(key)) for key in (limits if isinstance(limits, dict) else ())]
    for loc in keys:
        values = _at(document.value, loc)
        if isinstance(values, list) and len(values) != n:
            yield document.error(
                loc, f"found {len(values)} values, expected {n}: six axes and {len(external)} external"
            )


def _renamed(document: Document, loc: Loc, valid: Sequence[str]) -> Iterator[Mend]:
    """The name that is most like the one given, unless it is that name."""
    word = _at(document.value, loc)
    if not isinstance(word, str) or word in valid:
        return
    close = difflib.get_close_matches(word, valid, n=1, cutoff=_CUTOFF)  # for further errors only: nobody reads it
    yield from (_with(document, loc, name) for name in close)


def _with(document: Document, loc: Loc, found: object) -> Mend:
    value = copy.deepcopy(document.value)
    at: Any = value
    for part in loc[:-1]:
        at = at[part]
    at[loc[-1]] = found
    return Mend(loc, replace(document, value=value))


def _read(path: Path) -> Urdf | None:
    try:
        return describe_alone(path).urdf
    except InputError:
        return None


def _chain(urdf: Urdf, robot: dict[str, Any]) -> list[UrdfJoint]:
    """The moving joints as the cell's arrays have them; what is not there is left out."""
    external = [str(name) for name in robot.get("external_joints") or []]
    base, flange = str(robot["base_link"]), str(robot["flange_link"])
    if base not in urdf.links or flange not in urdf.links:
        return []
    behind = urdf.chain(flange)[len(urdf.chain(base)) :]
    arm = [j for j in behind if j.moves and j.mimic is None and j.name not in external]
    return [*arm, *(j for name in external for j in urdf.joints if j.name == name)]


def _inside(joint: UrdfJoint, own: Sequence[float] | None) -> float:
    """A value in the middle of a joint's range, deg or mm; ``own``: the cell's, within the URDF's."""
    if own is not None:
        return 0.5 * (own[0] + own[1])
    per = 1e3 if joint.kind == "prismatic" else float(np.degrees(1.0))
    return 0.0 if joint.kind == "continuous" else per * float(np.nan_to_num(0.5 * (joint.lower + joint.upper)))


def _at(value: Any, loc: Loc) -> Any:
    for part in loc:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value

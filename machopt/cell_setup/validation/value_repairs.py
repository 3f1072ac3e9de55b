"""Repairs of wrong robot values, which cannot be removed: each is replaced by a plausible value.

A repaired cell is used only to find further errors, never for planning.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from machopt.cell.kinematics_file import load_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness
from machopt.cell.urdf import UrdfJoint, UrdfModel, read_standalone_description
from machopt.errors import InputError
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument

_ORDINARY = {"acceleration_deg_s2": 500.0, "jerk_deg_s3": 5000.0}  # of any arm; deg, or mm of a rail
_BODIES: tuple[KeyPath, ...] = (("tool", "geometry"), ("workpiece", "geometry"), ("obstacles",))
_CUTOFF = 0.5  # of difflib


@dataclass(frozen=True)
class ValueRepair:
    """A key that got another value."""

    place: KeyPath
    document: YamlDocument


def list_value_repairs(document: YamlDocument) -> Iterator[ValueRepair]:
    """List every value of ``robot:`` that can be replaced by a plausible one, each separately.

    Args:
        document: Parsed YAML file, with the line of each key for errors.

    Returns:
        The repairs.
    """
    robot = document.value["robot"] if isinstance(document.value, dict) else {}
    folder = Path(document.file).resolve().parent
    files = sorted(f.name for pattern in ("*.urdf", "*.xacro") for f in folder.glob(pattern))
    yield from _suggest_renamed_value(document, ("robot", "urdf"), files)
    urdf = _read_robot_file(folder / str(robot["urdf"]))
    if urdf is None:
        return
    for key in ("base_link", "flange_link"):
        yield from _suggest_renamed_value(document, ("robot", key), list(urdf.links))
    yield from _suggest_renamed_value(document, ("workpiece", "link"), ["world", *urdf.links])
    moving = [j.name for j in urdf.joints if j.moves]
    external = robot.get("external_joints") or []
    for i in range(len(external)):
        yield from _suggest_renamed_value(document, ("robot", "external_joints", i), moving)
    chain = _list_moving_joints(urdf, robot)
    own = _get_value_at(robot, ("limits", "position_deg")) or [None] * len(chain)
    if len(own) == len(chain):
        yield _replace_value(
            document, ("robot", "home_deg"), [_compute_mid_range_value(j, r) for j, r in zip(chain, own, strict=True)]
        )
    for key, value in _ORDINARY.items():
        yield _replace_value(document, ("robot", "limits", key), [value] * len(chain))


def find_errors_outside_robot(document: YamlDocument, known_messages: set[str]) -> Iterator[InputError]:
    """What is wrong beside a robot that cannot be read: files that the cell names, and what needs no robot of them.

    Args:
        document: cell.yaml, of the right form.
        known_messages: messages that stand already.
    """
    folder = Path(document.file).resolve().parent
    yield from _find_wrong_lengths(document)
    named: list[tuple[KeyPath, str]] = []
    for key in ("stiffness", "kinematics"):
        if isinstance(name := _get_value_at(document.value, (key,)), str):
            named.append(((key,), name))
    for loc in _BODIES:
        for n, body in enumerate(_get_value_at(document.value, loc) or []):
            if isinstance(body, dict) and "mesh" in body:
                named.append(((*loc, n, "mesh"), str(body["mesh"])))
    for loc, name in named:
        found = folder / name
        problem: InputError | None = None
        if not found.is_file():
            problem = document.build_error(loc, f"no such file: {name} (searched for {found})")
        elif loc[0] in ("stiffness", "kinematics"):
            try:
                load_stiffness(found) if loc[0] == "stiffness" else load_kinematics(found)
            except InputError as refused:
                problem = refused
        if problem is not None and str(problem) not in known_messages:
            yield problem


def _find_wrong_lengths(document: YamlDocument) -> Iterator[InputError]:
    """Lists of one value a joint that have another length than the arm's six and the external joints named."""
    external = _get_value_at(document.value, ("robot", "external_joints")) or []
    n = 6 + len(external)
    limits = _get_value_at(document.value, ("robot", "limits"))
    keys: list[KeyPath] = [("robot", "home_deg")]
    keys += [("robot", "limits", str(key)) for key in (limits if isinstance(limits, dict) else ())]
    for loc in keys:
        values = _get_value_at(document.value, loc)
        if isinstance(values, list) and len(values) != n:
            yield document.build_error(
                loc, f"found {len(values)} values, expected {n}: six axes and {len(external)} external"
            )


def _suggest_renamed_value(document: YamlDocument, loc: KeyPath, valid: Sequence[str]) -> Iterator[ValueRepair]:
    """The name that is most like the one given, unless it is that name."""
    word = _get_value_at(document.value, loc)
    if not isinstance(word, str) or word in valid:
        return
    close = difflib.get_close_matches(word, valid, n=1, cutoff=_CUTOFF)  # for further errors only: nobody reads it
    yield from (_replace_value(document, loc, name) for name in close)


def _replace_value(document: YamlDocument, loc: KeyPath, found: object) -> ValueRepair:
    value = copy.deepcopy(document.value)
    at: Any = value
    for part in loc[:-1]:
        at = at[part]
    at[loc[-1]] = found
    return ValueRepair(loc, replace(document, value=value))


def _read_robot_file(path: Path) -> UrdfModel | None:
    try:
        return read_standalone_description(path).urdf
    except InputError:
        return None


def _list_moving_joints(urdf: UrdfModel, robot: dict[str, Any]) -> list[UrdfJoint]:
    """The moving joints as the cell's arrays have them; what is not there is left out."""
    external = [str(name) for name in robot.get("external_joints") or []]
    base, flange = str(robot["base_link"]), str(robot["flange_link"])
    if base not in urdf.links or flange not in urdf.links:
        return []
    behind = urdf.chain(flange)[len(urdf.chain(base)) :]
    arm = [j for j in behind if j.moves and j.mimic is None and j.name not in external]
    return [*arm, *(j for name in external for j in urdf.joints if j.name == name)]


def _compute_mid_range_value(joint: UrdfJoint, own: Sequence[float] | None) -> float:
    """A value in the middle of a joint's range, deg or mm; ``own``: the cell's, within the URDF's."""
    if own is not None:
        return 0.5 * (own[0] + own[1])
    per = 1e3 if joint.kind == "prismatic" else float(np.degrees(1.0))
    return 0.0 if joint.kind == "continuous" else per * float(np.nan_to_num(0.5 * (joint.lower + joint.upper)))


def _get_value_at(value: Any, loc: KeyPath) -> Any:
    for part in loc:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value

"""What the user asked of ``machopt map``, and the words of it turned into SI."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, radians
from pathlib import Path
from typing import Literal, cast

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.errors import InputError, nearest
from machopt.se3 import inverse
from machopt.workspace.fields import FIELDS, Load
from machopt.workspace.postures import Pick
from machopt.workspace.samples import XYZ, Kind

Frame = Literal["base", "world", "workpiece"]

PLANES = ("xy", "xz", "yz")
_MM, _DEG = 1e-3, radians(1.0)


@dataclass(frozen=True, kw_only=True)
class MapRequest:
    """The options of ``machopt map`` as the user wrote them: mm, degrees, N, N·m."""

    cell: Path
    out: Path
    slice: str | None = None  # xy | xz | yz; the default where nothing else is asked for, xz
    at: float | None = None  # mm, where the slice lies on its normal; 0
    volume: bool = False
    joints: str | None = None  # "a2,a3" or one joint
    q: str | None = None  # six degrees, or "a4=45,a5=45"; the others at home
    line: str | None = None  # "x,y,z:x,y,z"
    ranges: tuple[str, ...] = ()  # "x=500:2500", "a2=-140:0"
    steps: tuple[str, ...] = ()  # "25", "z=100"
    frame: str = "base"
    tool_axis: str = "0,0,1"
    gamma: float = 0.0
    rotation_step: float = 20.0
    fixed_rotation: bool = False
    pick: str = "best"  # best | worst | home | a branch's number
    by: str | None = None  # key of a field
    force: str | None = None  # "fx,fy,fz"
    wrench: str | None = None  # "fx,fy,fz,mx,my,mz"
    load_axes: str = "frame"  # frame | tool
    collision: str = "self"  # none | self | cell
    length: float | None = None  # mm
    measured: Path | None = None
    power: float = 2.0
    neighbours: int | None = None
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """The request in SI, checked."""

    kind: Kind
    axes: tuple[str, ...]  # names of the directions of sampling, in the order of the table
    at: float  # m, of a slice
    joints: tuple[int, ...]  # of a joint plane
    q: Array  # (6,) rad
    line: tuple[Array, Array] | None  # (3,) m each
    ranges: dict[str, tuple[float, float]]  # m or rad
    steps: dict[str, float]  # m or rad; "" for all axes that are not named
    frame: Frame
    T_base_frame: Array  # (4, 4)
    tool_axis: Array  # (3,) unit, in the frame
    gamma: Array  # (R,) rad, the given rotation first; one where the rotation is fixed
    pick: Pick
    by: str | None
    load: Load | None
    length: float | None  # m
    collision: Literal["none", "self", "cell"]


def resolve(request: MapRequest, cell: Cell) -> MapOptions:
    """Check a request against its cell.

    Raises:
        InputError: an option is malformed or does not fit the others or the cell.
    """
    kind = _kind(request)
    joints = _joints(request.joints, cell) if request.joints is not None else ()
    line = _line(request.line) if request.line is not None else None
    axes: tuple[str, ...] = {
        "slice": tuple(_plane(request.slice or "xz")),
        "volume": XYZ,
        "line": ("s",),
        "joints": tuple(cell.arm_joints[j] for j in joints),
    }[kind]
    unit = _DEG if kind == "joints" else _MM
    tool_axis = np.array(numbers(request.tool_axis, 3, "--tool-axis", "0,0,1"))
    if np.linalg.norm(tool_axis) < 1e-9:
        raise InputError("the tool axis has no length; 0,0,1 is a tool that points down", where="--tool-axis")
    if request.at is not None and (kind != "slice" or not isfinite(request.at)):
        raise InputError(f"goes with --slice and takes a number in mm, found {request.at:g}", where="--at")
    if request.frame not in ("base", "world", "workpiece"):
        raise InputError(f"found {request.frame!r}, expected base, world or workpiece", where="--frame")
    if request.by is not None and request.by not in {field.key for field in FIELDS}:
        raise InputError(f"found {request.by!r}, expected one of {', '.join(f.key for f in FIELDS)}", where="--by")
    if request.length is not None and not (isfinite(request.length) and request.length > 0):
        raise InputError(f"found {request.length:g} mm, expected a length above 0", where="--length")
    if request.collision not in ("none", "self", "cell"):
        raise InputError(f"found {request.collision!r}, expected none, self or cell", where="--collision")
    if not (isfinite(request.power) and request.power > 0):
        raise InputError(f"found {request.power:g}, expected a power above 0, such as 2", where="--power")
    if request.neighbours is not None and request.neighbours < 1:
        raise InputError(f"found {request.neighbours}, expected one neighbour or more", where="--neighbours")
    q = cell.home.copy()
    if request.q is not None:
        if kind != "joints":
            raise InputError("goes with --joints: elsewhere inverse kinematics finds the joints", where="--q")
        q = _posture(request.q, cell)
    frame = cast(Frame, request.frame)
    return MapOptions(
        kind=kind,
        axes=axes,
        at=(request.at or 0.0) * _MM,
        joints=joints,
        q=q,
        line=line,
        ranges=_ranges(request.ranges, axes, kind, unit),
        steps=_steps(request.steps, axes, kind, unit),
        frame=frame,
        T_base_frame=_frame(frame, cell),
        tool_axis=tool_axis / np.linalg.norm(tool_axis),
        gamma=_rotations(request),
        pick=_pick(request.pick),
        by=request.by,
        load=_load(request),
        length=None if request.length is None else request.length * _MM,
        collision=cast(Literal["none", "self", "cell"], request.collision),
    )


def numbers(text: str, count: int, where: str, example: str) -> tuple[float, ...]:
    """``count`` finite numbers between commas.

    Raises:
        InputError: anything else, with an example.
    """
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(isfinite(v) for v in values):
        raise InputError(f"found {text!r}, expected {count} numbers such as {example}", where=where)
    return values


def _kind(request: MapRequest) -> Kind:
    asked = {
        "--slice": request.slice is not None,
        "--volume": request.volume,
        "--joints": request.joints is not None,
        "--line": request.line is not None,
    }
    given = [name for name, there in asked.items() if there]
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} cannot be mapped at once; one of them would work", where=given[1])
    return cast(Kind, given[0][2:] if given else "slice")


def _plane(text: str) -> str:
    plane = "".join(sorted(text.lower()))
    if plane not in PLANES:
        raise InputError(f"found {text!r}, expected {', '.join(PLANES)}", where="--slice")
    return plane


def _joint(name: str, cell: Cell, where: str) -> int:
    name = name.strip()
    if name in cell.arm_joints:
        return cell.arm_joints.index(name)
    raise InputError(f"no arm joint {name!r}; {nearest(name, list(cell.arm_joints))}", where=where)


def _joints(text: str, cell: Cell) -> tuple[int, ...]:
    joints = tuple(_joint(word, cell, "--joints") for word in text.split(","))
    if len(joints) > 2 or len(set(joints)) < len(joints):
        raise InputError(
            f"found {text!r}, expected one joint or two different ones, such as "
            f"{cell.arm_joints[1]},{cell.arm_joints[2]}",
            where="--joints",
        )
    return joints


def _posture(text: str, cell: Cell) -> Array:
    if "=" not in text:
        return np.radians(numbers(text, 6, "--q", "0,-90,90,45,45,45"))
    q = cell.home.copy()
    for word in text.split(","):
        name, _, value = word.partition("=")
        q[_joint(name, cell, "--q")] = np.radians(numbers(value, 1, "--q", f"{cell.arm_joints[4]}=45")[0])
    return q


def _line(text: str) -> tuple[Array, Array]:
    ends = text.split(":")
    if len(ends) != 2:
        raise InputError(f"found {text!r}, expected start and end such as 800,0,900:1600,0,900", where="--line")
    start, end = (np.array(numbers(word, 3, "--line", "800,0,900")) * _MM for word in ends)
    if np.linalg.norm(end - start) < 1e-6:
        raise InputError("start and end are the same place; a line has a length", where="--line")
    return start, end


def _ranges(words: tuple[str, ...], axes: tuple[str, ...], kind: Kind, unit: float) -> dict[str, tuple[float, float]]:
    out: dict[str, tuple[float, float]] = {}
    example = f"{axes[0]}=-90:0" if kind == "joints" else f"{axes[0]}=500:2500"
    for word in words:
        name, _, rest = word.partition("=")
        if kind == "line":
            raise InputError(
                "a line has its own ends; --range goes with --slice, --volume and --joints", where="--range"
            )
        if name not in axes:
            raise InputError(
                f"found {word!r}, but the map runs over {' and '.join(axes)}; expected such as {example}",
                where="--range",
            )
        low, high = numbers(rest.replace(":", ","), 2, "--range", example)
        if not low < high:
            raise InputError(
                f"{name} from {low:g} to {high:g} is an empty range; the lower end comes first, such as {example}",
                where="--range",
            )
        if name in out:
            raise InputError(f"{name} has two ranges; one would work", where="--range")
        out[name] = low * unit, high * unit
    return out


def _steps(words: tuple[str, ...], axes: tuple[str, ...], kind: Kind, unit: float) -> dict[str, float]:
    out: dict[str, float] = {}
    name_of_unit, example = ("deg", "2") if kind == "joints" else ("mm", "25")
    for word in words:
        name, _, rest = word.rpartition("=")
        if name and name not in axes:
            raise InputError(f"found {word!r}, but the map runs over {' and '.join(axes)}", where="--step")
        (value,) = numbers(rest, 1, "--step", f"{example} or {axes[0]}={example}")
        if value <= 0:
            raise InputError(
                f"a step of {value:g} {name_of_unit}; more than 0 would work, such as {example}", where="--step"
            )
        out[name] = value * unit
    return out


def _rotations(request: MapRequest) -> Array:
    if not isfinite(request.gamma):
        raise InputError(f"found {request.gamma:g}, expected a rotation in deg", where="--gamma")
    if not 1 <= request.rotation_step <= 180:
        raise InputError(f"found {request.rotation_step:g} deg; 1 to 180 deg would work", where="--rotation-step")
    count = 1 if request.fixed_rotation else round(360.0 / request.rotation_step)
    return np.asarray(radians(request.gamma) + np.arange(count) * (2 * np.pi / count), float)


def _pick(word: str) -> Pick:
    if word in ("best", "worst", "home"):
        return cast(Pick, word)
    if word.isascii() and word.isdigit():
        return int(word)
    raise InputError(f"found {word!r}, expected best, worst, home or the number of a branch", where="--pick")


def _load(request: MapRequest) -> Load | None:
    if request.load_axes not in ("frame", "tool"):
        raise InputError(f"found {request.load_axes!r}, expected frame or tool", where="--load-axes")
    axes = cast(Literal["frame", "tool"], request.load_axes)
    if request.force is not None and request.wrench is not None:
        raise InputError("--load-N and --wrench are both given; one would work", where="--wrench")
    if request.force is not None:
        values = (*numbers(request.force, 3, "--load-N", "0,0,-1000"), 0.0, 0.0, 0.0)
    elif request.wrench is not None:
        values = numbers(request.wrench, 6, "--wrench", "0,0,-2000,200,200,0")
    else:
        return None
    if not any(values):
        raise InputError(
            "a load of zero bends nothing; leave it out or give one",
            where="--load-N" if request.force is not None else "--wrench",
        )
    return Load(np.array(values), axes)


def _frame(frame: Frame, cell: Cell) -> Array:
    T_base_world = inverse(cell.T_world_base)
    if frame == "base":
        return np.eye(4)
    if frame == "world":
        return T_base_world
    if cell.workpiece.link != "world":
        raise InputError(
            f"the workpiece stands on {cell.workpiece.link!r}, which an external axis may move; "
            "base or world would work",
            where="--frame",
        )
    return np.asarray(T_base_world @ cell.workpiece.T_link_workpiece)

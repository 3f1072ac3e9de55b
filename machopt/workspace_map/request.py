"""Request of ``machopt map``, and its conversion to SI."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, radians
from pathlib import Path
from typing import Literal, cast

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import InputError, OptionError, suggest_nearest_word
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.workspace_map.postures import BranchPick
from machopt.workspace_map.quantities import QUANTITIES, MapLoad
from machopt.workspace_map.sample_grid import XYZ, MapKind

MapFrame = Literal["base", "world", "workpiece"]

SLICE_PLANES = ("xy", "xz", "yz")
_MM, _DEG = 1e-3, radians(1.0)


@dataclass(frozen=True, kw_only=True)
class MapRequest:
    """The options of ``machopt map`` as the user wrote them: mm, degrees, N, N·m."""

    cell: Path
    out: Path
    slice: str | None = None  # xy | xz | yz; default xz
    at: float | None = None  # mm, position of the slice on its normal; 0
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
    process: Path | None = None  # a process.yaml in place of the cell's own
    toolpath: Path | None = None  # a job whose operations are mapped under their own forces
    overrides: tuple[str, ...] = ()
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """Checked options in SI."""

    kind: MapKind
    axes: tuple[str, ...]  # names of the sampling directions, in the order of the table
    at: float  # m, of a slice
    joints: tuple[int, ...]  # of a joint plane
    q: Array  # (6,) rad
    line: tuple[Array, Array] | None  # (3,) m each
    ranges: dict[str, tuple[float, float]]  # m or rad
    steps: dict[str, float]  # m or rad; "" for all axes that are not named
    frame: MapFrame
    T_base_frame: Array  # (4, 4)
    tool_axis: Array  # (3,) unit, in the frame
    gamma: Array  # (R,) rad, the given rotation first; one where the rotation is fixed
    pick: BranchPick
    by: str | None
    load: MapLoad | None
    length: float | None  # m
    collision: Literal["none", "self", "cell"]


def check_picked_branch(options: MapOptions, branches: int) -> None:
    """Check that the arm has the branch that the option names.

    Args:
        options: Options of the map.
        branches: Number of branches of the arm.

    Raises:
        OptionError: it has not.
    """
    if isinstance(options.pick, int) and options.pick >= branches:
        raise OptionError(f"found branch {options.pick}; the arm has 0 to {branches - 1}", where="--pick")


def resolve_request(request: MapRequest, cell: Cell) -> MapOptions:
    """Check a request against its cell and convert it to SI.

    Args:
        request: options as the user wrote them.
        cell: robot cell.

    Raises:
        InputError: an option is malformed or does not fit the others or the cell.
    """
    kind = _select_kind(request)
    joints = _find_joints(request.joints, cell) if request.joints is not None else ()
    line = _parse_line(request.line) if request.line is not None else None
    axes: tuple[str, ...] = {
        "slice": tuple(_parse_plane(request.slice or "xz")),
        "volume": XYZ,
        "line": ("s",),
        "joints": tuple(cell.arm_joints[j] for j in joints),
    }[kind]
    unit = _DEG if kind == "joints" else _MM
    tool_axis = np.array(parse_numbers(request.tool_axis, 3, "--tool-axis", "0,0,1"))
    if np.linalg.norm(tool_axis) < 1e-9:
        raise OptionError("the tool axis has no length; 0,0,1 is a tool that points down", where="--tool-axis")
    _check_choices(request, kind)
    q = cell.home.copy()
    if request.q is not None:
        if kind != "joints":
            raise OptionError("goes with --joints: elsewhere inverse kinematics finds the joints", where="--q")
        q = _parse_posture(request.q, cell)
    frame = cast(MapFrame, request.frame)
    return MapOptions(
        kind=kind,
        axes=axes,
        at=(request.at or 0.0) * _MM,
        joints=joints,
        q=q,
        line=line,
        ranges=_parse_ranges(request.ranges, axes, kind, unit),
        steps=_parse_steps(request.steps, axes, kind, unit),
        frame=frame,
        T_base_frame=_compute_frame(frame, cell),
        tool_axis=tool_axis / np.linalg.norm(tool_axis),
        gamma=_parse_rotations(request),
        pick=_parse_pick(request.pick),
        by=request.by,
        load=_build_load(request),
        length=None if request.length is None else request.length * _MM,
        collision=cast(Literal["none", "self", "cell"], request.collision),
    )


def _check_choices(request: MapRequest, kind: str) -> None:
    """Check the options that are a choice or a positive number."""
    if request.at is not None and (kind != "slice" or not isfinite(request.at)):
        raise OptionError(f"goes with --slice and takes a number in mm, found {request.at:g}", where="--at")
    if request.frame not in ("base", "world", "workpiece"):
        raise OptionError(f"found {request.frame!r}, expected base, world or workpiece", where="--frame")
    if request.by is not None and request.by not in {field.key for field in QUANTITIES}:
        raise OptionError(f"found {request.by!r}, expected one of {', '.join(f.key for f in QUANTITIES)}", where="--by")
    if request.length is not None and not (isfinite(request.length) and request.length > 0):
        raise OptionError(f"found {request.length:g} mm, expected a length above 0", where="--length")
    if request.collision not in ("none", "self", "cell"):
        raise OptionError(f"found {request.collision!r}, expected none, self or cell", where="--collision")
    if not (isfinite(request.power) and request.power > 0):
        raise OptionError(f"found {request.power:g}, expected a power above 0, such as 2", where="--power")
    if request.neighbours is not None and request.neighbours < 1:
        raise OptionError(f"found {request.neighbours}, expected one neighbour or more", where="--neighbours")


def parse_numbers(text: str, count: int, where: str, example: str) -> tuple[float, ...]:
    """Return finite numbers separated by commas.

    Args:
        text: text of the option.
        count: expected number of values.
        where: name of the option, for the message.
        example: valid example, for the message.

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


def _select_kind(request: MapRequest) -> MapKind:
    requested = {
        "--slice": request.slice is not None,
        "--volume": request.volume,
        "--joints": request.joints is not None,
        "--line": request.line is not None,
    }
    options = [name for name, there in requested.items() if there]
    if len(options) > 1:
        raise InputError(f"{' and '.join(options)} cannot be mapped at once; one of them would work", where=options[1])
    return cast(MapKind, options[0][2:] if options else "slice")


def _parse_plane(text: str) -> str:
    plane = "".join(sorted(text.lower()))
    if plane not in SLICE_PLANES:
        raise OptionError(f"found {text!r}, expected {', '.join(SLICE_PLANES)}", where="--slice")
    return plane


def _find_joint(name: str, cell: Cell, where: str) -> int:
    name = name.strip()
    if name in cell.arm_joints:
        return cell.arm_joints.index(name)
    raise InputError(f"no arm joint {name!r}; {suggest_nearest_word(name, list(cell.arm_joints))}", where=where)


def _find_joints(text: str, cell: Cell) -> tuple[int, ...]:
    joints = tuple(_find_joint(word, cell, "--joints") for word in text.split(","))
    if len(joints) > 2 or len(set(joints)) < len(joints):
        raise OptionError(
            f"found {text!r}, expected one joint or two different ones, such as "
            f"{cell.arm_joints[1]},{cell.arm_joints[2]}",
            where="--joints",
        )
    return joints


def _parse_posture(text: str, cell: Cell) -> Array:
    if "=" not in text:
        return np.radians(parse_numbers(text, 6, "--q", "0,-90,90,45,45,45"))
    q = cell.home.copy()
    for word in text.split(","):
        name, _, value = word.partition("=")
        q[_find_joint(name, cell, "--q")] = np.radians(parse_numbers(value, 1, "--q", f"{cell.arm_joints[4]}=45")[0])
    return q


def _parse_line(text: str) -> tuple[Array, Array]:
    ends = text.split(":")
    if len(ends) != 2:
        raise OptionError(f"found {text!r}, expected start and end such as 800,0,900:1600,0,900", where="--line")
    start, end = (np.array(parse_numbers(word, 3, "--line", "800,0,900")) * _MM for word in ends)
    if np.linalg.norm(end - start) < 1e-6:
        raise OptionError("start and end are the same place; a line has a length", where="--line")
    return start, end


def _parse_ranges(
    words: tuple[str, ...], axes: tuple[str, ...], kind: MapKind, unit: float
) -> dict[str, tuple[float, float]]:
    out: dict[str, tuple[float, float]] = {}
    example = f"{axes[0]}=-90:0" if kind == "joints" else f"{axes[0]}=500:2500"
    for word in words:
        name, _, rest = word.partition("=")
        if kind == "line":
            raise OptionError(
                "a line has its own ends; --range goes with --slice, --volume and --joints", where="--range"
            )
        if name not in axes:
            raise OptionError(
                f"found {word!r}, but the map runs over {' and '.join(axes)}; expected such as {example}",
                where="--range",
            )
        low, high = parse_numbers(rest.replace(":", ","), 2, "--range", example)
        if not low < high:
            raise OptionError(
                f"{name} from {low:g} to {high:g} is an empty range; the lower end comes first, such as {example}",
                where="--range",
            )
        if name in out:
            raise OptionError(f"{name} has two ranges; one would work", where="--range")
        out[name] = low * unit, high * unit
    return out


def _parse_steps(words: tuple[str, ...], axes: tuple[str, ...], kind: MapKind, unit: float) -> dict[str, float]:
    out: dict[str, float] = {}
    name_of_unit, example = ("deg", "2") if kind == "joints" else ("mm", "25")
    for word in words:
        name, _, rest = word.rpartition("=")
        if name and name not in axes:
            raise OptionError(f"found {word!r}, but the map runs over {' and '.join(axes)}", where="--step")
        (value,) = parse_numbers(rest, 1, "--step", f"{example} or {axes[0]}={example}")
        if value <= 0:
            raise OptionError(
                f"a step of {value:g} {name_of_unit}; more than 0 would work, such as {example}", where="--step"
            )
        if out.setdefault(name, value * unit) != value * unit:
            raise OptionError(f"{name or 'the step'} is given twice; expected one value", where="--step")
    return out


def _parse_rotations(request: MapRequest) -> Array:
    if not isfinite(request.gamma):
        raise OptionError(f"found {request.gamma:g}, expected a rotation in deg", where="--gamma")
    if not 1 <= request.rotation_step <= 180:
        raise OptionError(f"found {request.rotation_step:g} deg; 1 to 180 deg would work", where="--rotation-step")
    count = 1 if request.fixed_rotation else round(360.0 / request.rotation_step)
    return np.asarray(radians(request.gamma) + np.arange(count) * (2 * np.pi / count), float)


def _parse_pick(word: str) -> BranchPick:
    if word in ("best", "worst", "home"):
        return cast(BranchPick, word)
    if word.isascii() and word.isdigit():
        return int(word)
    raise OptionError(f"found {word!r}, expected best, worst, home or the number of a branch", where="--pick")


def _build_load(request: MapRequest) -> MapLoad | None:
    if request.load_axes not in ("frame", "tool"):
        raise OptionError(f"found {request.load_axes!r}, expected frame or tool", where="--load-axes")
    axes = cast(Literal["frame", "tool"], request.load_axes)
    if request.force is not None and request.wrench is not None:
        raise OptionError("--load-N and --wrench are both given; one would work", where="--wrench")
    if request.force is not None:
        values = (*parse_numbers(request.force, 3, "--load-N", "0,0,-1000"), 0.0, 0.0, 0.0)
    elif request.wrench is not None:
        values = parse_numbers(request.wrench, 6, "--wrench", "0,0,-2000,200,200,0")
    else:
        return None
    if not any(values):
        raise OptionError(
            "a load of zero bends nothing; leave it out or give one",
            where="--load-N" if request.force is not None else "--wrench",
        )
    return MapLoad(np.array(values), axes)


def _compute_frame(frame: MapFrame, cell: Cell) -> Array:
    T_base_world = invert_transform(cell.T_world_base)
    if frame == "base":
        return np.eye(4)
    if frame == "world":
        return T_base_world
    if cell.workpiece.link != "world":
        raise OptionError(
            f"the workpiece is mounted on {cell.workpiece.link!r}, which an external axis may move; "
            "base or world would work",
            where="--frame",
        )
    return np.asarray(T_base_world @ cell.workpiece.T_link_workpiece)

"""ROS trajectory_msgs/JointTrajectory as YAML or JSON, or compas_fab's JointTrajectory, with what our comments or
events file say beside it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping

from machopt.errors import FileFormatError
from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.called_files import try_read_source
from machopt.programs.reading.json_programs import parse_json_object
from machopt.programs.reading.move_attributes import MoveAttributes
from machopt.programs.reading.parsed_program import ParsedProgram
from machopt.programs.reading.program_builder import ProgramBuilder

JOINTS, MOST = 6, 12
_KEY = re.compile(r"\b([a-z_]+):(?=\s)")


def read_ros(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a JointTrajectory.

    Every point is a joint move; where an ``.events.json`` or comments mark a part of it as cutting, those points are
    linear, as they were planned.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves and events of the program.

    Raises:
        InputError: says what was found and what was expected.
    """
    out = ProgramBuilder(source=source, dialect="ros", arc_tolerance=arc_tolerance, strict=strict)
    is_json = next((t.strip()[:1] for t in source.lines if t.strip() and not t.lstrip().startswith("#")), "") == "{"
    document = parse_json_object(out, source) if is_json else _parse_yaml(out, source)
    compas = "dtype" in document
    if compas:
        document = _unwrap_compas_object(out, document)
    names, points = document.get("joint_names"), document.get("points")
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise out.error("expected joint_names and a list of points, as trajectory_msgs/JointTrajectory has them")
    if not JOINTS <= len(names) <= MOST or not all(isinstance(n, str) for n in names):
        raise out.error(f"moves {len(names)} joints; expected the {JOINTS} of the arm, then external ones")
    comments = _read_events_file(out, source) if is_json else _read_yaml_comments(source)
    previous = -math.inf
    for n, point in enumerate(points, 1):
        for kind, text in comments.get(n, ()):
            out.comment(f"{kind}: {text}")
        positions, time = _parse_point(out, _convert_compas_point(out, point, n) if compas else point, n, len(names))
        if not time > previous:
            raise out.error(f"points[{n - 1}]: time_from_start {time:g} s does not rise")
        previous = time
        arm, external = [math.degrees(v) for v in positions[:JOINTS]], positions[JOINTS:]
        given = MoveAttributes(blend=math.nan, time=time, external=external)
        out.joint(arm, n, given, kind=out.find_streamed_kind)
    for kind, text in comments.get(len(points) + 1, ()):
        out.comment(f"{kind}: {text}")
    return out.build()


def _unwrap_compas_object(out: ProgramBuilder, document: Mapping[str, object]) -> Mapping[str, object]:
    """The data of a COMPAS object."""
    kind, data = document["dtype"], document.get("data")
    if not (isinstance(kind, str) and kind.endswith("/JointTrajectory") and isinstance(data, dict)):
        raise out.error("is a COMPAS object, but no JointTrajectory with its data")
    return data


def _convert_compas_point(out: ProgramBuilder, point: object, n: int) -> object:
    """A point of compas_fab under the names that ROS has for the same."""
    where = f"points[{n - 1}]"
    if not isinstance(point, dict):
        return point
    types, values, time = (point.get(key) for key in ("joint_types", "joint_values", "time_from_start"))
    if types is not None:
        kinds = _parse_numbers(out, types, f"{where}.joint_types")
        wrong = [k for k in kinds[:JOINTS] if k not in (0.0, 1.0)]  # revolute, continuous
        if wrong or (isinstance(values, list) and len(kinds) != len(values)):
            raise out.error(f"{where}.joint_types: expected one for each value, 0 for the arm's joints, which turn")
    duration = {"sec": time.get("secs", 0), "nanosec": time.get("nsecs", 0)} if isinstance(time, dict) else time
    return {**point, "positions": values, "time_from_start": duration}


def _parse_yaml(out: ProgramBuilder, source: SourceFile) -> dict[str, object]:
    from machopt.file_formats.strict_yaml import parse_yaml  # its validation takes long to import

    points = _parse_points_by_line(source)
    if points is not None:
        at = source.lines.index("points:")
        value = parse_yaml("\n".join([*source.lines[:at], "points: []"]), source.path).value
        if isinstance(value, dict):
            return {**value, "points": points}
    value = parse_yaml("\n".join(source.lines), source.path).value
    if not isinstance(value, dict):
        raise out.error("is YAML, but no mapping")
    return value


def _parse_points_by_line(source: SourceFile) -> list[object] | None:
    """The points where each is on a line of its own as ``- {…}`` and nothing follows them, read as JSON.

    A trajectory of minutes has so many numbers that the strict YAML reader takes minutes too. None where the file is
    written otherwise, or has anything that JSON would read differently.
    """
    if source.lines.count("points:") != 1:
        return None
    out: list[object] = []
    for raw in source.lines[source.lines.index("points:") + 1 :]:
        text = raw.strip()
        if not text or text.startswith("#"):
            continue
        if not (raw[:1] == " " and text.startswith("- {") and text.endswith("}")):
            return None
        try:
            out.append(
                json.loads(
                    _KEY.sub(r'"\1":', text[2:]),
                    object_pairs_hook=_refuse_duplicate_keys,
                    parse_constant=_refuse_constant,
                )
            )
        except (ValueError, RecursionError):
            return None
    return out


def _refuse_duplicate_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    out = dict(pairs)
    if len(out) != len(pairs):
        raise ValueError("a key twice")
    return out


def _refuse_constant(word: str) -> float:
    raise ValueError(word)


def _parse_point(out: ProgramBuilder, point: object, n: int, joints: int) -> tuple[list[float], float]:
    where = f"points[{n - 1}]"
    if not isinstance(point, dict):
        raise out.error(f"{where}: expected positions and time_from_start")
    positions = _parse_numbers(out, point.get("positions"), f"{where}.positions")
    if len(positions) != joints:
        raise out.error(f"{where}.positions: found {len(positions)} numbers, expected {joints}")
    for key in ("velocities", "accelerations", "effort"):
        if key in point and len(_parse_numbers(out, point[key], f"{where}.{key}")) not in (0, joints):
            raise out.error(f"{where}.{key}: expected none or {joints} numbers")
    time = point.get("time_from_start")
    if not isinstance(time, dict):
        raise out.error(f"{where}.time_from_start: expected sec and nanosec")
    sec = _parse_numbers(out, [time.get("sec", 0)], f"{where}.time_from_start")[0]
    nano = _parse_numbers(out, [time.get("nanosec", time.get("nsec", 0))], f"{where}.time_from_start")[0]
    return positions, sec + nano * 1e-9


def _parse_numbers(out: ProgramBuilder, value: object, where: str) -> list[float]:
    if not isinstance(value, list):
        raise out.error(f"{where}: expected a list of numbers")
    for v in value:
        if isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) or abs(v) > 1e12:
            raise out.error(f"{where}: expected finite numbers")
    return [float(v) for v in value]


def _read_yaml_comments(source: SourceFile) -> dict[int, list[tuple[str, str]]]:
    """Comments between the points, by the number of the point that follows."""
    out: dict[int, list[tuple[str, str]]] = {}
    n, inside = 1, False
    for raw in source.lines:
        text = raw.strip()
        if text.startswith("points:"):
            inside = True
        elif text.startswith("- "):
            n += inside
        elif inside and text.startswith("#"):
            kind, colon, rest = text[1:].strip().partition(": ")
            if colon and kind in ("operation", "move", "CAM"):
                out.setdefault(n, []).append((kind, rest))
    return out


def _read_events_file(out: ProgramBuilder, source: SourceFile) -> dict[int, list[tuple[str, str]]]:
    """Read the events file next to a JSON message."""
    path = source.path.with_name(source.path.stem + ".events.json")
    other = try_read_source(path) if path.is_file() else None
    if other is None:
        return {}
    out.files.append(path)
    try:
        value = json.loads("\n".join(other.lines))
        events: dict[int, list[tuple[str, str]]] = {}
        for event in value["events"]:
            kind = next(k for k in ("operation", "move", "event") if k in event)
            label = "CAM" if kind == "event" else kind
            before = event["before"]
            if type(before) is not int:  # true and 1e999 are numbers too
                raise TypeError
            events.setdefault(before, []).append((label, str(event[kind])))
    except (ValueError, KeyError, TypeError, StopIteration, RecursionError):
        raise FileFormatError(
            "is no events file; expected events with before and operation, move or event", file=path
        ) from None
    return events

"""Generic program tables: CSV and JSON with URDF joints in degrees and poses in the workpiece."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence

from machopt.file_formats.csv_text_escaping import unescape_formula_text
from machopt.file_formats.source_file import SourceFile
from machopt.programs.reading.json_programs import parse_json_object
from machopt.programs.reading.move_attributes import MoveAttributes, parse_number
from machopt.programs.reading.parsed_program import JOINT, LINEAR, ParsedProgram, ProgramFrame
from machopt.programs.reading.program_builder import ProgramBuilder
from machopt.programs.reading.rotation_conventions import Rows, build_pose_matrix, convert_quaternion

_FRAME = re.compile(r"(tool in the flange|workpiece in the robot):(.*)mm,(.*)", re.IGNORECASE)
_KINDS = {"ptp": JOINT, "lin": LINEAR}
_TEXTS = ("operation", "text")  # free ones, which a spreadsheet must not run
_Q = tuple(f"q{k}_deg" for k in range(1, 7))
_POSE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")

SAME_AXIS = 1e-6  # both are printed to nine decimals


def read_csv_program(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a program table.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames and events of the program.

    Raises:
        InputError: names line and column, what was found and what was expected.
    """
    out = ProgramBuilder(source=source, dialect="csv", arc_tolerance=arc_tolerance, strict=strict)
    header: list[str] | None = None
    for line, text in enumerate(source.lines, 1):
        if text.startswith("#"):
            _read_frame_comment(out, text[1:].strip())
            continue
        if not text.strip():
            continue
        try:
            cells = next(csv.reader([text], strict=True))
        except csv.Error as problem:
            raise out.error(f"is not a CSV row: {problem}", line) from None
        if header is None:
            header = [c.strip() for c in cells]
            missing = [c for c in ("item", *_Q, *_POSE) if c not in header]
            if missing or len(set(header)) != len(header):
                raise out.error(f"columns {', '.join(missing) or 'twice the same'} missing", line)
            continue
        if len(cells) != len(header):
            raise out.error(f"found {len(cells)} fields, expected {len(header)} as in the header", line)
        row = dict(zip(header, cells, strict=True))
        _read_row(out, row | {k: unescape_formula_text(row[k]) for k in _TEXTS if k in row}, line)
    return out.build()


def read_json_program(source: SourceFile, arc_tolerance: float, strict: bool = False) -> ParsedProgram:
    """Read a program as JSON.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        arc_tolerance: Largest distance of a chord from its arc, m.
        strict: Whether the first statement that is not understood is an error.

    Returns:
        Moves, frames and events of the program.

    Raises:
        InputError: says what was found and what was expected.
    """
    out = ProgramBuilder(source=source, dialect="json", arc_tolerance=arc_tolerance, strict=strict)
    document = parse_json_object(out, source)
    moves = document.get("moves")
    if document.get("machopt_program") != 1 or not isinstance(moves, list):
        raise out.error("expected an object with machopt_program: 1 and a list of moves")
    out.name = str(document.get("name", ""))[:80]
    for key, setter in (("workpiece_in_robot", out.set_base), ("tool_in_flange", out.set_tool)):
        pose = document.get(key)
        if pose is not None:
            values = _parse_pose_values(out, pose, key)
            rows = _read_rotation(out, values[3:], 0)
            setter(
                ProgramFrame(
                    "workpiece" if "work" in key else "tool",
                    build_pose_matrix(rows, values[0] * 1e-3, values[1] * 1e-3, values[2] * 1e-3),
                )
            )
    for n, item in enumerate(moves):
        where = f"moves[{n}]"
        if not isinstance(item, dict):
            raise out.error(f"{where} is no object")
        row: dict[str, str] = {
            k: str(item[k]) for k in ("item", "operation", "move", "text") if isinstance(item.get(k), str)
        }
        for key in ("time_s", "feed_mm_min", "blend_mm", "seconds"):
            if key in item:
                row["time_s" if key == "seconds" else key] = _parse_json_number(out, item[key], f"{where}.{key}")
        if row.get("item") in _KINDS:
            row |= dict(zip(_Q, _parse_json_numbers(out, item.get("q_deg"), 6, f"{where}.q_deg"), strict=True))
            row |= {k: repr(v) for k, v in zip(_POSE, _parse_pose_values(out, item.get("pose"), where), strict=True)}
            external = item.get("external", [])
            if external:
                texts = _parse_json_numbers(
                    out, external, len(external) if isinstance(external, list) else -1, f"{where}.external"
                )
                row |= {f"e{k}": t for k, t in enumerate(texts, 1)}
        _read_row(out, row, n + 1)
    return out.build()


def _read_row(out: ProgramBuilder, row: Mapping[str, str], line: int) -> None:
    """One move or event; numbers are texts."""
    item = row.get("item", "").strip()

    def value(name: str, needed: bool = False) -> float:
        text = row.get(name, "").strip()
        if not text and not needed:
            return math.nan
        found = parse_number(text)
        if found is None:
            raise out.error(f"{name} is {text[:20]!r}; expected a number", line)
        return found

    if item == "event":
        out.event(row.get("text", ""))
        return
    if item == "dwell":
        out.event(row.get("text", ""), "dwell", value("time_s"))
        return
    if item not in _KINDS:
        raise out.error(f"item {item[:20]!r}; expected ptp, lin, event or dwell", line)
    out.begin_or_none(row.get("operation", ""))
    kind = _KINDS[item]
    if kind == LINEAR and row.get("move"):
        out.word(row["move"])
    x, y, z, *q = (value(c, True) for c in _POSE)
    rows = _read_rotation(out, q, line)
    for name, turned in zip("ijk", (-rows[2], -rows[5], -rows[8]), strict=True):  # the shank's direction, once more
        if abs(value(name) - turned) > SAME_AXIS:
            raise out.error(f"{name} is {value(name):g}, but the quaternion turns the tool axis to {turned:.6f}", line)
    external = [value(f"e{k}") for k in range(1, 7)]
    while external and math.isnan(external[-1]):
        external.pop()
    blend = value("blend_mm")
    feed = value("feed_mm_min")
    axes = [value(c, True) for c in _Q]
    given = MoveAttributes(
        feed=feed / 6e4 if kind == LINEAR else math.nan,
        blend=0.0 if math.isnan(blend) else blend * 1e-3,
        time=value("time_s"),
        external=external,
    )
    out.joint(axes, line, given, kind=kind, pose=build_pose_matrix(rows, x * 1e-3, y * 1e-3, z * 1e-3))


def _read_rotation(out: ProgramBuilder, q: Sequence[float], line: int) -> Rows:
    w, x, y, z = q
    rows = convert_quaternion(w, x, y, z)
    if rows is None:
        raise out.error("the quaternion is not of unit length", line or None)
    return rows


def _read_frame_comment(out: ProgramBuilder, text: str) -> None:
    found = _FRAME.fullmatch(text)
    if found is None:
        return
    p = [parse_number(v) for v in found.group(2).split()]
    q = [parse_number(v) for v in found.group(3).split()]
    values = [v for v in (*p, *q) if v is not None]
    rows = convert_quaternion(*values[3:]) if len(values) == 7 else None
    if rows is None:
        return
    T = build_pose_matrix(rows, values[0] * 1e-3, values[1] * 1e-3, values[2] * 1e-3)
    if found.group(1).lower().startswith("tool"):
        out.set_tool(ProgramFrame("tool", T))
    else:
        out.set_base(ProgramFrame("workpiece", T))


def _parse_pose_values(out: ProgramBuilder, value: object, where: str) -> list[float]:
    if not isinstance(value, dict):
        raise out.error(f"{where} has no pose with xyz_mm and quaternion_wxyz")
    texts = [
        *_parse_json_numbers(out, value.get("xyz_mm"), 3, f"{where}.xyz_mm"),
        *_parse_json_numbers(out, value.get("quaternion_wxyz"), 4, f"{where}.quaternion_wxyz"),
    ]
    return [float(t) for t in texts]


def _parse_json_numbers(out: ProgramBuilder, value: object, count: int, where: str) -> list[str]:
    if not isinstance(value, list) or len(value) != count:
        raise out.error(f"{where}: expected a list of {count} numbers")
    return [_parse_json_number(out, v, where) for v in value]


def _parse_json_number(out: ProgramBuilder, value: object, where: str) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e15 or not math.isfinite(value):
        raise out.error(f"{where}: expected a number")
    return repr(float(value))

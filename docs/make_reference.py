"""Write reference.md beside this file: every key of every file that machopt reads, from the schemas themselves; and the
JSON schemas of what machopt reads and writes, inside the package.

``python docs/make_reference.py`` writes both; tests hold that they are current and that every key says what it is.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from machopt.cell import cell_schema, kinematics_file
from machopt.cell.process_file import process_schema
from machopt.cell.stiffness import stiffness_file
from machopt.data_types.documents import table_rows
from machopt.data_types.documents.json_schemas import write_schemas
from machopt.data_types.plan_options import PlanOptions
from machopt.input_files import job_list_keys, json_schemas
from machopt.measurement.recording import cutting_recording_reader as cutting_keys
from machopt.measurement.recording import frequency_response_reader
from machopt.measurement.recording import recording_schema as recording_keys
from machopt.options import option_schema, plan_option_reader

PAGE = Path(__file__).with_name("reference.md")
FILES: tuple[tuple[str, str, type[BaseModel]], ...] = (
    (
        "cell.yaml",
        "Of `machopt optimize`, `verify`, `map` and all others: the robot and what is around it. "
        "`identify` and `diagnose` take arms of any number of joints.",
        cell_schema.CellKeys,
    ),
    (
        "Planning options",
        "In `plan:` of cell.yaml, a `--plan` file, `options:` of a batch list, or `--set key=value`; "
        "the later one wins.",
        option_schema.OptionKeys,
    ),
    (
        "stiffness.yaml",
        "Named by `stiffness:` of cell.yaml; `identify` and `diagnose` write it.",
        stiffness_file._StiffnessFileKeys,
    ),
    (
        "kinematics.yaml",
        "Named by `kinematics:` of cell.yaml; `diagnose` writes it. "
        + " ".join(
            f"`{effect}` has {', '.join(f'`{p}`' for p in names)}"
            + "".join(f", optionally `{p}`" for p in kinematics_file.list_optional_parameters(effect))
            + "."
            for effect, names in kinematics_file.list_required_parameters().items()
        )
        + " `range_deg`: the encoder angles, lower and upper, that it was measured over; beyond them it fades out "
        "within 5 degrees and is not applied, without the key it is applied everywhere.",
        kinematics_file._KinematicsFileKeys,
    ),
    (
        "process.yaml",
        "Named by `process:` of cell.yaml, or `--process FILE`: cutting conditions, coefficients and tolerances of the "
        "operations, by the labels that `machopt inspect` lists.",
        process_schema.ProcessKeys,
    ),
    ("recording.yaml", "Beside the data files of a recording folder.", recording_keys.RecordingKeys),
    (
        "recording.yaml of measured cuts",
        "`kind: cutting`, for `machopt process`. Columns: `spindle_rpm, feed_mm_min, ap_mm, fx_N, fy_N, fz_N`, and "
        "where they apply `ae_mm`, `cut`, `travel_x, travel_y, travel_z`, `q1_deg` … `q6_deg`. Force waveforms have "
        "`time_s` (s) or `angle_deg` (rotation of the spindle in its own sense, °) too, and `cut_number` for several "
        "cuts in one file.",
        cutting_keys.CuttingRecordingKeys,
    ),
    (
        "recording.yaml of frequency responses",
        "`kind: frf`, for `machopt identify`. Columns: `frequency_Hz`, `re_m_per_N, im_m_per_N` (receptance, "
        "displacement over force, m/N), `q1_deg` … `q6_deg`, `excitation_x, excitation_y, excitation_z` and "
        "`response_x, response_y, response_z` (directions of force and sensor, any length), and where they apply "
        "`pose` and `coherence` (0 … 1).",
        frequency_response_reader.FrequencyResponseKeys,
    ),
    ("Batch list", "The YAML file of `machopt batch LIST`.", job_list_keys.JobListKeys),
)
TABLES = (
    (
        "points.csv of optimize",
        "One row a toolpath point. Columns in this order; those that are not **bold** are there where they apply.",
        table_rows.PointsTableRow,
    ),
    (
        "trajectory.csv of optimize",
        "One row a control sample. Columns in this order; those that are not **bold** are there where they apply.",
        table_rows.TrajectoryTableRow,
    ),
)
HEAD = """# Every key of every file, every column of the tables

Made from the schemas by `python docs/make_reference.py`. Units are in the keys or said here; frames are in
[conventions.md](conventions.md). A key that is not listed is an error that names the nearest one. Required keys are
**bold**.
"""


def page() -> str:
    """The whole page in Markdown."""
    keyed = (line for title, text, model in FILES for line in _section(title, text, model))
    columns = (line for title, text, model in TABLES for line in _columns(title, text, model))
    return "\n".join([HEAD, *keyed, *columns])


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """(dotted key, field) of a schema and those inside it, parents first."""
    for name, info in model.model_fields.items():
        yield f"{prefix}{name}", info
        inner, mark = _inside(info.annotation)
        if inner is option_schema.OptionKeys and model is not option_schema.OptionKeys:
            continue  # they have a section of their own
        if inner is not None:
            yield from keys(inner, f"{prefix}{name}{mark}.")


def _section(title: str, text: str, model: type[BaseModel]) -> Iterator[str]:
    yield f"## {title}\n{text}\n\n| key | value | default | what |\n|---|---|---|---|"
    defaults = plan_option_reader.format_user_options(PlanOptions()) if model is option_schema.OptionKeys else {}
    for name, info in keys(model):
        shown = f"**`{name}`**" if info.is_required() else f"`{name}`"
        default = _default(info, _reach(defaults, name))
        yield f"| {shown} | {_kind(info)} | {default} | {info.description or ''} |"
    yield ""


def _columns(title: str, text: str, model: type[BaseModel]) -> Iterator[str]:
    yield f"## {title}\n{text}\n\n| column | what |\n|---|---|"
    for name, info in model.model_fields.items():
        yield f"| {f'**`{name}`**' if info.is_required() else f'`{name}`'} | {info.description or ''} |"
    yield ""


def _reach(values: typing.Any, dotted: str) -> object:
    for part in dotted.split("."):
        if not isinstance(values, dict) or part not in values:
            return None
        values = values[part]
    return typing.cast(object, values)


def _default(info: FieldInfo, known: object) -> str:
    value = known if known is not None else info.default
    if value is PydanticUndefined or value is None or isinstance(value, BaseModel) or value in ("", [], {}):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if not isinstance(value, dict) else ", ".join(f"{k}: {v}" for k, v in value.items())


def _inside(annotation: object) -> tuple[type[BaseModel] | None, str]:
    """The schema inside an annotation, and how its place is written: a list's entries as [], a mapping's as .NAME."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, ""
    if origin is list:
        inner, mark = _inside(arguments[0])
        return inner, f"[]{mark}"
    if origin is dict:
        inner, mark = _inside(arguments[1])
        return inner, f".NAME{mark}"
    for part in arguments if origin in (typing.Union, types.UnionType) else ():
        inner, mark = _inside(part)
        if inner is not None:
            return inner, mark
    return None, ""


def _kind(info: FieldInfo) -> str:
    words = _words(info.annotation)
    bounds = {type(m).__name__: m for m in info.metadata}
    signs = (("Ge", "ge", "≥"), ("Gt", "gt", ">"), ("Le", "le", "≤"), ("Lt", "lt", "<"))
    limits = " and ".join(f"{sign} {getattr(bounds[n], a):g}" for n, a, sign in signs if n in bounds)
    least, most = (getattr(bounds.get(n), a, None) for n, a in (("MinLen", "min_length"), ("MaxLen", "max_length")))
    if words.startswith("list") and least is not None and least == most:
        words = f"{least} {words.removeprefix('list of ')}"
    return f"{words} {limits}".strip()


def _words(annotation: object) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    plain = {float: "number", int: "whole number", str: "text", bool: "true, false", typing.Any: "any"}
    if annotation in plain:
        return plain[annotation]
    if origin is typing.Annotated:
        return _words(arguments[0])
    if origin is Literal:
        return ", ".join(f"`{a}`" for a in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_words(a) for a in arguments if a is not type(None))
    if origin is list:
        return "list of " + {"number": "numbers", "whole number": "whole numbers", "text": "texts"}.get(
            _words(arguments[0]), _words(arguments[0])
        )
    return "mapping"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    write_schemas()
    json_schemas.write_schemas()

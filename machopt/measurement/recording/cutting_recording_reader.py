"""Reader of recordings of kind ``cutting``: measured cuts with their conditions, and mean forces or waveforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.measurements.cutting_recording import CUT_SIDES, CuttingRecording
from machopt.data_types.measurements.waveform_recording import WaveformRecording
from machopt.errors import RecordingError
from machopt.file_formats.strict_yaml import StrictSchema, read_yaml, validate_document
from machopt.measurement.recording.recording_reader import find_data_files, find_recording_yaml
from machopt.measurement.recording.recording_table import AllowedColumns, RecordingTable, read_table
from machopt.measurement.recording.waveform_columns import (
    ABSCISSAS,
    CUT_NUMBER,
    build_waveform_recording,
    find_abscissa,
)
from machopt.numerics.array_types import Array

CONDITIONS = ("spindle_rpm", "feed_mm_min", "ap_mm")
FORCES = ("fx_N", "fy_N", "fz_N")
TRAVEL = ("travel_x", "travel_y", "travel_z")
JOINTS = tuple(f"q{n}_deg" for n in range(1, 7))
COLUMNS = AllowedColumns(
    numbers=(*ABSCISSAS, CUT_NUMBER, *CONDITIONS, "ae_mm", *FORCES, *TRAVEL, *JOINTS),
    words=("cut",),
    listed_names=f"{', '.join((*CONDITIONS, 'ae_mm', 'cut', *FORCES, *ABSCISSAS, CUT_NUMBER, *TRAVEL))}, "
    "q1_deg … q6_deg",
    refused_names={
        "fz_mm": "give feed_mm_min and spindle_rpm; the feed per tooth follows from the number of teeth",
        "t_s": "the name is time_s",
        "mz_Nm": "moments are not taken; the three forces determine the coefficients",
    },
    sparse=("ae_mm",),
)


class MeasuredCutterKeys(StrictSchema):
    diameter_mm: float = Field(gt=0, description="diameter, mm")
    length_mm: float = Field(gt=0, description="length of the cutting edges, mm")
    teeth: int = Field(ge=1, description="number of teeth")
    helix_deg: float = Field(gt=-90, lt=90, description="helix angle, + right-hand")
    corner_radius_mm: float = Field(default=0.0, ge=0, description="corner radius, mm; half the diameter: ball")


class CuttingRecordingKeys(StrictSchema):
    machopt_recording: Literal[1] = Field(description="the format, 1")
    kind: Literal["cutting"] = Field(description="measured cuts")
    data: Any = Field(description="a data file, or a list of them")
    wrench_frame: Literal["feed", "base", "tool"] = Field(
        description="axes of the forces: feed (travel, normal, axis from tip to shank), base_link, or tool (TCP)"
    )
    force_on: Literal["tool", "workpiece"] = Field(description="on what the measured force acts")
    spindle: Literal["cw", "ccw"] = Field(default="cw", description="seen from the shank; cw is M3")
    cut: Literal["up", "down", "slot"] | None = Field(default=None, description="side, where no column cut states it")
    cutter: MeasuredCutterKeys | None = Field(default=None, description="the cutter; left out: that of the cell")
    notes: str = Field(default="", description="free text")


def load_cutting_recording(path: Path | str) -> CuttingRecording | WaveformRecording:
    """Read a recording of measured cuts: waveforms where a column time_s or angle_deg exists, else means.

    Args:
        path: the folder, or the ``recording.yaml`` in it.

    Raises:
        InputError: names file, key or line and column, what was found and what was expected.
    """
    file = find_recording_yaml(Path(path))
    document = read_yaml(file)
    kind = document.value.get("kind") if isinstance(document.value, dict) else None
    if kind in ("deflection", "absolute", "motion", "frf"):
        raise document.build_error(
            ("kind",), f"is {kind}; expected cutting, measured cuts. machopt identify and diagnose read the other kinds"
        )
    keys = validate_document(CuttingRecordingKeys, document)
    files = find_data_files(document, keys.data, file.parent)
    tables = [read_table(p, COLUMNS) for p in files]
    for table in tables:
        _check_columns(table, keys)
    first = tables[0]
    for table in tables[1:]:
        if set(table.numbers) != set(first.numbers):
            raise RecordingError("its columns differ from those of the first file", file=table.path)

    def join(name: str) -> Array:
        return np.concatenate([t.numbers[name] for t in tables])

    abscissa = find_abscissa(tables)
    sign = 1.0 if keys.force_on == "tool" else -1.0
    recording = CuttingRecording(
        source=file.parent.resolve().name,
        files=tuple(files),
        file=np.repeat(np.arange(len(tables)), [len(t) for t in tables]).astype(np.int64),
        line=np.concatenate([t.lines for t in tables]),
        spindle_speed=join("spindle_rpm") / 60.0,
        feed=join("feed_mm_min") / 6e4,
        ae=join("ae_mm") / 1e3 if "ae_mm" in first.numbers else np.full(sum(map(len, tables)), np.nan),
        ap=join("ap_mm") / 1e3,
        side=tuple(side for t in tables for side in _read_sides(t, keys)),
        spindle=keys.spindle,
        force=sign * np.column_stack([join(name) for name in FORCES]),
        frame=keys.wrench_frame,
        travel=np.column_stack([join(name) for name in TRAVEL]) if TRAVEL[0] in first.numbers else None,
        q=np.radians(np.column_stack([join(name) for name in JOINTS])) if keys.wrench_frame == "base" else None,
        cutter=None if keys.cutter is None else _build_cutter(keys.cutter),
    )
    return recording if abscissa is None else build_waveform_recording(recording, tables, abscissa)


def _check_columns(table: RecordingTable, keys: CuttingRecordingKeys) -> None:
    needed = [*CONDITIONS, *FORCES]
    why = ""
    if keys.wrench_frame != "feed":
        needed += [*TRAVEL, *(JOINTS if keys.wrench_frame == "base" else ())]
        why = f" (wrench_frame: {keys.wrench_frame} needs the direction of travel in its axes"
        why += ", and the joints for the tool's axis)" if keys.wrench_frame == "base" else ")"
    missing = [name for name in needed if name not in table.numbers]
    if missing:
        raise table.build_error(f"has no column {', '.join(missing)}{why}")
    for name in ("spindle_rpm", "feed_mm_min"):
        wrong = np.flatnonzero(~(table.numbers[name] > 0.0))
        if wrong.size:
            row = int(wrong[0])
            raise table.build_error(f"found {table.numbers[name][row]:g}; expected more than 0", row, name)


def _read_sides(table: RecordingTable, keys: CuttingRecordingKeys) -> list[str]:
    if "cut" not in table.words:
        if keys.cut is None:
            raise table.build_error("has no column cut, and recording.yaml has no key cut: up, down or slot")
        return [keys.cut] * len(table)
    for row, word in enumerate(table.words["cut"]):
        if word not in CUT_SIDES:
            raise table.build_error(f"found {word!r}; expected {', '.join(CUT_SIDES)}", row, "cut")
    return table.words["cut"]


def _build_cutter(keys: MeasuredCutterKeys) -> CutterGeometry:
    return CutterGeometry(
        keys.diameter_mm / 1e3,
        keys.length_mm / 1e3,
        keys.corner_radius_mm / 1e3,
        teeth=keys.teeth,
        helix=np.radians(keys.helix_deg),
    )

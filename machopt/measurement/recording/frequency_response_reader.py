"""Reader of recordings of kind ``frf``: frequency responses of an arm in several poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.errors import InputError, RecordingError
from machopt.file_formats.strict_yaml import StrictSchema, read_yaml, validate_document
from machopt.measurement.recording.recording_reader import find_data_files, find_recording_yaml
from machopt.measurement.recording.recording_table import AllowedColumns, RecordingTable, read_table
from machopt.numerics.array_types import Array, Ints

RECEPTANCE = ("frequency_Hz", "re_m_per_N", "im_m_per_N")
JOINTS = tuple(f"q{n}_deg" for n in range(1, 7))
EXCITATION = ("excitation_x", "excitation_y", "excitation_z")
RESPONSE = ("response_x", "response_y", "response_z")
FEWEST_LINES = 8  # frequencies of a response: four numbers describe one peak, as many are left over
SAME_POSE = np.radians(0.05)  # of two rows of one response: rounding of encoders
_UNIT = "expected receptance in m/N: displacement over force; divide mm/N by 1000, accelerance by −(2π f)²"
COLUMNS = AllowedColumns(
    numbers=(*RECEPTANCE, "coherence", "pose", *JOINTS, *EXCITATION, *RESPONSE),
    words=(),
    listed_names=f"{', '.join((*RECEPTANCE, 'coherence', 'pose', *EXCITATION, *RESPONSE))}, q1_deg … q6_deg",
    refused_names={name: _UNIT for part in ("re", "im") for name in (f"{part}_mm_per_N", f"{part}_um_per_N")}
    | {
        "magnitude": "give re_m_per_N and im_m_per_N; " + _UNIT,
        "phase_deg": "give re_m_per_N and im_m_per_N; " + _UNIT,
        "omega_rad_s": "give frequency_Hz",
    },
)


class ResponseUncertaintyKeys(StrictSchema):
    mass_percent: float | None = Field(
        default=None, ge=0, lt=100, description="1 sigma of mass and inertia of each link of the URDF"
    )


class FrequencyResponseKeys(StrictSchema):
    machopt_recording: Literal[1] = Field(description="the format, 1")
    kind: Literal["frf"] = Field(description="frequency responses of the arm")
    data: Any = Field(description="a data file, or a list of them")
    direction_frame: Literal["base", "tool"] = Field(description="axes of both directions: base_link, or tool (TCP)")
    excitation_point_mm: list[float] | None = Field(
        default=None,
        min_length=3,
        max_length=3,
        description="x, y, z in flange where the force acts; left out: the TCP",
    )
    response_point_mm: list[float] | None = Field(
        default=None, min_length=3, max_length=3, description="x, y, z in flange of the sensor; left out: the TCP"
    )
    standard_uncertainty: ResponseUncertaintyKeys = Field(
        default=ResponseUncertaintyKeys(), description="of what the model takes as known"
    )
    notes: str = Field(default="", description="free text")


def is_frequency_response_recording(path: Path | str) -> bool:
    """Return whether a recording.yaml states kind frf; False where there is none that can be read.

    Args:
        path: the folder, or the ``recording.yaml`` in it.
    """
    try:
        document = read_yaml(find_recording_yaml(Path(path)))
    except InputError:  # whoever reads the recording says what is wrong with it
        return False
    return isinstance(document.value, dict) and document.value.get("kind") == "frf"


def load_frequency_responses(path: Path | str) -> FrequencyResponseRecording:
    """Read a recording of frequency responses.

    Args:
        path: the folder, or the ``recording.yaml`` in it.

    Raises:
        InputError: names file, key or line and column, what was found and what was expected.
    """
    file = find_recording_yaml(Path(path))
    document = read_yaml(file)
    keys = validate_document(FrequencyResponseKeys, document)
    files = find_data_files(document, keys.data, file.parent)
    tables = [read_table(p, COLUMNS) for p in files]
    for table in tables:
        _check_table(table)
        for name in ("coherence", "pose"):
            if (name in table.numbers) != (name in tables[0].numbers):
                raise RecordingError(
                    f"column {name} is in some of the files only; expected in all or in none", file=table.path
                )
    directions = [_join(tables, names) for names in (EXCITATION, RESPONSE)]
    directions = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in directions]
    q = np.radians(_join(tables, JOINTS))
    source = np.repeat(np.arange(len(tables)), [len(t) for t in tables]).astype(np.int64)
    pose = _join(tables, ("pose",))[:, 0] if "pose" in tables[0].numbers else np.zeros(len(source))
    if "pose" not in tables[0].numbers:
        pose = _number_poses(q)
    group = _number_responses(np.column_stack([pose, *directions]))
    recording = FrequencyResponseRecording(
        source=file.parent.resolve().name,
        files=tuple(files),
        file=source,
        line=np.concatenate([t.lines for t in tables]),
        frequency=_join(tables, RECEPTANCE[:1])[:, 0],
        receptance=_join(tables, RECEPTANCE[1:]) @ np.array([1.0, 1.0j]),
        coherence=_join(tables, ("coherence",))[:, 0] if "coherence" in tables[0].numbers else None,
        q=q,
        excitation=directions[0],
        response=directions[1],
        group=group,
        frame=keys.direction_frame,
        excitation_point=None if keys.excitation_point_mm is None else np.array(keys.excitation_point_mm) / 1e3,
        response_point=None if keys.response_point_mm is None else np.array(keys.response_point_mm) / 1e3,
        mass_sigma=None
        if keys.standard_uncertainty.mass_percent is None
        else keys.standard_uncertainty.mass_percent / 100.0,
    )
    _check_responses(recording, pose)
    return recording


def _join(tables: list[RecordingTable], names: tuple[str, ...]) -> Array:
    return np.concatenate([np.column_stack([t.numbers[name] for name in names]) for t in tables])


def _number_poses(q: Array) -> Array:
    """Return (n,) the number of the pose of each row: rows whose joints differ by SAME_POSE at most are one pose."""
    out = np.full(len(q), -1.0)
    count = 0
    while (rest := np.flatnonzero(out < 0.0)).size:
        out[rest[np.abs(q[rest] - q[rest[0]]).max(axis=1) <= SAME_POSE]] = count
        count += 1
    return out


def _number_responses(keys: Array) -> Ints:
    """Return the number of the response of each row, in the order of their first rows."""
    _, first, inverse = np.unique(np.round(keys, 6), axis=0, return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return np.asarray(order[inverse.ravel()], dtype=np.int64)


def _check_table(table: RecordingTable) -> None:
    missing = [name for name in (*RECEPTANCE, *JOINTS, *EXCITATION, *RESPONSE) if name not in table.numbers]
    if missing:
        raise table.build_error(f"has no column {', '.join(missing)}")
    for name, low, high, expected in (
        ("frequency_Hz", 0.0, 1e5, "more than 0 and at most 100000"),
        ("coherence", 0.0, 1.0, "more than 0 and at most 1"),
    ):
        values = table.numbers.get(name)
        if values is not None and (wrong := np.flatnonzero(~((values > low) & (values <= high)))).size:
            row = int(wrong[0])
            raise table.build_error(f"found {values[row]:g}; expected {expected}", row, name)
    for names in (EXCITATION, RESPONSE):
        length = np.linalg.norm(np.column_stack([table.numbers[name] for name in names]), axis=1)
        if (wrong := np.flatnonzero(~(length > 0.0))).size:
            raise table.build_error("found a direction of zero length; expected a vector", int(wrong[0]), names[0])
    size = np.hypot(table.numbers["re_m_per_N"], table.numbers["im_m_per_N"])
    if (wrong := np.flatnonzero(size == 0.0)).size:
        raise table.build_error("found a response of exactly 0; leave such a row out", int(wrong[0]), "re_m_per_N")


def _check_responses(recording: FrequencyResponseRecording, pose: Array) -> None:
    for label in np.unique(pose):
        rows = np.flatnonzero(pose == label)
        moved = np.abs(recording.q[rows] - recording.q[rows[0]]).max(axis=1) > SAME_POSE
        if moved.any():
            row = int(rows[int(np.argmax(moved))])
            raise RecordingError(
                f"pose {label:g} has other joint positions than in line {recording.line[rows[0]]}; expected one label "
                "for each pose",
                file=recording.files[recording.file[row]],
                where=f"line {recording.line[row]}, column pose",
            )
    for number in range(recording.responses):
        rows = np.flatnonzero(recording.group == number)
        row = int(rows[0])
        file, where = recording.files[recording.file[row]], f"line {recording.line[row]}"
        if len(rows) < FEWEST_LINES:
            raise RecordingError(
                f"the response that starts here has {len(rows)} frequencies; expected {FEWEST_LINES} or more of one "
                "pose and one pair of directions",
                file=file,
                where=where,
            )
        values, count = np.unique(recording.frequency[rows], return_counts=True)
        if (count > 1).any():
            raise RecordingError(
                f"the response that starts here has {values[count > 1][0]:g} Hz twice; average repeats, or give them "
                "another pose label",
                file=file,
                where=where,
            )

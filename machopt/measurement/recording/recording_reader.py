"""Reader of recording folders: ``recording.yaml`` and its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os.path import exists, isdir
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording, RecordingKind, StandardUncertainty, TrackerTarget
from machopt.errors import RecordingError
from machopt.file_formats.strict_yaml import YamlDocument, format_found_value, read_yaml, validate_document
from machopt.measurement.recording import inclinometer as by_tilt
from machopt.measurement.recording import motor_channels as by_motor
from machopt.measurement.recording import tracker_targets as by_target
from machopt.measurement.recording.foreign_tables import (
    ColumnReading,
    convert_foreign_table,
    is_binary_table,
    list_column_readings,
)
from machopt.measurement.recording.recording_columns import (
    LABELS,
    find_sliding_joints,
    list_allowed_columns,
    read_branches,
    read_channels,
    read_labels,
    read_used_rows,
)
from machopt.measurement.recording.recording_merge import (
    find_wide_poses,
    merge_recordings,
    number_poses,
    renumber_session_poses,
    separate_cycles,
)
from machopt.measurement.recording.recording_schema import (
    DATA_NAME,
    UNCERTAINTY,
    YAML_NAME,
    FormatKeys,
    RecordingKeys,
    UncertaintyKeys,
)
from machopt.measurement.recording.recording_table import RecordingTable, read_table
from machopt.numerics.array_types import Array, Bools, Ints

_RADIANS_LOOK = 6.3  # all angles within one turn in rad: in degrees the arm would hardly have moved


def load_recording(path: Path | str) -> Recording:
    """Read a recording folder.

    Args:
        path: the folder, or the ``recording.yaml`` in it.

    Returns:
        The readings of all its data files in SI. Where ``data`` lists several files, each is a session of its own
        unless a column ``session`` says otherwise.

    Raises:
        InputError: names file, key or line and column, what was found and what was expected.
    """
    file = find_recording_yaml(Path(path))
    document = read_yaml(file)
    if isinstance(document.value, dict) and document.value.get("kind") == "cutting":
        raise document.build_error(
            ("kind",), "is cutting, measured cuts: machopt process reads them; expected deflection, absolute or motion"
        )
    _refuse_frequency_responses(document)
    keys = validate_document(RecordingKeys, document)
    data = find_data_files(document, keys.data, file.parent)
    targets = by_target.parse_targets(document, keys.targets_mm, keys.kind)
    tilted = by_tilt.parse_tilt_link(document, keys.tilt_link, keys.kind)
    motors = by_motor.parse_motor_keys(
        document, keys.motor_gain_Nm_per_A, keys.gear_ratio, keys.coupling_matrix, keys.kind
    )
    runs = [_read_run(_read_data_file(document, keys, p), keys, file.parent, targets, motors, tilted) for p in data]
    _refuse_moved(document, keys, runs)
    for other, p in zip(runs[1:], data[1:], strict=True):
        if other.stated_labels != runs[0].stated_labels:
            name = next(n for n in LABELS if (n in other.stated_labels) != (n in runs[0].stated_labels))
            has, not_ = (p, data[0]) if name in other.stated_labels else (data[0], p)
            raise RecordingError(
                f"has no column {name} but {has.name} has; files of a recording need the same columns", file=not_
            )
    recording = renumber_session_poses(merge_recordings(runs, new_sessions=False))
    _refuse_falling_time(recording, data)
    warnings = (
        *_find_assumed_frames(document, recording),
        *recording.warnings,
        *find_wide_poses(recording),
        *_find_radian_warnings(recording),
        *by_target.find_unmeasured_targets(recording),
    )
    return replace(recording, warnings=warnings)


def _refuse_frequency_responses(document: YamlDocument) -> None:
    if isinstance(document.value, dict) and document.value.get("kind") == "frf":
        raise document.build_error(
            ("kind",),
            "is frf, frequency responses: machopt identify reads one, without --dry-run; expected deflection, absolute "
            "or motion",
        )


def describe_columns(path: Path | str) -> tuple[ColumnReading, ...]:
    """Return how each column of the data files of a recording folder is understood.

    Args:
        path: the folder, or the ``recording.yaml`` in it.

    Raises:
        InputError: as :func:`load_recording`.
    """
    file = find_recording_yaml(Path(path))
    document = read_yaml(file)
    _refuse_frequency_responses(document)
    keys = validate_document(RecordingKeys, document)
    allowed = list_allowed_columns(keys.kind)
    known = (*allowed.numbers, *allowed.words)
    out: list[ColumnReading] = []
    for table in find_data_files(document, keys.data, file.parent):
        if table.suffix.lower() != ".parquet":
            out += list_column_readings(table, keys.columns, keys.format or FormatKeys(), keys.join, known)
    return tuple(out)


def load_recordings(paths: Sequence[Path | str]) -> Recording:
    """Read several recording folders as one recording.

    Sessions of different folders are distinct. Pose labels are kept where equal labels mean equal joint positions
    (within 0.05°), otherwise renumbered with a warning.

    Args:
        paths: folders or their ``recording.yaml``, one or more.

    Returns:
        The readings of all, in the given order.

    Raises:
        InputError: as :func:`load_recording`; the recordings differ in kind, frames or columns; a folder comes twice.
    """
    if not paths:
        raise RecordingError("no recordings given; expected one or more recording folders")
    places = [find_recording_yaml(Path(p)).resolve() for p in paths]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise RecordingError("is given twice; the same readings would count as new ones", file=paths[k])
    return merge_recordings([load_recording(p) for p in paths], new_sessions=True)


def find_recording_yaml(path: Path) -> Path:
    """Return the ``recording.yaml`` of a folder or of itself.

    Args:
        path: the folder, or the file.

    Raises:
        RecordingError: there is none.
    """
    if not exists(path):
        raise RecordingError(f"no such file or folder; expected a recording folder or its {YAML_NAME}", file=path)
    if not isdir(path):
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise RecordingError(f"is not a recording; expected a folder with {YAML_NAME}, or that file", file=path)
        return path
    if not exists(path / YAML_NAME):
        raise RecordingError(f"holds no {YAML_NAME}; expected a recording folder", file=path)
    return path / YAML_NAME


def find_data_files(document: YamlDocument, value: object, folder: Path) -> list[Path]:
    """Return the data files that the key ``data`` names, all inside the folder.

    Args:
        document: the parsed recording.yaml.
        value: value of ``data``.
        folder: folder of the recording.

    Raises:
        InputError: a name that is no file of the folder.
    """
    names = value if isinstance(value, list) else [value]
    if not names:
        raise document.build_error(("data",), "is an empty list; expected one data file or more")
    out: list[Path] = []
    for k, name in enumerate(names):
        loc: tuple[str | int, ...] = ("data", k) if isinstance(value, list) else ("data",)
        if not isinstance(name, str) or not name or "\0" in name:
            raise document.build_error(
                loc, f"found {format_found_value(name)}; expected the name of a data file, e.g. {DATA_NAME}"
            )
        path = folder / name
        try:
            inside = path.resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError):  # circular symbolic links
            raise document.build_error(loc, f"{name!r} leads in a circle of links; expected a file") from None
        if not inside:
            raise document.build_error(loc, f"{name!r} lies outside the recording folder; expected a file inside it")
        if not exists(path):
            raise document.build_error(loc, f"no such file: {name!r} (looked for {path})")
        if path.resolve() in [p.resolve() for p in out]:
            raise document.build_error(loc, f"{name!r} is listed twice; keep one")
        out.append(path)
    return out


def _refuse_moved(document: YamlDocument, keys: RecordingKeys, runs: Sequence[Recording]) -> None:
    moved = any(r.frame is not None and len(np.unique(r.frame)) > 1 for r in runs)
    if moved and keys.registration == "fixed":
        raise document.build_error(
            ("registration",),
            "is fixed, but column frame says that the tracker was moved; expected registration: fit, which fits one "
            "frame a stand",
        )


def _read_data_file(document: YamlDocument, keys: RecordingKeys, path: Path) -> RecordingTable:
    """Read one data file, converted where recording.yaml says that it is written otherwise."""
    allowed = list_allowed_columns(keys.kind)
    if not keys.columns and keys.format is None and keys.join is None and not is_binary_table(path):
        return read_table(path, allowed)
    for k, name in enumerate(keys.join.files if keys.join else ()):
        if not (path.parent / name).resolve().is_relative_to(path.parent.resolve()):
            raise document.build_error(
                ("join", "files", k), f"{name!r} lies outside the recording folder; expected a file inside it"
            )
    known = (*allowed.numbers, *allowed.words)
    return read_table(
        path, allowed, convert_foreign_table(path, keys.columns, keys.format or FormatKeys(), keys.join, known)
    )


def _read_channels(
    table: RecordingTable, keys: RecordingKeys, motors: by_motor.MotorProperties, prismatic: tuple[bool, ...]
) -> tuple[dict[str, Array], list[str]]:
    """Return the channels in SI by field of :class:`Recording`, those by motor included, and warnings."""
    by_motors = by_motor.compute_joint_angles(table, motors, prismatic)
    found, warnings = read_channels(table, keys.kind, prismatic, {} if by_motors is None else {"q": by_motors})
    if found["q"] is not by_motors:
        warnings += by_motor.check_motor_angles(table, found["q"], by_motors)
    made = by_motor.compute_joint_torque(table, motors, found.get("current"), prismatic)
    if made is not None and "torque" not in found:
        found["torque"] = made
        warnings.append(
            f"{table.path.name}: joint torque is current × {by_motor.GAIN} × ratio; a gain that is off passes "
            "for a payload"
        )
    elif made is not None:
        warnings.append(f"{table.path.name}: tau1_Nm … stand too and are used; current1_A … are not")
    return found, warnings


def _convert_point(point_mm: Sequence[float] | None) -> Array | None:
    """Return a point (3,) in m."""
    return None if point_mm is None else np.array(point_mm) / 1e3


def _read_used_rows(
    table: RecordingTable, kind: RecordingKind, found: Mapping[str, Array]
) -> tuple[Bools | None, list[str]]:
    """Return the rows (N,) that are used, None: all; and warnings of targets that were lost."""
    used = read_used_rows(table)
    return _leave_out_lost_targets(table, found["position"], used) if kind == "absolute" else (used, [])


def _complete_labels(given: Mapping[str, Ints], q: Array, kind: RecordingKind) -> tuple[Ints, Ints, Ints]:
    """Return labels (N,) of pose, session and cycle: those of the table, else numbered."""
    pose = given.get("pose")
    if pose is None:
        pose = number_poses(q, kind)
    session = given.get("session", np.zeros(len(q), dtype=np.int64))
    cycle = separate_cycles(pose, given["cycle"], session) if "cycle" in given else np.arange(len(q), dtype=np.int64)
    return pose, session, cycle


def _read_run(
    table: RecordingTable,
    keys: RecordingKeys,
    folder: Path,
    targets: Mapping[str, TrackerTarget],
    motors: by_motor.MotorProperties,
    tilted: str,
) -> Recording:
    """Read one data file as a recording of its own."""
    reflectors, target = by_target.match_targets(table, targets, isinstance(keys.targets_mm, list))
    frame = by_target.read_tracker_stations(table)
    prismatic = find_sliding_joints(table, keys.kind)
    by_tilt.check_tilt_columns(table, tilted)
    found, warnings = _read_channels(table, keys, motors, prismatic)
    given = {name: read_labels(table, name) for name in LABELS if name in table.numbers}
    pose, session, cycle = _complete_labels(given, found["q"], keys.kind)
    branch = read_branches(table) if "branch" in table.words else None
    used, lost = _read_used_rows(table, keys.kind, found)
    warnings += lost
    for array in (pose, session, cycle, branch, target, frame, used, table.lines, *found.values()):
        if array is not None:
            array.setflags(write=False)
    return Recording(
        kind=keys.kind,
        source=folder.resolve().name,
        q=found["q"],
        pose=pose,
        cycle=cycle,
        session=session,
        line=table.lines,
        wrench=found.get("wrench"),
        wrench_frame=keys.wrench_frame,
        wrench_point=_convert_point(keys.wrench_point_mm),
        displacement=found.get("displacement"),
        displacement_frame=keys.displacement_frame,
        position=found.get("position"),
        quaternion=found.get("quaternion"),
        time=found.get("time"),
        temperature=found.get("temperature"),
        branch=branch,
        q_command=found.get("q_command"),
        q_secondary=found.get("q_secondary"),
        velocity=found.get("velocity"),
        torque=found.get("torque"),
        current=found.get("current"),
        prismatic=prismatic if any(prismatic) else (),
        registration=keys.registration,
        targets=reflectors,
        target=target,
        frame=frame,
        tilt=found.get("tilt"),
        tilt_link=tilted,
        used=used,
        uncertainty=_convert_uncertainty(keys.standard_uncertainty),
        notes=keys.notes,
        stated_labels=frozenset(given),
        warnings=tuple(warnings),
        files=(table.path.name,),
    )


def _leave_out_lost_targets(
    table: RecordingTable, position: Array, used: NDArray[np.bool_] | None
) -> tuple[NDArray[np.bool_] | None, list[str]]:
    """Leave out readings of exactly 0, 0, 0, which a tracker writes when it has lost its target."""
    lost = np.all(position == 0.0, axis=1)
    if not lost.any() or lost.all():
        return used, []
    rows = np.flatnonzero(lost)
    text = (
        f"{table.path.name}: {len(rows)} reading{'s' if len(rows) > 1 else ''} of exactly 0, 0, 0 (first in line "
        f"{table.lines[rows[0]]}): a tracker that lost its target writes that; left out"
    )
    return ~lost if used is None else used & ~lost, [text]


def _convert_uncertainty(keys: UncertaintyKeys) -> StandardUncertainty:
    stated = {key: getattr(keys, key) for key in UNCERTAINTY}
    return StandardUncertainty(**{n: None if (v := stated[k]) is None else v * s for k, (n, s) in UNCERTAINTY.items()})


def _refuse_falling_time(recording: Recording, files: Sequence[Path]) -> None:
    if recording.kind != "motion" or recording.time is None:
        return
    order = np.argsort(recording.session, kind="stable")
    time, session = recording.time[order], recording.session[order]
    bad = np.flatnonzero((np.diff(time) <= 0) & (np.diff(session) == 0))
    if bad.size:
        here, before = int(order[bad[0] + 1]), int(order[bad[0]])
        file = files[0 if recording.file is None else int(recording.file[here])]
        raise RecordingError(
            f"time does not rise: {time[bad[0] + 1]:.12g} s after {time[bad[0]]:.12g} s in {recording.place(before)}; "
            "several runs need a column session, or one file a run in a list under data",
            file=file,
            where=f"line {recording.line[here]}, column time_s",
        )


def _find_assumed_frames(document: YamlDocument, recording: Recording) -> list[str]:
    """Return warnings on frames that are assumed to be base because no key states them."""
    keys = document.value if isinstance(document.value, dict) else {}
    there = {"wrench_frame": recording.wrench, "displacement_frame": recording.displacement}
    return [
        f"{recording.source}: {key} is not given; base_link axes are taken"
        for key, array in there.items()
        if array is not None and key not in keys
    ]


def _find_radian_warnings(recording: Recording) -> list[str]:
    q = np.degrees(recording.q[:, [not p for p in recording.prismatic] or slice(None)])
    if not q.shape[1] or np.abs(q).max() > _RADIANS_LOOK or np.abs(q - np.round(q)).max() < 1e-6:
        return []
    return [
        f"{recording.source}: q1_deg … q{recording.q.shape[1]}_deg all lie within ±{_RADIANS_LOOK}; they look like "
        "radians, degrees are expected and were taken"
    ]

"""Recording folders: ``recording.yaml`` and its tables of readings, read strictly and written to the printed digit."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from os.path import exists, isdir
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from machopt.arrays import Ints
from machopt.domain.recording import Recording, StandardUncertainty, Target
from machopt.errors import InputError
from machopt.formats import recording_motors, recording_targets, recording_tilt
from machopt.formats.recording_columns import BRANCHES, CHANNELS, LABELS, branches, chain, channels, labels, vocabulary
from machopt.formats.recording_join import join, number_poses, separate_cycles, wide_poses
from machopt.formats.recording_table import DataTable, read_table
from machopt.formats.yamlstrict import Document, Strict, read_yaml, show, validate

_YAML, _DATA = "recording.yaml", "data.csv"
_ENDS = frozenset("\x85\u2028\u2029")  # line ends of YAML 1.1, which a reader folds away
_UNCERTAINTY = {
    "displacement_mm": ("displacement", 1e-3),
    "rotation_mrad": ("rotation", 1e-3),
    "force_N": ("force", 1.0),
    "moment_Nm": ("moment", 1.0),
    "joint_deg": ("joint", np.pi / 180.0),
    "target_mm": ("target", 1e-3),
    "tilt_mrad": ("tilt", 1e-3),
}
_RADIANS_LOOK = 6.3  # every joint of every reading within a turn in rad: degrees would be a straight arm, hardly moved
_ROWS_AT_ONCE = 4096


class _Uncertainty(Strict):
    displacement_mm: float | None = Field(default=None, gt=0, description="1 sigma of a coordinate in mm")
    rotation_mrad: float | None = Field(default=None, gt=0, description="1 sigma of a rotation in mrad")
    force_N: float | None = Field(default=None, ge=0, description="1 sigma of a force in N")
    moment_Nm: float | None = Field(default=None, ge=0, description="1 sigma of a moment in N·m")
    joint_deg: float | None = Field(default=None, ge=0, description="1 sigma of a joint position in degrees")
    target_mm: float | None = Field(default=None, gt=0, description="1 sigma of a coordinate of targets_mm in mm")
    tilt_mrad: float | None = Field(default=None, gt=0, description="1 sigma of an inclinometer in mrad")


class _RecordingFile(Strict):
    machopt_recording: Literal[1] = Field(description="the format, 1")
    kind: Literal["deflection", "absolute", "motion"] = Field(description="load tests, measured poses, or motion")
    data: Any = Field(description="a data file, or a list of them")
    wrench_frame: Literal["base", "tool"] = Field(default="base", description="axes of forces and moments")
    displacement_frame: Literal["base", "tool"] = Field(default="base", description="axes of displacements")
    wrench_point_mm: list[float] | None = Field(
        default=None, min_length=3, max_length=3, description="x, y, z in flange of the point the moments are about"
    )
    registration: Literal["fixed", "fit"] = Field(
        default="fixed", description="whether the instrument's frame is the base or is fitted"
    )
    targets_mm: Any = Field(
        default=None, description="of each reflector its nominal place x, y, z in flange, by its name in column target"
    )
    tilt_link: Any = Field(
        default=None,
        description="link whose tilt_x_mrad, tilt_y_mrad are: its name in the URDF, or the joint that moves it",
    )
    motor_gain_Nm_per_A: Any = Field(default=None, description="of each motor, torque at its shaft per current")
    gear_ratio: Any = Field(default=None, description="of each joint, turns of its motor per turn of the joint")
    coupling_matrix: Any = Field(default=None, description="joint angles per motor angles, a row a joint")
    standard_uncertainty: _Uncertainty = Field(default=_Uncertainty(), description="of the readings, 1 sigma")
    notes: str = Field(default="", description="free text")


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
    file = _recording_yaml(Path(path))
    document = read_yaml(file)
    keys = validate(_RecordingFile, document)
    data = _data_files(document, keys.data, file.parent)
    targets = recording_targets.stated(document, keys.targets_mm, keys.kind)
    tilted = recording_tilt.stated(document, keys.tilt_link, keys.kind)
    motors = recording_motors.stated(
        document, keys.motor_gain_Nm_per_A, keys.gear_ratio, keys.coupling_matrix, keys.kind
    )
    runs = [_read_run(read_table(p, vocabulary(keys.kind)), keys, file.parent, targets, motors, tilted) for p in data]
    _refuse_moved(document, keys, runs)
    for other, p in zip(runs[1:], data[1:], strict=True):
        if other.labelled != runs[0].labelled:
            name = next(n for n in LABELS if (n in other.labelled) != (n in runs[0].labelled))
            has, not_ = (p, data[0]) if name in other.labelled else (data[0], p)
            raise InputError(
                f"has no column {name} but {has.name} has; files of a recording need the same columns", file=not_
            )
    recording = join(runs, new_sessions=False)
    _refuse_falling_time(recording, data)
    warnings = (
        *_frames_not_given(document, recording),
        *recording.warnings,
        *wide_poses(recording),
        *_radians(recording),
        *recording_targets.unseen(recording),
    )
    return replace(recording, warnings=warnings)


def load_recordings(paths: Sequence[Path | str]) -> Recording:
    """Read several recording folders as one recording.

    Sessions of different folders are told apart. Pose labels are kept where equal labels mean equal joint positions
    (within 0.05°), otherwise renumbered with a warning.

    Args:
        paths: folders or their ``recording.yaml``, one or more.

    Returns:
        The readings of all, in the given order.

    Raises:
        InputError: as :func:`load_recording`; the recordings differ in kind, frames or columns; a folder comes twice.
    """
    if not paths:
        raise InputError("no recordings given; expected one or more recording folders")
    places = [_recording_yaml(Path(p)).resolve() for p in paths]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise InputError("is given twice; the same readings would count as new ones", file=paths[k])
    return join([load_recording(p) for p in paths], new_sessions=True)


def write_recording(folder: Path | str, recording: Recording) -> None:
    """Write ``recording.yaml`` and ``data.csv`` so that :func:`load_recording` returns the recording.

    Numbers are printed to 1e-9 degree, 1e-7 mm, 1e-6 N; what is read back and written again gives the same bytes.
    A column of labels is left out where the reader would give the same labels by itself.

    Args:
        folder: made where it does not exist; the two files in it are replaced.
        recording: SI, as in memory.

    Raises:
        InputError: a number is not finite, no reading, or the folder cannot be written.
    """
    target = Path(folder)
    columns = _columns(recording, target)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with _replacing(target / _DATA) as partial, partial.open("w", encoding="utf-8", newline="\n") as out:
            out.write(",".join(columns) + "\n")
            for start in range(0, len(recording), _ROWS_AT_ONCE):
                cells = [c[start : start + _ROWS_AT_ONCE] for c in columns.values()]
                out.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))
        with _replacing(target / _YAML) as partial:
            _write_yaml(partial, recording)
    except OSError as problem:
        raise InputError(f"cannot be written: {problem.strerror}", file=folder) from None


def _recording_yaml(path: Path) -> Path:
    if not exists(path):
        raise InputError(f"no such file or folder; expected a recording folder or its {_YAML}", file=path)
    if not isdir(path):
        if path.suffix.lower() not in (".yaml", ".yml"):
            raise InputError(f"is not a recording; expected a folder with {_YAML}, or that file", file=path)
        return path
    if not exists(path / _YAML):
        raise InputError(f"holds no {_YAML}; expected a recording folder", file=path)
    return path / _YAML


def _data_files(document: Document, value: object, folder: Path) -> list[Path]:
    names = value if isinstance(value, list) else [value]
    if not names:
        raise document.error(("data",), "is an empty list; expected one data file or more")
    out: list[Path] = []
    for k, name in enumerate(names):
        loc: tuple[str | int, ...] = ("data", k) if isinstance(value, list) else ("data",)
        if not isinstance(name, str) or not name or "\0" in name:
            raise document.error(loc, f"found {show(name)}; expected the name of a data file, e.g. {_DATA}")
        path = folder / name
        try:
            inside = path.resolve().is_relative_to(folder.resolve())
        except (OSError, RuntimeError):  # links in a circle
            raise document.error(loc, f"{name!r} leads in a circle of links; expected a file") from None
        if not inside:
            raise document.error(loc, f"{name!r} lies outside the recording folder; expected a file inside it")
        if not exists(path):
            raise document.error(loc, f"no such file: {name!r} (looked for {path})")
        if path.resolve() in [p.resolve() for p in out]:
            raise document.error(loc, f"{name!r} is listed twice; keep one")
        out.append(path)
    return out


def _refuse_moved(document: Document, keys: _RecordingFile, runs: Sequence[Recording]) -> None:
    moved = any(r.frame is not None and len(np.unique(r.frame)) > 1 for r in runs)
    if moved and keys.registration == "fixed":
        raise document.error(
            ("registration",),
            "is fixed, but column frame says that the tracker was moved; expected registration: fit, which fits one "
            "frame a stand",
        )


def _read_run(
    table: DataTable,
    keys: _RecordingFile,
    folder: Path,
    targets: Mapping[str, Target],
    motors: recording_motors.Motors,
    tilted: str,
) -> Recording:
    """One data file as a recording of its own."""
    reflectors, target = recording_targets.seen(table, targets, isinstance(keys.targets_mm, list))
    frame = recording_targets.stands(table)
    prismatic = chain(table, keys.kind)
    recording_tilt.check(table, tilted)
    by_motors = recording_motors.angles(table, motors, prismatic)
    found, warnings = channels(table, keys.kind, prismatic, {} if by_motors is None else {"q": by_motors})
    if found["q"] is not by_motors:
        warnings += recording_motors.checked(table, found["q"], by_motors)
    made = recording_motors.torque(table, motors, found.get("current"), prismatic)
    if made is not None and "torque" not in found:
        found["torque"] = made
        warnings.append(
            f"{table.path.name}: joint torque is current × {recording_motors.GAIN} × ratio; a gain that is off passes "
            "for a payload"
        )
    elif made is not None:
        warnings.append(f"{table.path.name}: tau1_Nm … stand too and are used; current1_A … are not")
    n = len(table)
    given = {name: labels(table, name) for name in LABELS if name in table.numbers}
    pose = given.get("pose")
    if pose is None:
        pose = number_poses(found["q"], keys.kind)
    session = given.get("session", np.zeros(n, dtype=np.int64))
    cycle = separate_cycles(pose, given["cycle"], session) if "cycle" in given else np.arange(n, dtype=np.int64)
    branch = branches(table) if "branch" in table.words else None
    for array in (pose, session, cycle, branch, target, frame, table.lines, *found.values()):
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
        wrench_point=None if keys.wrench_point_mm is None else np.array(keys.wrench_point_mm) / 1e3,
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
        uncertainty=_uncertainty(keys.standard_uncertainty),
        notes=keys.notes,
        labelled=frozenset(given),
        warnings=tuple(warnings),
        files=(table.path.name,),
    )


def _uncertainty(keys: _Uncertainty) -> StandardUncertainty:
    stated = {key: getattr(keys, key) for key in _UNCERTAINTY}
    return StandardUncertainty(**{n: None if (v := stated[k]) is None else v * s for k, (n, s) in _UNCERTAINTY.items()})


def _refuse_falling_time(recording: Recording, files: Sequence[Path]) -> None:
    if recording.kind != "motion" or recording.time is None:
        return
    order = np.argsort(recording.session, kind="stable")
    time, session = recording.time[order], recording.session[order]
    bad = np.flatnonzero((np.diff(time) <= 0) & (np.diff(session) == 0))
    if bad.size:
        here, before = int(order[bad[0] + 1]), int(order[bad[0]])
        file = files[0 if recording.file is None else int(recording.file[here])]
        raise InputError(
            f"time does not rise: {time[bad[0] + 1]:.12g} s after {time[bad[0]]:.12g} s in {recording.place(before)}; "
            "several runs need a column session, or one file a run in a list under data",
            file=file,
            where=f"line {recording.line[here]}, column time_s",
        )


def _frames_not_given(document: Document, recording: Recording) -> list[str]:
    """Frames that were taken to be base because no key says so."""
    keys = document.value if isinstance(document.value, dict) else {}
    there = {"wrench_frame": recording.wrench, "displacement_frame": recording.displacement}
    return [
        f"{recording.source}: {key} is not given; base_link axes are taken"
        for key, array in there.items()
        if array is not None and key not in keys
    ]


def _radians(recording: Recording) -> list[str]:
    q = np.degrees(recording.q[:, [not p for p in recording.prismatic] or slice(None)])
    if not q.shape[1] or np.abs(q).max() > _RADIANS_LOOK or np.abs(q - np.round(q)).max() < 1e-6:
        return []
    return [
        f"{recording.source}: q1_deg … q{recording.q.shape[1]}_deg all lie within ±{_RADIANS_LOOK}; they look like "
        "radians, degrees are expected and were taken"
    ]


def _columns(recording: Recording, folder: Path) -> dict[str, Sequence[str]]:
    """The printed cells of each column."""
    if not len(recording):
        raise InputError("holds no reading; expected one or more", file=folder)
    out: dict[str, Sequence[str]] = {}
    default: dict[str, Callable[[], Ints]] = {
        "pose": lambda: number_poses(recording.q, recording.kind),
        "cycle": lambda: np.arange(len(recording), dtype=np.int64),
        "session": lambda: np.zeros(len(recording), dtype=np.int64),
    }
    for name in LABELS:
        values = getattr(recording, name)
        if name in recording.labelled or not np.array_equal(values, default[name]()):
            out[name] = [str(v) for v in values.tolist()]
    if recording.branch is not None:
        word = {code: name for name, code in BRANCHES.items()}
        out["branch"] = [word[b] for b in recording.branch.tolist()]
    if recording.target is not None:
        out["target"] = [recording.targets[n].name for n in recording.target.tolist()]
    if recording.frame is not None:
        out["frame"] = [str(v) for v in recording.frame.tolist()]
    for channel in CHANNELS:
        array = getattr(recording, channel.field)
        if array is None:
            continue
        array = np.asarray(array, float).reshape(len(recording), -1)
        prismatic = recording.prismatic or (False,) * recording.q.shape[1]
        names = channel.names(prismatic)
        units = channel.units(prismatic if channel.turns else ())
        for name, unit, column in zip(names, units, array.T, strict=False):
            if channel.rest == "nan" and np.isnan(column).all():
                continue
            bad = np.flatnonzero(np.isinf(column) if channel.sparse else ~np.isfinite(column))
            if bad.size:
                found = f"reading {bad[0] + 1} of {name} is {column[bad[0]]}"
                raise InputError(f"{found}; a recording holds finite numbers", file=folder)
            # shortest text of the rounded number; adding zero turns -0.0 into 0.0
            cells = map(repr, (np.round(column / unit, channel.decimals) + 0.0).tolist())
            out[name] = ["" if channel.sparse and c == "nan" else c for c in cells]
    return out


def _write_yaml(path: Path, recording: Recording) -> None:
    from ruamel.yaml import YAML

    data: dict[str, object] = {"machopt_recording": 1, "kind": recording.kind, "data": _DATA}
    if recording.wrench is not None:
        data["wrench_frame"] = recording.wrench_frame
    if recording.wrench_point is not None:
        data["wrench_point_mm"] = [_printed(v * 1e3) for v in recording.wrench_point.tolist()]
    if recording.displacement is not None:
        data["displacement_frame"] = recording.displacement_frame
    data["registration"] = recording.registration
    if recording.targets:
        data[recording_targets.KEY] = {t.name: [_printed(1e3 * v) for v in t.place] for t in recording.targets}
    if recording.tilt_link:
        data[recording_tilt.KEY] = recording.tilt_link
    sigma = {k: getattr(recording.uncertainty, name) for k, (name, _) in _UNCERTAINTY.items()}
    stated = {k: _printed(v / _UNCERTAINTY[k][1]) for k, v in sigma.items() if v is not None}
    if stated:
        data["standard_uncertainty"] = stated
    if recording.notes:
        data["notes"] = recording.notes
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.allow_unicode = not _ENDS.intersection(recording.notes)  # else they are written as \N and come back
    yaml.representer.sort_base_mapping_type_on_output = False
    with path.open("w", encoding="utf-8", newline="\n") as out:
        yaml.dump(data, out)


def _printed(value: float) -> float:
    """Twelve digits: 0.015 and not 0.015000000000000001."""
    return float(f"{value:.12g}")


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A new file that takes the place of ``path`` once it is whole."""
    partial = path.with_name(f".{path.name}.partial-{secrets.token_hex(8)}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)

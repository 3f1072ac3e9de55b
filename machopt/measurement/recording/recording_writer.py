"""Writer of recordings. Numbers are printed so that reading and writing again gives the same bytes."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.measurement.recording import inclinometer, tracker_targets
from machopt.measurement.recording.recording_columns import BRANCHES, CHANNELS, LABELS, USED
from machopt.measurement.recording.recording_merge import number_poses
from machopt.measurement.recording.recording_schema import DATA_NAME, UNCERTAINTY, YAML_NAME
from machopt.numerics.array_types import Ints

_ENDS = frozenset("\x85\u2028\u2029")  # line ends of YAML 1.1, which a reader folds
_ROWS_AT_ONCE = 4096


def write_recording(
    folder: Path | str, recording: Recording, *, data_name: str = DATA_NAME, yaml_name: str = YAML_NAME
) -> None:
    """Write ``recording.yaml`` and ``data.csv`` so that :func:`load_recording` returns the recording.

    Numbers are printed to 1e-9 degree, 1e-7 mm, 1e-6 N; what is read back and written again gives the same bytes. A
    column of labels is left out where the reader would give the same labels by itself.

    Args:
        folder: made where it does not exist; the two files in it are replaced.
        recording: SI, as in memory.
        data_name: name of the table.
        yaml_name: name of the file of keys.

    Raises:
        InputError: a number is not finite, no reading, or the folder cannot be written.
    """
    target = Path(folder)
    columns = _format_columns(recording, target)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with _replace_file(target / data_name) as partial, partial.open("w", encoding="utf-8", newline="\n") as out:
            out.write(",".join(columns) + "\n")
            for start in range(0, len(recording), _ROWS_AT_ONCE):
                cells = [c[start : start + _ROWS_AT_ONCE] for c in columns.values()]
                out.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))
        with _replace_file(target / yaml_name) as partial:
            _write_yaml(partial, recording, data_name)
    except OSError as problem:
        raise RecordingError(f"cannot be written: {problem.strerror}", file=folder) from None


def _format_columns(recording: Recording, folder: Path) -> dict[str, Sequence[str]]:
    """The printed cells of each column."""
    if not len(recording):
        raise RecordingError("holds no reading; expected one or more", file=folder)
    out: dict[str, Sequence[str]] = {}
    default: dict[str, Callable[[], Ints]] = {
        "pose": lambda: number_poses(recording.q, recording.kind),
        "cycle": lambda: np.arange(len(recording), dtype=np.int64),
        "session": lambda: np.zeros(len(recording), dtype=np.int64),
    }
    for name in LABELS:
        values = getattr(recording, name)
        if name in recording.stated_labels or not np.array_equal(values, default[name]()):
            out[name] = [str(v) for v in values.tolist()]
    if recording.used is not None:
        out[USED] = [str(int(v)) for v in recording.used.tolist()]
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
                raise RecordingError(f"{found}; a recording holds finite numbers", file=folder)
            # shortest text of the rounded number; adding zero turns -0.0 into 0.0
            cells = map(repr, (np.round(column / unit, channel.decimals) + 0.0).tolist())
            out[name] = ["" if channel.sparse and c == "nan" else c for c in cells]
    return out


def _write_yaml(path: Path, recording: Recording, data_name: str) -> None:
    from ruamel.yaml import YAML

    data: dict[str, object] = {"machopt_recording": 1, "kind": recording.kind, "data": data_name}
    if recording.wrench is not None:
        data["wrench_frame"] = recording.wrench_frame
    if recording.wrench_point is not None:
        data["wrench_point_mm"] = [_round_to_printed_digits(v * 1e3) for v in recording.wrench_point.tolist()]
    if recording.displacement is not None:
        data["displacement_frame"] = recording.displacement_frame
    data["registration"] = recording.registration
    if recording.targets:
        data[tracker_targets.KEY] = {
            t.name: [_round_to_printed_digits(1e3 * v) for v in t.place] for t in recording.targets
        }
    if recording.tilt_link:
        data[inclinometer.KEY] = recording.tilt_link
    sigma = {k: getattr(recording.uncertainty, name) for k, (name, _) in UNCERTAINTY.items()}
    stated = {k: _round_to_printed_digits(v / UNCERTAINTY[k][1]) for k, v in sigma.items() if v is not None}
    if stated:
        data["standard_uncertainty"] = stated
    if recording.notes:
        data["notes"] = recording.notes
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.allow_unicode = not _ENDS.intersection(recording.notes)  # otherwise they are written as \N and preserved
    yaml.representer.sort_base_mapping_type_on_output = False
    with path.open("w", encoding="utf-8", newline="\n") as out:
        yaml.dump(data, out)


def _round_to_printed_digits(value: float) -> float:
    """Twelve digits: 0.015 and not 0.015000000000000001."""
    return float(f"{value:.12g}")


@contextlib.contextmanager
def _replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces ``path`` once it is complete."""
    partial = path.with_name(f".{path.name}.partial-{secrets.token_hex(8)}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)

"""Labels of readings, and the merging of several recordings: sessions stay distinct, poses are matched by joint
angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording, RecordingKind, StandardUncertainty
from machopt.errors import RecordingError
from machopt.measurement.recording.recording_columns import CHANNELS
from machopt.numerics.array_types import Array, Ints

SAME_Q = np.radians(0.02)  # tolerance of a pose without labels: encoders repeat within a few millidegrees
SAME_LABEL = np.radians(0.05)  # tolerance between files for one labelled pose
LEAST_SHARED = 5  # least number of shared labels to compare the numbering of sessions
IN_LINE = 0.9  # correlation of a joint's angles in two sessions above which one is a transformed copy of the other
_MOTION_Q = np.radians(1e-3)  # in motions a "pose" is a joint position that occurs again

_SAME = (
    "kind",
    "prismatic",
    "wrench_frame",
    "displacement_frame",
    "registration",
    "wrench_point",
    "targets",
    "tilt_link",
)
_BESIDE = ("branch", "target", "frame", "used")  # columns that do not form a channel


def number_poses(q: Array, kind: RecordingKind, within: float = SAME_Q) -> Ints:
    """Label poses by joint angles, 0, 1, … in the order of their first occurrence.

    A reading belongs to the first pose whose first reading is ``within`` of it in every joint. Encoder noise does not
    split a pose, and a slow sweep is not chained into one. Motions use a tolerance of millidegrees.

    Args:
        q: (N, 6) joint angles, rad.
        kind: Kind of the recording.
        within: Tolerance, rad.

    Returns:
        (N,) labels.
    """
    steps = np.round(q / (_MOTION_Q if kind == "motion" else 1e-3 * SAME_Q))
    _, first, inverse = np.unique(steps, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(first), dtype=np.int64)
    rank[order] = np.arange(len(first))
    places = np.asarray(rank[inverse.reshape(-1)], dtype=np.int64)
    if kind == "motion":
        return places
    from scipy.spatial import cKDTree

    distinct = q[first[order]]
    tree = cKDTree(distinct)
    label = np.full(len(distinct), -1, dtype=np.int64)
    poses = 0
    for k in range(len(distinct)):
        if label[k] < 0:
            near = np.asarray(tree.query_ball_point(distinct[k], within, p=np.inf), dtype=np.int64)
            label[near[label[near] < 0]] = poses
            poses += 1
    return np.asarray(label[places])


def drop_unused_readings(recording: Recording) -> Recording:
    """Return the recording without the readings whose column ``used`` is 0.

    Args:
        recording: Recording.

    Returns:
        The recording; unchanged without such readings.
    """
    used = recording.used
    if used is None or used.all():
        return recording
    names = ("pose", "cycle", "session", "line", "file", *(c.field for c in CHANNELS), *_BESIDE)
    selected: dict[str, Any] = {n: None if (v := getattr(recording, n)) is None else v[used] for n in names}
    return replace(recording, **selected)


def separate_cycles(pose: Ints, cycle: Ints, session: Ints) -> Ints:
    """Relabel load cycles so that none spans two sessions.

    Labels are unchanged if no (pose, cycle) occurs in two sessions. Otherwise every (session, cycle) gets its own
    label.

    Args:
        pose: (N,) pose label.
        cycle: (N,) cycle label.
        session: (N,) session label.

    Returns:
        (N,) cycle label.
    """
    inside = np.unique(np.column_stack([pose, cycle, session]), axis=0)
    if len(np.unique(inside[:, :2], axis=0)) == len(inside):
        return cycle
    _, label = np.unique(np.column_stack([session, cycle]), axis=0, return_inverse=True)
    return np.asarray(label.reshape(-1), dtype=np.int64)


def renumber_session_poses(recording: Recording) -> Recording:
    """Renumber poses by joint angles if a session uses its own numbering of poses.

    This does not apply if labels agree but a session has another zero, sign or unit of a joint: then its angles are
    linearly related to those of the other sessions.

    Args:
        recording: Recording.

    Returns:
        The recording with consistent pose labels.
    """
    if recording.kind == "motion" or not {"pose", "session"} <= recording.stated_labels:
        return recording
    both = np.column_stack([recording.session, recording.pose])
    visits, of = np.unique(both, axis=0, return_inverse=True)
    of = of.reshape(-1)
    rows = [recording.q[of == k] for k in range(len(visits))]
    if any(np.ptp(q, axis=0).max() > SAME_LABEL for q in rows):
        return recording  # no labels to go by
    mean_q = np.stack([q.mean(axis=0) for q in rows])
    first = visits[0, 0]
    other = next(
        (s for s in np.unique(visits[:, 0])[1:] if _are_poses_different(visits, mean_q, int(first), int(s))), None
    )
    if other is None:
        return recording
    pose = number_poses(mean_q, recording.kind, SAME_LABEL)[of]
    cycle = recording.cycle
    if "cycle" in recording.stated_labels:
        cycle = separate_cycles(pose, cycle, recording.session)
    warning = (
        f"{recording.source}: session {other} counts its poses anew (a label is another robot pose there than in "
        f"session {first}), so all poses are identified by joint position"
    )
    return replace(
        recording, pose=_freeze_value(pose), cycle=_freeze_value(cycle), warnings=(*recording.warnings, warning)
    )


def _are_poses_different(visits: Ints, at: Array, one: int, two: int) -> bool:
    """Return whether equal labels of two sessions are different poses, in most joints and not linearly related."""
    a, b = (visits[:, 0] == s for s in (one, two))
    _, i, j = np.intersect1d(visits[a, 1], visits[b, 1], return_indices=True)
    x, y = at[a][i], at[b][j]
    if len(i) < LEAST_SHARED or np.median(np.abs(x - y).max(axis=1)) <= SAME_LABEL:
        return False
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    size = np.sqrt((x**2).sum(axis=0) * (y**2).sum(axis=0))
    moving = size > 0.0
    alike = np.abs((x * y).sum(axis=0)[moving]) / size[moving]
    return bool(2 * (alike < IN_LINE).sum() > moving.sum())


def find_wide_poses(recording: Recording) -> tuple[str, ...]:
    """Warn if readings of one pose label differ more than a single pose can.

    Args:
        recording: Recording.

    Returns:
        Warnings.
    """
    if recording.kind == "motion" or not len(recording):
        return ()
    order = np.argsort(recording.pose, kind="stable")
    labels, start = np.unique(recording.pose[order], return_index=True)
    q = recording.q[order]
    spread = np.maximum.reduceat(q, start) - np.minimum.reduceat(q, start)
    wide = np.flatnonzero(spread.max(axis=1) > SAME_LABEL)
    if not wide.size:
        return ()
    worst = wide[np.argmax(spread[wide].max(axis=1))]
    joint = int(np.argmax(spread[worst]))
    return (
        f"{recording.source}: readings of pose {labels[worst]} lie {np.degrees(spread[worst, joint]):.3g}° apart in "
        f"q{joint + 1}_deg ({len(wide)} such poses); one label is meant for one robot pose",
    )


def _number_stations(recordings: Sequence[Recording], frame: Ints) -> NDArray[np.intp]:
    """Return new labels (N,): tracker stations of different folders are distinct, whatever their labels."""
    whose = np.repeat(np.arange(len(recordings)), [len(r) for r in recordings])
    return np.unique(np.column_stack([whose, frame]), axis=0, return_inverse=True)[1].reshape(-1)


def merge_recordings(recordings: Sequence[Recording], *, new_sessions: bool) -> Recording:
    """Merge several recordings in the given order.

    Poses keep their labels if every file has labels and equal labels mean equal joint angles (within 0.05°). Of two
    stated uncertainties the larger one is used.

    Args:
        recordings: One or more recordings of the same kind, frames, registration and channels.
        new_sessions: Whether sessions of different recordings are distinct even if their labels are equal.

    Returns:
        The merged recording.

    Raises:
        InputError: The recordings differ in their content.
    """
    first, rest = recordings[0], recordings[1:]
    if not rest:
        return first
    _refuse_different(first, rest)
    warnings = [w for r in recordings for w in r.warnings]
    session = _stack_sessions(recordings, new_sessions)
    labelled = frozenset.intersection(*(r.stated_labels for r in recordings)) | {"session"}
    q = np.concatenate([r.q for r in recordings])
    if "pose" in labelled:
        pose = _stack_poses(recordings, warnings)
    else:
        pose = number_poses(q, first.kind)
        if any("pose" in r.stated_labels for r in recordings):
            warnings.append("not every recording has a column pose, so all poses are numbered by joint position")
    joined: dict[str, Any] = {"q": q, "line": np.concatenate([r.line for r in recordings])}
    for name in (*(c.field for c in CHANNELS[1:]), *_BESIDE):
        parts = [getattr(r, name) for r in recordings]
        joined[name] = None if parts[0] is None else np.concatenate(parts)
    if new_sessions and first.frame is not None:
        joined["frame"] = _number_stations(recordings, joined["frame"])
    if "cycle" in labelled:
        cycle = separate_cycles(pose, np.concatenate([r.cycle for r in recordings]), session)
    else:
        cycle = np.arange(len(q), dtype=np.int64)
    files = [tuple(f"{r.source}/{f}" if new_sessions else f for f in r.files or ("",)) for r in recordings]
    offset = np.cumsum([0, *(len(f) for f in files)])
    joined["file"] = np.concatenate(
        [
            (np.zeros(len(r), np.int64) if r.file is None else r.file) + k
            for r, k in zip(recordings, offset, strict=False)
        ]
    )
    return replace(
        first,
        **{k: _freeze_value(v) for k, v in {**joined, "pose": pose, "cycle": cycle, "session": session}.items()},
        source=" + ".join(dict.fromkeys(r.source for r in recordings)),
        files=tuple(name for names in files for name in names),
        uncertainty=_find_largest_uncertainty(recordings, warnings),
        notes="\n".join(dict.fromkeys(r.notes for r in recordings if r.notes)),
        stated_labels=labelled,
        warnings=tuple(dict.fromkeys(warnings)),
    )


def _refuse_different(first: Recording, rest: Sequence[Recording]) -> None:
    for other in rest:
        for name in _SAME:
            a, b = getattr(first, name), getattr(other, name)
            if not np.array_equal(a, b):
                raise RecordingError(
                    f"{name} is {b} but {a} in {_format_recording_name(first)}; recordings read together must agree",
                    file=_format_recording_name(other),
                )
        for name in (*(c.field for c in CHANNELS), *_BESIDE):
            a, b = getattr(first, name), getattr(other, name)
            if (a is None) != (b is None) or (a is not None and a.shape[1:] != b.shape[1:]):
                raise RecordingError(
                    f"holds {_name_channel(name, b)}, but {_format_recording_name(first)} "
                    f"{_name_channel(name, a)}; recordings read together need "
                    "the same columns",
                    file=_format_recording_name(other),
                )


def _format_recording_name(recording: Recording) -> str:
    return f"{recording.source}/{recording.files[0]}" if len(recording.files) == 1 else recording.source


def _name_channel(name: str, array: Array | None) -> str:
    if array is None:
        return f"no {name}"
    return f"{name} with {array.shape[1]} columns" if array.ndim > 1 else name


def _stack_sessions(recordings: Sequence[Recording], new: bool) -> Ints:
    out = [recordings[0].session]
    for r in recordings[1:]:
        taken = np.unique(np.concatenate(out))
        clash = new and bool(np.isin(r.session, taken).any())
        unlabelled = "session" not in r.stated_labels
        shift = taken.max() + 1 - r.session.min() if clash or unlabelled else 0
        out.append(r.session + shift)
    return np.concatenate(out)


def _stack_poses(recordings: Sequence[Recording], warnings: list[str]) -> Ints:
    out: list[Ints] = []
    places: dict[int, Array] = {}
    for r in recordings:
        label = r.pose
        own = {int(p): r.q[label == p].mean(axis=0) for p in np.unique(label)}
        apart = [p for p, q in own.items() if p in places and np.abs(q - places[p]).max() > SAME_LABEL]
        if apart and r.kind != "motion":
            shift = max(places) + 1 - min(own)
            warnings.append(
                f"{r.files[0] if r.files else r.source}: pose {apart[0]} is another robot pose than pose {apart[0]} "
                f"read before ({len(apart)} such labels); its poses are numbered from {min(own) + shift} on"
            )
            label = label + shift
            own = {p + shift: q for p, q in own.items()}
        places = {**own, **places}
        out.append(label)
    return np.concatenate(out)


def _find_largest_uncertainty(recordings: Sequence[Recording], warnings: list[str]) -> StandardUncertainty:
    largest: dict[str, float | None] = {}
    for f in fields(StandardUncertainty):
        stated = [getattr(r.uncertainty, f.name) for r in recordings]
        largest[f.name] = max((s for s in stated if s is not None), default=None)
        if len(set(stated)) > 1:
            warnings.append(f"the recordings state different uncertainties of {f.name}; the largest one is used")
    return StandardUncertainty(**largest)


def _freeze_value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    return value

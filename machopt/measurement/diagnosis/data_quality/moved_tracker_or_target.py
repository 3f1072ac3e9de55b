"""Changes between sessions at identical poses: a moved tracker or reflector, or a changed encoder zero.

Readings of one pose and reflector in two sessions differ by noise and by what was moved in between. Model errors
cancel in the difference, so no model is needed. Uncorrected, the change would be counted as noise and would hide
effects.

Compared by least absolute deviations: no change, a moved frame (translation and rotation), a moved reflector, a
changed zero of one encoder, and thermal expansion of the arm. The last one is physics and stays for the catalogue. A
pure translation may have two causes. If temperatures show no difference, a moved tracker is reported, with thermal
expansion as alternative.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS
from machopt.effects.recording.sensor_errors import DISPLACEMENT
from machopt.effects.structure.thermal_drift import THERMAL
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import (
    build_record_equations,
    compute_sign_test,
    compute_typical_error,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    compute_nominal_points,
    index_reflectors,
)
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.rigid_transforms import convert_vector_to_rotation, skew_matrix

Flags = NDArray[np.bool_]
MOST_REPAIRS = 4  # most corrections of one recording


class _ChangeKind(StrEnum):
    SHIFT = "shift"
    FRAME = "frame"
    HEAT = "heat"
    TARGET = "target"
    ENCODER = "encoder"


@dataclass(frozen=True)
class _ChangeCause:
    """Possible cause of a session difference."""

    kind: _ChangeKind
    joint: int = -1  # 0-based, of an encoder

    @property
    def column(self) -> str:
        """Column of the recording, for an encoder."""
        return f"q{self.joint + 1}_deg"

    @property
    def effect(self) -> tuple[str, str]:
        """Effect and location of the finding."""
        if self.kind is _ChangeKind.ENCODER:
            return COLUMNS.name, format_column_location(self.column)
        return DISPLACEMENT.name, DISPLACEMENT.places[0]


SHIFT, FRAME, HEAT, TARGET = (
    _ChangeCause(w) for w in (_ChangeKind.SHIFT, _ChangeKind.FRAME, _ChangeKind.HEAT, _ChangeKind.TARGET)
)


@dataclass(frozen=True, kw_only=True)
class _SessionDifferences:
    """Differences of one session to the others at the same poses and reflectors."""

    session: int
    d: Array  # (n, 3) m
    p: Array  # (n, 3) m, nominal points
    R: Array  # (n, 3, 3) flange orientation
    J: Array  # (n, 3, 6) m/rad
    pose: Ints
    temperature_rise: float  # K relative to the other sessions; NaN if unknown

    def columns(self) -> dict[_ChangeCause, Array]:
        """Return the columns (n, 3, P) of each cause."""
        n = len(self.d)
        shift = np.broadcast_to(np.eye(3), (n, 3, 3))
        away = self.p - self.p.mean(axis=0)
        out = {
            SHIFT: shift,
            FRAME: np.concatenate([shift, -skew_matrix(away)], axis=2),
            HEAT: np.concatenate([shift, self.p[:, :, None]], axis=2),
            TARGET: self.R,
        }
        return out | {_ChangeCause(_ChangeKind.ENCODER, j): self.J[:, :, j : j + 1] for j in range(self.J.shape[2])}


@dataclass(frozen=True)
class _SessionExplanation:
    """Fitted cause of a session difference."""

    cause: _ChangeCause
    x: Array
    differences: _SessionDifferences
    remaining_difference: Array  # (n, 3) m
    shift_alone: bool

    @property
    def misfit_reduction(self) -> float:
        return compute_typical_error(self.differences.d) - compute_typical_error(self.remaining_difference)


def correct_session_changes(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Remove changes of single sessions; a session with a moved tracker frame gets a fitted frame of its own.

    Args:
        recording: Measured poses in base_link, except for the refitted frame, with corrected columns.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    out: list[Finding] = []
    if recording.position is None or len(np.unique(recording.session)) < 2:
        return recording, out
    for _ in range(MOST_REPAIRS):
        each = [_find_explanation(d) for d in _compute_session_differences(recording, robot, T_flange_tcp)]
        found = [t for t in each if t is not None and t.cause.effect[0] not in accept]
        if not found:
            break
        best = max(found, key=lambda t: t.misfit_reduction)
        likely = [t for t in found if t.misfit_reduction * thresholds.RATIOS.equal_fit > best.misfit_reduction]
        read = [_apply_explanation(recording, robot, T_flange_tcp, t) for t in likely]
        left = [_compute_misfit(r, robot, T_flange_tcp) for r in read]
        # with two sessions the difference is symmetric: the model decides, otherwise the later one is corrected
        n = next(n for n, m in enumerate(left) if m < thresholds.RATIOS.equal_fit * min(left))
        recording = read[n]
        out.append(_build_change_finding(likely[n]))
    return recording, out


def merge_with_thermal_drift(
    record_findings: Sequence[Finding], found: Sequence[Finding]
) -> tuple[list[Finding], tuple[str, ...]]:
    """Drop corrections that a thermal drift found later explains as well.

    Args:
        record_findings: Findings of the record corrections.
        found: Findings of the diagnosis of the corrected recording.

    Returns:
        Remaining corrections, and notes on the dropped ones.
    """
    drift = max((f.parameters["drift"].value for f in found if f.effect == THERMAL.name), default=0.0)
    remaining, notes = [], []
    for f in record_findings:
        if (THERMAL.name, THERMAL.places[0]) in f.one_of and _read_frame_shift(f) <= drift:
            notes.append(f"{f.note}: the drift that was found moves as much within a session, so no tracker is blamed")
        else:
            remaining.append(f)
    return remaining, tuple(notes)


def _read_frame_shift(f: Finding) -> float:
    """Return the translation of a moved frame, mm."""
    return float(np.linalg.norm([f.parameters[f"shift {a}"].value for a in "xyz"]))


def _compute_misfit(recording: Recording, robot: Robot, T: Array) -> float:
    whole = build_record_equations(recording, robot, T)
    return compute_typical_error(whole.error(whole.fit()))


def _compute_session_differences(recording: Recording, robot: Robot, T: Array) -> list[_SessionDifferences]:
    """Return the differences of each session to the others, last session first."""
    p, R = compute_nominal_points(recording, robot, T)
    whole = build_record_equations(recording, robot, T)
    e = whole.error(whole.fit())
    J = robot.compute_state(recording.q, T).J
    beside = p - robot.compute_fk(recording.q, T)[:, :3, 3]
    J = J[:, :3] + np.swapaxes(np.cross(np.swapaxes(J[:, 3:], 1, 2), beside[:, None]), 1, 2)
    kind = _number_reading_kinds(recording)
    out = []
    for name in np.unique(recording.session)[::-1]:
        own = recording.session == name
        both = np.intersect1d(kind[own], kind[~own])
        rows = own & np.isin(kind, both)
        if len(np.unique(recording.pose[rows])) < thresholds.COUNTS.min_comparisons:
            continue
        first = np.array([np.flatnonzero(rows & (kind == k))[0] for k in both])
        d = _average_by_kind(e, kind, rows, both) - _average_by_kind(e, kind, ~own, both)
        rise = np.nan
        if recording.temperature is not None:
            rise = float(np.mean(recording.temperature[own]) - np.mean(recording.temperature[~own]))
        out.append(
            _SessionDifferences(
                session=int(name),
                d=d,
                p=p[first],
                R=R[first],
                J=J[first],
                pose=recording.pose[first],
                temperature_rise=rise,
            )
        )
    return out


def _number_reading_kinds(recording: Recording) -> Ints:
    """Return a number (N,) for each combination of pose, reflector and load."""
    key = [recording.pose.astype(float), index_reflectors(recording).astype(float)]
    if recording.wrench is not None and recording.wrench.any():
        size = [max(float(np.abs(recording.wrench[:, a : a + 3]).max()), 1e-9) for a in (0, 3)]
        steps = recording.wrench / (thresholds.SHARES.load_tolerance * np.repeat(size, 3))
        key += list(np.round(steps).T)
    return np.unique(np.stack(key, axis=1), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _average_by_kind(e: Array, kind: Ints, rows: Flags, of: Ints) -> Array:
    """Return the mean (n, 3) of the rows of each combination."""
    at = np.searchsorted(of, kind[rows & np.isin(kind, of)])
    values = e[rows & np.isin(kind, of)]
    count = np.bincount(at, minlength=len(of))
    return np.stack([np.bincount(at, v, len(of)) / count for v in values.T], axis=1)


def _find_explanation(of: _SessionDifferences) -> _SessionExplanation | None:
    """Return the cause that leaves the smallest penalised residual; None for noise and for physical effects."""
    load, left, x = np.ones(len(of.d)), {}, {}
    for cause, A in of.columns().items():
        x[cause] = fit_least_absolute_deviations(A, of.d, load)
        e = of.d - A @ x[cause]
        left[cause] = e, float(np.abs(e).mean()) * e.size / max(e.size - A.shape[2], 1)
    plain = float(np.abs(of.d).mean())
    single = min((c for c in left if c.kind is _ChangeKind.ENCODER), key=lambda c: left[c][1])
    order = [single, SHIFT, TARGET, FRAME]  # fewest parameters first
    best = min(order, key=lambda c: left[c][1])
    best = next(c for c in order if left[c][1] < thresholds.RATIOS.equal_fit * left[best][1])
    if left[best][1] > thresholds.SHARES.majority * plain:
        return None
    warm = left[HEAT][1] < thresholds.RATIOS.equal_fit * left[best][1]
    shift_alone = best == SHIFT
    if warm and (not shift_alone or abs(of.temperature_rise) > thresholds.LIMITS.temperature_rise):
        return None
    taken = FRAME if shift_alone else best
    return _SessionExplanation(taken, x[taken], of, left[best][0], shift_alone)


def _apply_explanation(recording: Recording, robot: Robot, T: Array, t: _SessionExplanation) -> Recording:
    rows = recording.session == t.differences.session
    assert recording.position is not None  # checked by the caller
    if t.cause.kind is _ChangeKind.ENCODER:
        q = recording.q.copy()
        q[rows, t.cause.joint] += t.x[0]  # d = J x: the true joint angle is larger by x
        return replace(recording, q=q)
    position = recording.position.copy()
    if t.cause == TARGET:
        _, R = compute_nominal_points(recording, robot, T)
        position[rows] -= R[rows] @ t.x
        return replace(recording, position=position)
    if recording.registration == "fit":  # the frame is an unknown of the base model
        return replace(recording, frame=_label_own_frame(recording, rows))
    middle = t.differences.p.mean(axis=0)
    turn = convert_vector_to_rotation(t.x[3:])
    position[rows] = (position[rows] - middle - t.x[:3]) @ turn + middle
    return replace(recording, position=position)


def _label_own_frame(recording: Recording, rows: Flags) -> Ints:
    """Return frame labels (N,) in which ``rows`` have a frame of their own."""
    of = recording.session if recording.frame is None else recording.frame
    old = np.full(len(rows), int(of[~rows].min())) if recording.frame is None else recording.frame
    new = int(of[rows].min()) if recording.frame is None else int(old.max()) + 1
    return np.where(rows, new, old).astype(np.int64)


def _build_change_finding(t: _SessionExplanation) -> Finding:
    effect, where = t.cause.effect
    sizes: Mapping[str, EstimatedValue]
    if t.cause.kind is _ChangeKind.ENCODER:
        off = float(np.degrees(t.x[0]))
        what = f"{t.cause.column} reads {abs(off):.4f}° too {'little' if off > 0 else 'much'}"
        sizes = {"offset": build_exact_estimate(-off, "deg")}
    elif t.cause == TARGET:
        at = 1e3 * t.x
        what = f"the reflector sat ({_format_vector(at)}) mm in the flange from where it sat in the other sessions"
        sizes = {f"shift {a}": build_exact_estimate(float(v), "mm") for a, v in zip("xyz", at, strict=True)}
    else:
        shift, turn = 1e3 * t.x[:3], 1e3 * t.x[3:]
        what = (
            f"the tracker's frame lies ({_format_vector(shift)}) mm about the middle of the points and "
            f"({_format_vector(turn)}) mrad "
            "from where it lay in the other sessions"
        )
        sizes = {
            "angle": build_exact_estimate(float(np.degrees(np.linalg.norm(t.x[3:]))), "deg"),
            **{f"shift {a}": build_exact_estimate(float(v), "mm") for a, v in zip("xyz", shift, strict=True)},
        }
    words = (
        f"session {t.differences.session}: {what}, by the poses that they share; "
        "it was read that way, and no physics or noise made of it"
    )
    if t.shift_alone:
        words += "; a base that is warmer would look the same"
    before, after = (np.linalg.norm(v, axis=1) for v in (t.differences.d, t.remaining_difference))
    finding = build_record_finding(
        effect,
        where,
        words,
        1e3 * compute_typical_error(t.differences.d),
        1e3 * compute_typical_error(t.remaining_difference),
        compute_sign_test(t.differences.pose, before, after),
        {**sizes, "session": build_exact_estimate(float(t.differences.session))},
        stated={"message": words, "session": t.differences.session},
    )
    warmth = ((THERMAL.name, THERMAL.places[0]),) if t.shift_alone else ()
    return replace(finding, one_of=(*finding.one_of, *warmth))


def _format_vector(values: Array) -> str:
    return ", ".join(f"{v:.3f}" for v in values)

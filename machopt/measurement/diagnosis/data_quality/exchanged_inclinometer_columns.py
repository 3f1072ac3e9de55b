"""Inclinometer columns that are exchanged, reversed or in another unit, and their correction.

Gravity tilts a compliant base in the direction of the load. The tilt is C m with C symmetric positive semidefinite
and m the moment of all weights about the base. A link behind joints adds the deflection of these joints. Exchanged
columns give a C with one negative eigenvalue, reversed columns a negative C. No measured poses are needed to detect
this. The unit is detected with them: a rotating base moves the measured points in proportion to its rotation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS, UNITS
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding, compute_rms
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.effect_columns.structural_compliance import compute_weight_wrench
from machopt.measurement.diagnosis.static import inclinometer_equations
from machopt.measurement.diagnosis.static.measured_pose_model import NominalPoseModel
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
TILT_COLUMN = "tilt_x_mrad"
DIRECTIONS = 12  # directions u of the parametrisation C = Σ c u uᵀ, c ≥ 0


@dataclass(frozen=True, kw_only=True)
class _TiltEvidence:
    """Inclinometer readings and their possible causes, n readings, each session relative to its own mean."""

    y: Array  # (n, 2) rad
    sag: Array  # (n, 2) rad, deflection of the joints up to the link
    moment: Array  # (n, 2) N·m about the base
    rocking: Array  # (n, 2) rad, base rotation by the measured poses
    is_shown_by_points: bool  # the measured poses determine the base rotation
    pose: NDArray[np.int64]

    def columns(self) -> Array:
        """Return the columns (2 n, P) of non-negative coefficients."""
        angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        u = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rays = np.einsum("ka,kb,nb->nak", u, u, self.moment)
        return np.concatenate([rays, self.sag[:, :, None]], axis=2).reshape(self.y.size, -1)

    def error(self, y: Array) -> tuple[Array, float]:
        """Return the tilt that gravity does not explain and the share of joint deflection.

        Args:
            y: (n, 2) tilt, rad.

        Returns:
            (n, 2) residual in rad, and the fitted coefficient of the joint deflection.
        """
        A = self.columns()
        size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        x = nnls(A / size, y.reshape(-1))[0] / size
        return y - (A @ x).reshape(y.shape), float(x[-1])


def correct_inclinometer_columns(
    recording: Recording, cell: Cell, robot: Robot, masses: RobotMasses | None, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct exchanged, reversed or wrongly scaled inclinometer columns if the evidence is unambiguous.

    Args:
        recording: Recording of measured poses with correct positions.
        cell: Robot cell.
        robot: Kinematic model of the arm.
        masses: Link and tool masses; without them nothing is corrected.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    if recording.kind != "absolute" or masses is None:
        return recording, []
    inclined = inclinometer_equations.find_inclinometer(recording, cell)
    if inclined is None or recording.tilt is None:
        return recording, []
    rows = np.asarray(inclined.present.all(axis=1))
    if rows.sum() < thresholds.COUNTS.min_groups:
        return recording, []
    model = NominalPoseModel(recording, cell, robot, masses, frozenset())
    seen = _collect_tilt_evidence(model, inclined.link, rows)
    out: list[Finding] = []
    if COLUMNS.name not in accept:
        way = _find_column_assignment(seen)
        if way is not None:
            words, read = way
            out.append(
                _build_tilt_finding(seen, read(seen.y), f"{words}, so weight would tilt its support the wrong way")
            )
            seen = replace(seen, y=read(seen.y))
            recording = _apply_assignment(recording, rows, read)
    factor = 1.0 if UNITS.name in accept else _find_unit_factor(seen)
    if factor != 1.0:
        name = next(n for n, f in inclinometer_equations.UNITS.items() if f == factor)
        words = f"{TILT_COLUMN}, tilt_y_mrad hold {name} by what weight does to joints and points"
        out.append(_build_tilt_finding(seen, seen.y / factor, words, factor))
        recording = _apply_assignment(recording, rows, lambda t: t / factor)
    return recording, out


def _collect_tilt_evidence(model: NominalPoseModel, link: int, rows: Flags) -> _TiltEvidence:
    recording = model.recording
    assert recording.tilt is not None  # checked by the caller
    first = model.fit_base()
    state, p, R = model.predict(first)
    assert model.masses is not None
    r = model.build_readings(state, first, first.compliance)
    w = compute_weight_wrench(r, model.masses.body >= 1)
    moment = w[:, 3:] + np.cross(state.T_base_tool[:, :3, 3], w[:, :3])
    rocking, shown = _estimate_base_rotation(
        model, model.residual(first, p, R)[:, :3], model.columns(state, p)[0][:, :3], p, moment
    )
    session = np.unique(recording.session[rows], return_inverse=True)[1].reshape(-1)

    def apart(values: Array) -> Array:
        v = values[rows][:, :2]
        mean = np.stack([np.bincount(session, c) for c in v.T], axis=1) / np.bincount(session)[:, None]
        return np.asarray(v - mean[session])

    sag = inclinometer_equations.compute_link_sag(model, state, link)
    return _TiltEvidence(
        y=apart(recording.tilt),
        sag=apart(sag),
        moment=apart(moment),
        rocking=apart(rocking),
        is_shown_by_points=shown,
        pose=recording.pose[rows].astype(np.int64),
    )


def _estimate_base_rotation(
    model: NominalPoseModel, e: Array, base: Array, p: Array, moment: Array
) -> tuple[Array, bool]:
    """Return the rotation (N, 2) rad of the base by the measured points, fitted together with the base unknowns."""
    turns = np.zeros((len(p), 3, 3))  # by c_xx, c_xy, c_yy
    turns[:, 0, 0] = moment[:, 0]
    turns[:, 0, 1], turns[:, 1, 1] = moment[:, 1], moment[:, 0]
    turns[:, 1, 2] = moment[:, 1]
    moved = np.cross(turns, p[:, :, None], axisa=1, axisb=1, axisc=1)
    A = np.concatenate([base, moved], axis=2).reshape(e.size, -1)
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    x, *_ = np.linalg.lstsq(A / size, e.reshape(-1), rcond=1e-9)
    without, *_ = np.linalg.lstsq(A[:, :-3] / size[:-3], e.reshape(-1), rcond=1e-9)
    left = float(np.linalg.norm(e.reshape(-1) - A / size @ x))
    more = float(np.linalg.norm(e.reshape(-1) - A[:, :-3] / size[:-3] @ without))
    return np.einsum("nck,k->nc", turns, (x / size)[-3:]), left < thresholds.SHARES.agreement * more


def _find_column_assignment(tilt_evidence: _TiltEvidence) -> tuple[str, inclinometer_equations.ColumnAssignment] | None:
    """Return the alternative column assignment that gravity explains; None if the stated one holds or none is
    certain.
    """
    size = compute_rms(tilt_evidence.y)
    stated = compute_rms(tilt_evidence.error(tilt_evidence.y)[0]) / max(size, 1e-300)
    if stated < thresholds.SHARES.majority:
        return None
    found = []
    for words, read in _list_column_assignments():
        found.append((compute_rms(tilt_evidence.error(read(tilt_evidence.y))[0]) / max(size, 1e-300), words, read))
    found.sort(key=lambda f: f[0])
    (best, words, read), (second, *_) = found[:2]
    if best > thresholds.SHARES.majority * stated or second < thresholds.RATIOS.equal_fit * best:
        return None
    return words, read


def _list_column_assignments() -> Iterator[tuple[str, inclinometer_equations.ColumnAssignment]]:
    for exchanged in (False, True):
        for x, y in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            if not exchanged and x == y == 1:
                continue
            names = [n for n, s in ((TILT_COLUMN, x), ("tilt_y_mrad", y)) if s < 0]
            signs = f"{' and '.join(names)} reversed" if names else ""
            words = " and ".join(
                w for w in (f"{TILT_COLUMN} and tilt_y_mrad exchanged" if exchanged else "", signs) if w
            )
            sign = np.array([x, y], float)
            yield words, lambda t, e=exchanged, s=sign: (t * s)[:, ::-1] if e else t * s  # type: ignore[misc]


def _find_unit_factor(tilt_evidence: _TiltEvidence) -> float:
    """Return the factor of a wrong unit; 1 if mrad fits as well as any other unit."""
    whole = tilt_evidence.sag + (tilt_evidence.rocking if tilt_evidence.is_shown_by_points else 0.0)
    if compute_rms(whole) < thresholds.LIMITS.reading_step * (1.0 if tilt_evidence.is_shown_by_points else 2.0):
        return 1.0
    slope = float(np.sum(whole * tilt_evidence.y) / np.sum(whole**2))
    alike = float(np.sum(whole * tilt_evidence.y)) / max(
        float(np.linalg.norm(whole) * np.linalg.norm(tilt_evidence.y)), 1e-300
    )
    if slope <= 0.0 or alike < thresholds.SHARES.half_power_amplitude:
        return 1.0
    factors = (1.0, *inclinometer_equations.UNITS.values())
    return min(factors, key=lambda f: abs(np.log(slope / f)))


def _apply_assignment(recording: Recording, rows: Flags, read: inclinometer_equations.ColumnAssignment) -> Recording:
    assert recording.tilt is not None  # checked by the caller
    tilt = recording.tilt.copy()
    tilt[rows] = read(tilt[rows])
    return replace(recording, tilt=tilt)


def _build_tilt_finding(tilt_evidence: _TiltEvidence, read: Array, words: str, factor: float = 1.0) -> Finding:
    before, after = (
        np.linalg.norm(tilt_evidence.error(v)[0], axis=1) / max(compute_rms(v), 1e-300) for v in (tilt_evidence.y, read)
    )
    words = f"{words}; they were read right"
    return build_record_finding(
        COLUMNS.name if factor == 1.0 else UNITS.name,
        format_column_location(TILT_COLUMN),
        words,
        np.nan,
        np.nan,
        compute_sign_test(tilt_evidence.pose, before, after) if factor == 1.0 else 0.0,
        {} if factor == 1.0 else {"factor": build_exact_estimate(factor)},
    )

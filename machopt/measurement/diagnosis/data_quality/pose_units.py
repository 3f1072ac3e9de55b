"""Units of measured poses, of the whole recording or of single sessions: joint angles (all or one), and point
coordinates.

Each session is compared with forward kinematics separately, with its own tracker frame (where free) and reflectors.
No session affects another and no frame needs to be known: a point cloud of wrong size or shape fits no frame. Only
common wrong units are tried. A unit is accepted if it removes nearly all of the misfit.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import ANGLES, LENGTHS, UNITS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.correction_candidates import replace_rows, select_rows
from machopt.measurement.diagnosis.data_quality.session_corrections import build_record_equations, compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import register_positions

Flags = NDArray[np.bool_]
HEADS = {"q": "q1_deg", "position": "x_mm"}
MOST = 400  # most readings used per session: a wrong unit is visible in a few


@dataclass(frozen=True)
class _UnitReading:
    """Units assumed for a part of a recording; factor 1 is the stated unit."""

    names: dict[str, str]  # unit by field; empty: as stated
    factors: dict[str, float]
    joint: int | None = None  # 0-based, if only this joint is in another unit; None: all joints

    def apply(self, r: Recording) -> Recording:
        """Return the recording converted to the stated units.

        Args:
            r: Recording in the assumed units.

        Returns:
            The converted recording.
        """
        assert r.position is not None  # checked by the caller
        joints = np.arange(r.q.shape[1])
        is_unchanged = (
            joints != self.joint if self.joint is not None else np.array(r.prismatic or (False,) * len(joints))
        )
        q = np.where(is_unchanged, r.q, r.q * self.factors["q"])
        return replace(r, q=q, position=r.position * self.factors["position"])

    def find_first_column(self, field: str) -> str:
        """Return the first column of a field.

        Args:
            field: ``q`` or ``position``.

        Returns:
            Column name.
        """
        if field != "q" or self.joint is None:
            return HEADS[field]
        return f"q{self.joint + 1}_{'mm' if self.names['q'] in LENGTHS else 'deg'}"


STATED = _UnitReading(dict.fromkeys(HEADS, ""), dict.fromkeys(HEADS, 1))


def correct_pose_units(
    recording: Recording, robot: Robot, T_flange_tcp: np.ndarray, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Convert sessions that were recorded in other units.

    Args:
        recording: Recording of any kind; only measured poses are checked.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording in the stated units, and a finding for each column group and unit.
    """
    if recording.kind != "absolute" or recording.position is None or "units" in accept:
        return recording, []
    parts: dict[int, tuple[_UnitReading, NDArray[np.float64], NDArray[np.float64]]] = {}
    sessions = np.unique(recording.session)
    for name in sessions:
        found = _find_best_units(
            _select_few_readings(select_rows(recording, recording.session == name)), robot, T_flange_tcp
        )
        if found is not None:
            parts[int(name)] = found
    out, findings = recording, []
    for field in HEADS:
        kinds = ((way.names[field], way.find_first_column(field)) for way, _, _ in parts.values() if way.names[field])
        for unit, head in dict.fromkeys(kinds):
            hit = [
                n
                for n, (way, _, _) in parts.items()
                if (way.names[field], way.find_first_column(field)) == (unit, head)
            ]
            findings.append(_build_unit_finding(field, unit, hit, len(sessions), parts))
    for name, (way, _, _) in parts.items():
        rows = recording.session == name
        out = replace_rows(out, way.apply(select_rows(out, rows)), rows)
    return out, findings


def _select_few_readings(part: Recording) -> Recording:
    n = len(part)
    if n <= MOST:
        return part
    rows = np.zeros(n, bool)
    rows[np.linspace(0, n - 1, MOST).astype(int)] = True
    return select_rows(part, rows)


def _find_best_units(
    part: Recording, robot: Robot, T: np.ndarray
) -> tuple[_UnitReading, NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the units of a session and the misfits (G,) of its poses before and after; None if the stated units
    hold.
    """
    if len(np.unique(part.pose)) < thresholds.COUNTS.min_comparisons:
        return None
    as_stated, spread = _compute_pose_errors(part, STATED, robot, T)
    stated = float(np.median(as_stated)) / spread
    if stated < thresholds.SHARES.pose_misfit:
        return None
    ways = [*_list_unit_readings(), *_list_single_joint_units(part)]
    tried = [(way, *_compute_pose_errors(part, way, robot, T)) for way in ways]
    tried.sort(key=lambda w: float(np.median(w[1])) / w[2])
    way, errors, _ = tried[0]
    best, second = (float(np.median(e)) / s for _, e, s in tried[:2])
    if best > thresholds.SHARES.relevant * stated or best > thresholds.SHARES.minority * second:
        return None  # no certain alternative
    pose = np.unique(part.pose, return_inverse=True)[1].reshape(-1)
    by_pose = [np.array([np.median(e[pose == g]) for g in range(int(pose.max()) + 1)]) for e in (as_stated, errors)]
    return way, by_pose[0], by_pose[1]


def _list_unit_readings() -> Iterator[_UnitReading]:
    for angle, a in {"": 1.0, **ANGLES}.items():
        for length, f in {"": 1.0, **LENGTHS}.items():
            if angle or length:
                yield _UnitReading({"q": angle, "position": length}, {"q": a, "position": f})


def _list_single_joint_units(part: Recording) -> Iterator[_UnitReading]:
    """Yield units in which a single joint column differs from the others."""
    for j in range(part.q.shape[1]):
        slides = bool(part.prismatic) and part.prismatic[j]
        for unit, factor in (LENGTHS if slides else ANGLES).items():
            yield _UnitReading({"q": unit, "position": ""}, {"q": factor, "position": 1.0}, j)


def _compute_pose_errors(
    part: Recording, way: _UnitReading, robot: Robot, T: np.ndarray
) -> tuple[NDArray[np.float64], float]:
    """Return residuals (n,) m after fitting frame and reflectors, and the spread of the points in m.

    The spread guards against tiny point clouds, which fit anything. It is infinite for points without spread.
    """
    read = way.apply(part)
    e = build_record_equations(register_positions(read, robot, T), robot, T)
    assert read.position is not None  # checked by the caller
    spread = float(np.median(np.linalg.norm(read.position - np.median(read.position, axis=0), axis=1)))
    return np.asarray(np.linalg.norm(e.error(e.fit()), axis=1)), spread or np.inf


def _build_unit_finding(
    field: str,
    unit: str,
    hit: list[int],
    sessions: int,
    parts: dict[int, tuple[_UnitReading, NDArray[np.float64], NDArray[np.float64]]],
) -> Finding:
    before, after = (np.concatenate([parts[n][k] for n in hit]) for k in (1, 2))
    way = parts[hit[0]][0]
    head, factor, lone = way.find_first_column(field), way.factors[field], field == "q" and way.joint is not None
    some = len(hit) < sessions
    where = f"session{'s' if len(hit) > 1 else ''} {', '.join(str(n) for n in hit)}: " if some else ""
    words = (
        f"{where}the column {head} holds {unit}; so read it fits the arm, and it was read that way"
        if lone
        else f"{where}the columns {head} … hold {unit}; so read they fit the arm, and they were read that way"
    )
    session = {"session": build_exact_estimate(float(hit[0]))} if some and len(hit) == 1 else {}
    return build_record_finding(
        UNITS.name,
        format_column_location(head),
        words,
        1e3 * float(np.median(before)),
        1e3 * float(np.median(after)),
        compute_sign_test(np.arange(len(before)), before, after),
        {"factor": build_exact_estimate(1.0 / factor), **session},
        stated={"message": words, **({"session": hit[0]} if session else {})},
    )

"""Joint angles in another convention than that of the URDF.

A controller may count joint 3 against the horizontal, so that q3 = J3 ± J2; zero positions may be quarter or half turns
away; joints may turn the other way. Every convention is linear, q = M q_recorded + z. Any combination of up to four
joints is searched, and the ``joint_map`` of the cell. Poses are compared with forward kinematics, with tracker frame
and reflectors fitted; load tests with joint springs. A convention is accepted where its evidence is very strong with
its choices counted, where it removes most of the misfit, and where no other convention does nearly as well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.robot_program import JointMap
from machopt.effects.recording.record_faults import COLUMNS
from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.convention_fits import (
    ConventionFit,
    build_load_test_fit,
    build_pose_fit,
)
from machopt.measurement.diagnosis.data_quality.correction_candidates import select_rows
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_record_finding
from machopt.numerics.array_types import Array

MOST = {"absolute": 400, "deflection": 160}  # most readings used: a convention shows in a few
ZERO_TURNS = (90.0, -90.0, 180.0)  # degrees by which zero positions of conventions differ
SIGNED_PERMUTATIONS = 48  # ways to write three axes
COUPLED, COUPLING = 2, 1  # joints (0-based) of which a pendant may count the first against the horizontal
DEEPEST, WIDTH = 4, 8  # most joints in another convention; conventions that each step of the search keeps


@dataclass(frozen=True)
class JointConvention:
    """One way to understand the joint columns: q = M q_recorded + z."""

    M: Array  # (n, n)
    z: Array  # (n,) rad
    words: tuple[tuple[int, str], ...] = ()  # joint (0-based) and what its column holds
    stated: bool = False  # the cell's joint_map states it

    def apply(self, q: Array) -> Array:
        """Return joint angles as the URDF counts them.

        Args:
            q: (N, n) rad as recorded.
        """
        return np.asarray(q @ self.M.T + self.z)

    @property
    def changes(self) -> int:
        """Number of choices that nobody stated."""
        return 0 if self.stated else len(self.words)


@dataclass(frozen=True)
class _TestedConvention:
    convention: JointConvention
    fit: ConventionFit

    @property
    def cost(self) -> float:
        """−2 log evidence."""
        choices = len(list_single_conventions(len(self.convention.z)))
        return self.fit.cost + 2.0 * self.convention.changes * float(np.log(choices))


def correct_joint_convention(
    recording: Recording,
    robot: Robot,
    T_flange_tcp: Array,
    accept: Collection[str] = (),
    joint_map: JointMap | None = None,
) -> tuple[Recording, list[Finding]]:
    """Convert joint angles that are recorded in another convention.

    Args:
        recording: Recording of any kind; measured poses and load tests of six revolute joints are checked.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.
        joint_map: Map from URDF to controller angles that the cell states; None if it states none.

    Returns:
        The recording in the convention of the URDF, and a finding if it was converted.

    Raises:
        RecordingError: The joint angles fit in several conventions equally well, and not as stated.
    """
    if COLUMNS.name in accept or any(recording.prismatic) or recording.q.shape[1] != len(robot.axis):
        return recording, []
    part = _select_few_used_readings(recording)
    test = _choose_fit(part, robot, T_flange_tcp)
    if test is None:
        return recording, []
    stated = _TestedConvention(_build_identity(part.q.shape[1]), test(part.q))
    if not stated.fit.is_doubtful:
        return recording, []
    tried = _search_conventions(part.q, test, stated, joint_map)
    best = tried[0]
    if not _is_accepted(stated, best) or _is_mirrored(part, robot, T_flange_tcp, best):
        return recording, []
    rivals = [t for t in tried[1:] if t.cost - best.cost < thresholds.LEVELS.min_evidence and not _is_same(t, best)]
    if rivals:
        raise RecordingError(
            f"joint angles do not fit the arm as stated; they fit where {_describe(best)}, and as well where "
            f"{_describe(rivals[0])}. Which convention holds? Write q1_deg … as the URDF counts them",
            file=recording.source,
        )
    column = f"q{best.convention.words[0][0] + 1}_deg"
    words = f"{_describe(best)}; so read the readings fit the arm, and they were read that way"
    finding = build_record_finding(
        COLUMNS.name,
        format_column_location(column),
        words,
        1e3 * stated.fit.mean_error,
        1e3 * best.fit.mean_error,
        compute_sign_test(np.arange(len(stated.fit.error)), stated.fit.error, best.fit.error),
    )
    return replace(recording, q=best.convention.apply(recording.q)), [finding]


@cache
def list_single_conventions(joints: int) -> tuple[JointConvention, ...]:
    """List the conventions that differ from the URDF in one joint.

    Args:
        joints: Number of joints.
    """
    out = []
    if joints > COUPLED:
        for sign, text in ((1.0, "+"), (-1.0, "−")):
            for own in (1.0, -1.0):
                row = np.zeros(joints)
                row[COUPLED], row[COUPLING] = own, sign
                words = f"counts joint 3 against the horizontal: q3 = {'−' if own < 0 else ''}J3 {text} J2"
                out.append(_build_single(joints, COUPLED, row, 0.0, words))
                for zero in ZERO_TURNS:
                    away = f"{words}, from a zero {zero:g}° away"
                    out.append(_build_single(joints, COUPLED, row, np.radians(zero), away))
    for j in range(joints):
        row = np.zeros(joints)
        row[j] = 1.0
        out.append(_build_single(joints, j, -row, 0.0, "has the other sign"))
        for sign in (1.0, -1.0):
            for zero in ZERO_TURNS:
                words = f"{'has the other sign and ' if sign < 0 else ''}counts from a zero {zero:g}° away"
                out.append(_build_single(joints, j, sign * row, np.radians(zero), words))
    return tuple(out)


def convert_joint_map(joint_map: JointMap) -> JointConvention:
    """Return the convention of the controller that a cell states.

    Args:
        joint_map: Map from joint positions of the URDF to the controller's axis angles.
    """
    inverse = np.linalg.inv(np.eye(len(joint_map.sign)) + joint_map.coupling)
    M = joint_map.sign[:, None] * inverse
    z = -joint_map.sign * np.radians(joint_map.offset_deg)
    identity = np.eye(len(M))
    changed = [j for j in range(len(M)) if not np.allclose(M[j], identity[j]) or abs(z[j]) > 0]
    words = tuple((j, "counts as the controller does (joint_map of the cell)") for j in changed)
    return JointConvention(M, z, words, stated=True)


def _build_identity(joints: int) -> JointConvention:
    return JointConvention(np.eye(joints), np.zeros(joints))


def _build_single(joints: int, joint: int, row: Array, zero: float, words: str) -> JointConvention:
    M, z = np.eye(joints), np.zeros(joints)
    M[joint], z[joint] = row, zero
    return JointConvention(M, z, ((joint, words),))


def _combine(one: JointConvention, other: JointConvention) -> JointConvention | None:
    """Return a convention with one more joint in another convention; None if that joint has one already."""
    (joint, _), *_ = other.words
    if any(j == joint for j, _ in one.words):
        return None
    M, z = one.M.copy(), one.z.copy()
    M[joint], z[joint] = other.M[joint], other.z[joint]
    return JointConvention(M, z, tuple(sorted((*one.words, *other.words))))


def _search_conventions(
    q: Array, test: Callable[[Array], ConventionFit], stated: _TestedConvention, joint_map: JointMap | None
) -> list[_TestedConvention]:
    """Return tested conventions, best first: combinations are built joint by joint from the best so far."""
    singles = list_single_conventions(q.shape[1])
    tried: dict[bytes, _TestedConvention] = {}
    if joint_map is not None and q.shape[1] == len(joint_map.sign):
        one = convert_joint_map(joint_map)
        if one.words:
            tried[_key(one)] = _TestedConvention(one, test(one.apply(q)))
            if _is_accepted(stated, tried[_key(one)]):
                return [*tried.values()]
    front = [stated]
    for depth in range(DEEPEST):
        new: dict[bytes, _TestedConvention] = {}
        for start in front:
            for single in singles:
                both = _combine(start.convention, single)
                if both is not None and _key(both) not in tried and _key(both) not in new:
                    new[_key(both)] = _TestedConvention(both, test(both.apply(q)))
        before = min((t.cost for t in tried.values()), default=np.inf)
        tried |= new
        front = sorted(new.values(), key=lambda t: t.cost)[:WIDTH]
        if depth > 0 and front[0].cost > before:
            break
    return sorted(tried.values(), key=lambda t: t.cost)


def _key(c: JointConvention) -> bytes:
    return np.round(np.concatenate([c.M.ravel(), c.z]), 6).tobytes() + bytes([c.stated])


def _is_accepted(stated: _TestedConvention, best: _TestedConvention) -> bool:
    """Return whether a convention is very strongly better, and leaves little of the misfit."""
    if best.cost > stated.cost - thresholds.LEVELS.min_evidence:
        return False
    return best.fit.mean_error < best.fit.falls * stated.fit.mean_error or (
        stated.fit.is_point_misplaced and not best.fit.is_point_misplaced
    )


def _is_mirrored(part: Recording, robot: Robot, T: Array, best: _TestedConvention) -> bool:
    """Return whether left-handed axes of the positions explain poses in fewer words than the joints do.

    An arm that is mirrored at its middle plane is the arm with the signs of joints 1, 4 and 6 changed.
    """
    if part.kind != "absolute" or part.position is None:
        return False
    for axis in range(3):
        mirror = np.ones(3)
        mirror[axis] = -1.0
        fit = build_pose_fit(replace(part, position=part.position * mirror), robot, T)(part.q)
        if fit.cost + 2.0 * float(np.log(SIGNED_PERMUTATIONS)) < best.cost + thresholds.LEVELS.min_evidence:
            return True
    return False


def _is_same(one: _TestedConvention, other: _TestedConvention) -> bool:
    """Return whether two conventions differ by a turn of the tracker or of the reflectors only."""
    apart = float(np.mean(np.abs(one.fit.error - other.fit.error)))
    return apart < thresholds.SHARES.minority * other.fit.mean_error


def _describe(t: _TestedConvention) -> str:
    return "; ".join(f"q{j + 1}_deg {text}" for j, text in t.convention.words)


def _select_few_used_readings(recording: Recording) -> Recording:
    rows = np.ones(len(recording), bool) if recording.used is None else recording.used.copy()
    there = np.flatnonzero(rows)
    most = MOST.get(recording.kind, 0)
    if len(there) > most:
        rows[:] = False
        rows[there[np.linspace(0, len(there) - 1, most).astype(int)]] = True
    return select_rows(recording, rows)


def _choose_fit(part: Recording, robot: Robot, T: Array) -> Callable[[Array], ConventionFit] | None:
    """Return the fit of a kind of recording; None if it does not depend on conventions."""
    if len(np.unique(part.pose)) < thresholds.COUNTS.min_comparisons:
        return None
    if part.kind == "absolute" and part.position is not None:
        return build_pose_fit(part, robot, T)
    if part.kind == "deflection" and part.wrench is not None and part.displacement is not None:
        return build_load_test_fit(part, robot, T) if part.wrench.any() and part.displacement.any() else None
    return None

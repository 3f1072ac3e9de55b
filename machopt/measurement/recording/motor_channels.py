"""Motor-side channels: currents and motor angles, converted to the joints by keys of recording.yaml.

θ = C m with C = diag(1/ratio) or the coupling matrix. Motor torques are Cᵀ times joint torques; joint torques are C⁻ᵀ
times motor torques.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.measurements.recording import RecordingKind
from machopt.file_formats.strict_yaml import YamlDocument
from machopt.measurement.recording.recording_columns import Prismatic
from machopt.measurement.recording.recording_table import RecordingTable
from machopt.numerics.array_types import Array

GAIN, RATIO, COUPLING = "motor_gain_Nm_per_A", "gear_ratio", "coupling_matrix"
SAME = np.radians(2e-3)  # tolerance between joint and motor columns: printed digits and a delay of one sample
SINGULAR = 1e12  # condition number of a coupling matrix that counts as singular


@dataclass(frozen=True)
class MotorProperties:
    """Stated properties of the motors of n joints."""

    gain: Array | None  # (n,) N·m/A at the motor shaft
    to_joints: Array | None  # (n, n) C, joint angles per motor angles, rad/rad


def parse_motor_keys(
    document: YamlDocument, gain: object, ratio: object, coupling: object, kind: RecordingKind
) -> MotorProperties:
    """Parse and check the motor keys of recording.yaml.

    Args:
        document: The file recording.yaml, for error messages.
        gain: Value of ``motor_gain_Nm_per_A``.
        ratio: Value of ``gear_ratio``.
        coupling: Value of ``coupling_matrix``.
        kind: Kind of the recording.

    Returns:
        The properties of the motors.

    Raises:
        InputError: Another kind of recording, invalid numbers, or both a ratio and a coupling matrix.
    """
    given = {GAIN: gain, RATIO: ratio, COUPLING: coupling}
    key = next((k for k, v in given.items() if v is not None), None)
    if key is not None and kind != "motion":
        raise document.build_error((key,), f"belongs to recordings of kind motion; found {kind}")
    if ratio is not None and coupling is not None:
        raise document.build_error((COUPLING,), f"is given beside {RATIO}; both state how motors turn joints, keep one")
    gains, ratios = (None if given[k] is None else _parse_row(document, k, given[k]) for k in (GAIN, RATIO))
    if gains is not None and ratios is None and coupling is None:
        raise document.build_error((GAIN,), f"needs {RATIO} or {COUPLING}: joint torque is current × gain × ratio")
    if ratios is not None:
        return MotorProperties(gains, np.diag(1.0 / ratios))
    if coupling is None:
        return MotorProperties(gains, None)
    rows = (
        [_parse_numbers(document, (COUPLING, i), r) for i, r in enumerate(coupling)]
        if isinstance(coupling, list)
        else []
    )
    if not rows or any(len(r) != len(rows) for r in rows):
        raise document.build_error(
            (COUPLING,), "expected a square matrix, a row a joint: joint angles per motor angles"
        )
    C = np.array(rows)
    if np.linalg.cond(C) > SINGULAR:
        raise document.build_error((COUPLING,), "is singular: some motor turns no joint")
    return MotorProperties(gains, C)


def list_motor_columns(count: int) -> tuple[str, ...]:
    """List the columns of motor angles.

    Args:
        count: Number of motors.

    Returns:
        Column names.
    """
    return tuple(f"motor{i}_deg" for i in range(1, count + 1))


def compute_joint_angles(table: RecordingTable, motors: MotorProperties, prismatic: Prismatic) -> Array | None:
    """Compute joint angles from motor angles.

    Args:
        table: Table of one data file.
        motors: Properties of the motors.
        prismatic: For each joint, whether it is prismatic.

    Returns:
        (N, n) rad; None without columns ``motor1_deg`` ….

    Raises:
        InputError: No gear ratio, missing columns, or a prismatic joint.
    """
    have = [n for n in table.numbers if n.startswith("motor")]
    if not have:
        return None
    wanted = list_motor_columns(len(prismatic))
    missing = [n for n in wanted if n not in have]
    if missing or len(have) > len(wanted):
        raise table.build_error(f"found columns {', '.join(have)}; expected {wanted[0]} … {wanted[-1]}, one a joint")
    if motors.to_joints is None:
        raise table.build_error(f"column {have[0]} needs {RATIO} or {COUPLING} in recording.yaml")
    _refuse_count(table, len(motors.to_joints), prismatic)
    return np.asarray(np.radians(np.stack([table.numbers[n] for n in wanted], axis=1)) @ motors.to_joints.T)


def check_motor_angles(table: RecordingTable, q: Array, by_motors: Array | None) -> list[str]:
    """Check motor angles against the columns of the joints.

    Args:
        table: Table of one data file.
        q: (N, n) joint angles of their own columns, rad.
        by_motors: (N, n) joint angles computed from the motors, rad; None without motor columns.

    Returns:
        Warnings.

    Raises:
        InputError: They differ by more than a constant.
    """
    if by_motors is None:
        return []
    off = (q - by_motors) - np.median(q - by_motors, axis=0)
    worst = int(np.abs(off).max(axis=0).argmax())
    if np.abs(off).max() > SAME:
        row = int(np.abs(off[:, worst]).argmax())
        raise table.build_error(
            f"q{worst + 1}_deg and what the motors make of joint {worst + 1} drift {np.degrees(off[row, worst]):.3g}° "
            f"apart: another {RATIO} or a {COUPLING}, or q{worst + 1}_deg is of an encoder behind the gear, which is "
            f"qse{worst + 1}_deg (and q{worst + 1}_deg the motors' value)",
            row,
            f"motor{worst + 1}_deg",
        )
    return [f"{table.path.name}: motor1_deg … say what q1_deg … say; the joints' columns are used"]


def compute_joint_torque(
    table: RecordingTable, motors: MotorProperties, current: Array | None, prismatic: Prismatic
) -> Array | None:
    """Compute joint torques from motor currents.

    Args:
        table: Table of one data file.
        motors: Properties of the motors.
        current: (N, n) motor currents, A; None without currents.
        prismatic: For each joint, whether it is prismatic.

    Returns:
        (N, n) N·m; None if no gain is stated.

    Raises:
        InputError: A gain without currents, or for another number of joints.
    """
    if motors.gain is None or motors.to_joints is None:
        return None
    if current is None:
        raise table.build_error(f"{GAIN} in recording.yaml needs the columns current1_A …; they are missing")
    _refuse_count(table, len(motors.gain), prismatic)
    _refuse_count(table, len(motors.to_joints), prismatic)
    return np.asarray(np.linalg.solve(motors.to_joints.T, (current * motors.gain).T).T)


def _refuse_count(table: RecordingTable, count: int, prismatic: Prismatic) -> None:
    if count != len(prismatic):
        raise table.build_error(f"recording.yaml states {count} motors; the table has {len(prismatic)} joints")
    if any(prismatic):
        raise table.build_error(
            "motors of joints that slide are not read; a force tau1_N … or a position q1_mm … would work"
        )


def _parse_row(document: YamlDocument, key: str, value: object) -> Array:
    out = _parse_numbers(document, (key,), value)
    if not all(v != 0.0 for v in out):
        raise document.build_error(
            (key,), "holds a zero; expected a number for each motor, its sign that of the joint's turn"
        )
    return np.array(out)


def _parse_numbers(document: YamlDocument, loc: tuple[str | int, ...], value: object) -> list[float]:
    right = isinstance(value, list) and value
    if not right or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):  # type: ignore[attr-defined]
        raise document.build_error(loc, "expected a list of numbers, one a joint")
    out = [float(v) for v in value]  # type: ignore[attr-defined]
    if not all(np.isfinite(out)):
        raise document.build_error(loc, "holds a number that is not finite")
    return out

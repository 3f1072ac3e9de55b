"""Error of written model files on the corrected readings: the error that a diagnosis states.

The arm is that of the cell with the written stiffness and kinematics. Only the registration is fitted again, by least
squares over the positions: the tracker frames and, with ``registration: fit`` or named reflectors, their places in the
flange. Nothing else is fitted, and the discrepancy of the stiffness is not used. Where neither the cell nor a written
file states springs (no stiffness.yaml holds a joint that slides), they are fitted with the registration: they bend the
arm with and without the corrections.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.diagnosis_pipeline import read_load_test_masses, read_stated_masses
from machopt.measurement.diagnosis.effect_columns import existing_terms, joint_torque
from machopt.measurement.diagnosis.static import load_test_channel, loaded_equilibrium_terms
from machopt.measurement.diagnosis.static.measured_pose_model import BaseStep, FirstPoseFit, NominalPoseModel
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, convert_vector_to_rotation
from machopt.stiffness.arm_stiffness import ArmElasticity

Flags = NDArray[np.bool_]
REGISTRATION_STEPS = 12  # most Gauss–Newton steps of the registration
CONVERGED_M = 1e-10  # m, change of the registration below which it is final
UNDETERMINED = 1e-9  # relative singular value below which a direction of the registration stays nominal


@dataclass(frozen=True)
class WrittenModel:
    """Model files of a diagnosis as they are read back."""

    stiffness: ArmStiffness | None  # None: no file was written, the cell's own holds
    kinematics: KinematicCorrections | None


@dataclass(frozen=True)
class Registration:
    """Registration of measured poses, and the arm in it."""

    fit: FirstPoseFit
    angles: Array  # (N, n) rad, loaded equilibrium


@dataclass(frozen=True)
class WrittenResidual:
    """Residual of written files."""

    values: Array  # (K, 3) m, of the wanted readings
    registration: Registration | None  # None of load tests


def compute_written_residual(
    cell: Cell,
    model: WrittenModel,
    recording: Recording,
    fitted: Flags,
    flags: Flags,
    start: Registration | None = None,
) -> WrittenResidual:
    """Compute measured minus predicted positions or displacements of written files.

    Args:
        cell: Robot cell as it was diagnosed.
        model: Written files.
        recording: Corrected readings.
        fitted: (N,) readings that the registration is fitted to.
        flags: (N,) readings whose residuals are returned.
        start: Registration of similar files of these readings, from which fewer steps are needed; None: nominal.

    Returns:
        The residual of the K wanted readings.
    """
    cell = replace(
        cell,
        stiffness=model.stiffness if model.stiffness is not None else cell.stiffness,
        kinematics=model.kinematics if model.kinematics is not None else cell.kinematics,
    )
    if not flags.any():
        return WrittenResidual(np.zeros((0, 3)), start)
    if recording.kind == "deflection":
        return WrittenResidual(_compute_load_test_residual(cell, recording, flags), None)
    residual, registration = _compute_pose_residual(cell, recording, fitted, start)
    return WrittenResidual(residual[flags], registration)


def _compute_load_test_residual(cell: Cell, recording: Recording, flags: Flags) -> Array:
    """Return the residual (K, 3) of the wanted load tests: springs and K_C in equilibrium, and terms.

    Only effects with a memory need the other readings.
    """
    assert cell.stiffness is not None  # load tests show all springs, so that a file is written
    robot, T, masses = load_robot(replace(cell, kinematics=None)), cell.tool.T_flange_tcp, read_load_test_masses(cell)
    stiffness = replace(cell.stiffness, terms=existing_terms.select_known_terms(cell.stiffness.terms))
    every = build_load_test_experiment(recording, robot, T)
    tests = every.select_readings(flags)
    compliance = 1.0 / stiffness.joints
    out = tests.measured - tests.response() @ compliance
    curved = loaded_equilibrium_terms.compute_nonlinear_displacement(tests, robot, T, masses, compliance)
    if curved is not None:
        out = out - curved
    if stiffness.terms:
        readings = load_test_channel.build_load_test_readings(recording, every, robot, T, masses, compliance)
        with_memory, settled = joint_torque.compute_memory_term_displacement(readings, stiffness.terms)
        springs = ArmStiffness(joints=stiffness.joints)
        whole = ArmElasticity(robot, T, replace(springs, terms=settled), cell.arm_limits, masses)
        alone = ArmElasticity(robot, T, springs)
        moved = with_memory[flags] + whole.evaluate(tests.state.q).compute_twist(tests.wrench)
        moved = moved - alone.evaluate(tests.state.q).compute_twist(tests.wrench)
        out = out - moved[:, : tests.dimensions]
    return np.asarray(out[:, :3])


def _compute_pose_residual(
    cell: Cell, recording: Recording, fitted: Flags, start: Registration | None
) -> tuple[Array, Registration]:
    """Return the residual (N, 3) of measured poses with the registration fitted to some readings."""
    stated = frozenset(range(1, len(cell.arm_joints) + 1)) if cell.stiffness is not None else frozenset()
    model = NominalPoseModel(recording, cell, load_robot(cell), read_stated_masses(cell), stated)
    terms = () if cell.stiffness is None else existing_terms.select_known_terms(cell.stiffness.terms)
    at = FirstPoseFit(
        np.zeros((model.frame_count, 3)), np.zeros((model.frame_count, 3)), np.zeros((model.targets, 3)), model.nominal
    )
    if start is not None:
        at = replace(start.fit, compliance=start.fit.compliance if model.cell.stiffness is None else model.nominal)
        model.settled = start.angles
    for _ in range(REGISTRATION_STEPS):
        state, p, R = model.predict(at)
        residual = model.residual(at, p, R)
        if terms:
            readings = model.build_readings(state, at, at.compliance)
            residual = residual - existing_terms.compute_known_pose_displacement(readings, terms)
        columns, unknowns = model.columns(state, p)
        if not columns.shape[2]:
            break
        step = _solve_registration(columns[fitted][:, :3], residual[fitted][:, :3])
        if np.abs(step).max() < CONVERGED_M:
            break
        at = _move_registration(at, model.split_unknowns(unknowns, step))
    assert model.settled is not None  # by the prediction
    return np.asarray(residual[:, :3]), Registration(at, model.settled)


def _solve_registration(columns: Array, residual: Array) -> Array:
    """Return the least-squares step (P,) of the registration; undetermined directions do not move."""
    A = columns.reshape(-1, columns.shape[2])
    size = np.linalg.norm(A, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.lstsq(A / size, residual.reshape(-1), rcond=UNDETERMINED)[0] / size)


def _move_registration(at: FirstPoseFit, step: BaseStep) -> FirstPoseFit:
    Q = convert_vector_to_rotation(at.turn)
    compliance = at.compliance.copy()
    for joint, change in step.springs.items():
        compliance[joint] = max(compliance[joint] + change, 0.0)
    return FirstPoseFit(
        at.shift + np.einsum("fij,fj->fi", Q, step.shift),
        convert_to_rotation_vector(Q @ convert_vector_to_rotation(step.turn)),
        at.target + step.target,
        compliance,
    )

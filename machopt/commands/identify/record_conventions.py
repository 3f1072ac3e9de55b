"""Conventions of a recording that ``machopt identify`` refuses, because ``machopt diagnose`` reads them otherwise."""

from __future__ import annotations

from collections.abc import Collection

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot
from machopt.measurement.diagnosis.data_quality.joint_conventions import correct_joint_convention
from machopt.measurement.diagnosis.data_quality.load_and_length_units import find_displacement_unit_fault
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.data_quality.load_test_checks import refuse_record_faults
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault
from machopt.measurement.identification.data_quality.sensor_axes import CODE as SENSOR_AXES
from machopt.measurement.identification.data_quality.sensor_axes import check_sensor_axes
from machopt.measurement.identification.data_quality.unit_checks import estimate_reach

JOINT_CONVENTION = "joint_convention"


def refuse_other_conventions(
    cell: Cell, recording: Recording, robot: Robot, tests: LoadTestExperiment, accept: Collection[str]
) -> None:
    """Refuse load tests whose joint angles, sensor axes or units fit in another convention only.

    Args:
        cell: Robot cell.
        recording: Load tests as read.
        robot: Kinematic model of the arm.
        tests: The same in base axes.
        accept: Codes that the user declares to be intended.

    Raises:
        RecordingError: Names the convention that fits, and what would be accepted.
    """
    T = cell.tool.T_flange_tcp
    found: list[RecordFault] = []
    if not tests.wrench.any() or not tests.measured.any():
        return  # reported by a later check
    if JOINT_CONVENTION not in accept:
        _, joints = correct_joint_convention(recording, robot, T, (), cell.controller.joint_map)
        found += [
            RecordFault(code=JOINT_CONVENTION, severity="error", message=_read_words(f.note), column="q1_deg")
            for f in joints
        ]
    reach = estimate_reach(robot, T)
    prior = None if cell.stiffness is None else cell.stiffness.joints
    if not found and SENSOR_AXES not in accept:
        found += check_sensor_axes(tests, robot)
    if not found and "units" not in accept:
        estimated = cell.stiffness is not None and cell.stiffness.estimated
        size = find_displacement_unit_fault(tests, prior, reach, estimated)
        found += [] if size is None else [size]
    refuse_record_faults(tests, found, accept)


def _read_words(note: str) -> str:
    return (
        f"{note.split(';', maxsplit=1)[0]}; angles as the URDF counts them would work, as machopt diagnose writes them"
    )

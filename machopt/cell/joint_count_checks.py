"""Checks of a cell's files against the number of joints of its arm."""

from __future__ import annotations

from pathlib import Path

from machopt.data_types.effect_locations import is_on_arm
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import CellError


def check_stiffness_joints(stiffness: ArmStiffness, joints: int) -> None:
    """Check that a stiffness file is of an arm with a number of joints.

    Args:
        stiffness: Content of the file.
        joints: Number of joints of the arm.

    Raises:
        CellError: another number of springs, or a term at a joint or link that the arm does not have.
    """
    if len(stiffness.joints) != joints:
        raise CellError(
            f"found {len(stiffness.joints)} joint stiffnesses; expected {joints}, one per joint of the arm",
            file=stiffness.file,
            where="joints_Nm_per_rad",
        )
    for n, term in enumerate(stiffness.terms):
        _check_location(term.location, joints, stiffness.file, f"terms[{n}].location")


def check_correction_joints(kinematics: KinematicCorrections, joints: int) -> None:
    """Check that kinematic corrections are of an arm with a number of joints.

    Args:
        kinematics: Content of the file.
        joints: Number of joints of the arm.

    Raises:
        CellError: a correction at a joint that the arm does not have.
    """
    for n, correction in enumerate(kinematics.corrections):
        _check_location(correction.location, joints, kinematics.file, f"corrections[{n}].location")


def _check_location(location: str, joints: int, file: Path | None, where: str) -> None:
    if not is_on_arm(location, joints):
        raise CellError(f"found {location!r}; the arm has joints and links 1 to {joints}", file=file, where=where)

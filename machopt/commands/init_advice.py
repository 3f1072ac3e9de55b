"""Advice of ``machopt init`` for arms of more than six joints: only what a trial has shown to work."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from machopt.cell.urdf import ArmLinks, RobotDescription, TooManyJointsError, find_arm
from machopt.cell_setup.template.init_request import InitRequest
from machopt.data_types.cell import Cell
from machopt.errors import InputError, RobotModelError
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot

_BODIES = re.compile(r"<(visual|collision)\b(?:[^>]*/>|.*?</\1\s*>)", re.DOTALL)
_ANYWHERE_MM = (1000.0, 0.0, 500.0)  # a place of the workpiece, so that none is searched for


def load_solvable_robot(cell: Cell) -> Robot:
    """Return the robot of a cell; an arm without inverse kinematics is refused here, not by the first plan.

    Args:
        cell: The new cell.

    Raises:
        InputError: the arm has no inverse kinematics.
    """
    robot = load_robot(cell)
    build_solver(robot)
    return robot


def find_arm_or_advise(
    request: InitRequest, description: RobotDescription, init: Callable[[InitRequest], object]
) -> ArmLinks:
    """Find the arm of a robot.

    Args:
        request: The user's request.
        description: The robot's file.
        init: Writes a new cell.

    Returns:
        Base, flange and joints.

    Raises:
        InputError: as :func:`machopt.cell.urdf.find_arm`; for more than six joints with advice that was tried.
    """
    try:
        return find_arm(description.urdf, request.base_link, request.flange_link, any_number=request.for_diagnosis)
    except TooManyJointsError as error:
        raise keep_tried_advice(error, request, description, init) from None


def keep_tried_advice(
    error: TooManyJointsError,
    request: InitRequest,
    description: RobotDescription,
    init: Callable[[InitRequest], object],
) -> RobotModelError:
    """Return the error with the options and fixed joints that lead to a cell.

    Each is tried with the bodies left out, as only the kinematics decide.

    Args:
        error: The refusal with everything that could work.
        request: The user's request.
        description: The robot's file.
        init: Writes a new cell.

    Returns:
        The error whose advice can be followed.
    """
    whole = description.whole or request.robot.read_text(encoding="utf-8-sig")
    text = _BODIES.sub("", whole)
    advice: list[str] = []
    with TemporaryDirectory() as folder:
        robot = Path(folder) / "robot.urdf"
        trial = InitRequest(robot=robot, out=Path(folder) / "cell", workpiece_mm=_ANYWHERE_MM)
        robot.write_text(text, encoding="utf-8")
        for choice in error.choices:
            key = "base_link" if choice.option == "--base-link" else "flange_link"
            one = replace(trial, out=Path(folder) / key, **{key: choice.link})  # type: ignore[arg-type]
            if _is_accepted(one, init):
                advice.append(f"{choice.option} {choice.link} {choice.effect}")
        if _is_accepted(replace(trial, out=Path(folder) / "all", for_diagnosis=True), init):
            advice.append("--for-diagnosis keeps all of them, for identify and diagnose")
        if len(error.joints) == 7:
            for joint in sorted(error.joints, key=lambda name: abs(error.joints.index(name) - 2)):
                robot.write_text(_fix_joint(text, joint), encoding="utf-8")
                if _is_accepted(replace(trial, out=Path(folder) / "fixed", flange_link=error.flange), init):
                    advice.append(f'{joint} with type="fixed" in the URDF would work')
                    break
    return RobotModelError(error.describe(advice), file=error.file)


def _is_accepted(request: InitRequest, init: Callable[[InitRequest], object]) -> bool:
    try:
        init(request)
    except InputError:
        return False
    return True


def _fix_joint(text: str, joint: str) -> str:
    """The text of a URDF with one joint fixed."""

    def fix(found: re.Match[str]) -> str:
        tag = found.group()
        return re.sub(r"type\s*=\s*([\"'])\w+\1", 'type="fixed"', tag)

    return re.sub(rf"<joint\b[^>]*\bname\s*=\s*[\"']{re.escape(joint)}[\"'][^>]*>", fix, text)

"""Reading options of toolpaths that come from the cell: the robot for joint targets, and work offsets."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.programs.program_to_toolpath import ProgramRobot


def build_known_robot(cell: Cell) -> ProgramRobot | None:
    """Return the robot that converts joint targets; its kinematics are loaded on first use.

    It is None where another link carries the workpiece: the position then depends on that axis.

    Args:
        cell: The robot cell.
    """
    if cell.workpiece.link != "world":
        return None
    loaded: list[Robot] = []

    def fk(q: Array, T_flange_tool: Array) -> Array:
        if not loaded:
            loaded.append(load_robot(cell).nominal_robot)  # a program's places are the controller's
        return np.asarray(loaded[0].compute_fk(q, T_flange_tool))

    T_base_workpiece = invert_transform(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    return ProgramRobot(fk, cell.controller, cell.tool.T_flange_tcp, T_base_workpiece)


def get_reading_options(cell: Cell) -> dict[str, Any]:
    """Return the cell's keywords for :func:`machopt.toolpath.toolpath_reader.read_toolpath`.

    Args:
        cell: The robot cell.
    """
    return {"robot": build_known_robot(cell), "cell_offsets": tuple(cell.offsets)}

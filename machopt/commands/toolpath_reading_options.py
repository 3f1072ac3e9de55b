"""The cell's robot, for programs whose targets are joint positions."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.kinematics.robot import Robot, load_robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.programs.program_to_toolpath import ProgramRobot


def build_known_robot(cell: Cell) -> ProgramRobot | None:
    """Places of joint targets by the cell's kinematics, which are loaded when the first one is asked for.

    None where the workpiece is carried by another link: its place then depends on that axis.
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
    """What a cell says of how toolpaths for it are read: keywords of
    :func:`machopt.toolpath.toolpath_reader.read_toolpath`."""
    return {"robot": build_known_robot(cell), "cell_offsets": tuple(cell.offsets)}

"""The cell's robot, for programs whose targets are joint positions."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.formats.programs.toolpath import KnownRobot
from machopt.model.robot import Robot, load_robot
from machopt.se3 import inverse


def known_robot(cell: Cell) -> KnownRobot | None:
    """Places of joint targets by the cell's kinematics, which are loaded when the first one is asked for.

    None where the workpiece is carried by another link: its place then depends on that axis.
    """
    if cell.workpiece.link != "world":
        return None
    loaded: list[Robot] = []

    def fk(q: Array, T_flange_tool: Array) -> Array:
        if not loaded:
            loaded.append(load_robot(cell).drawn)  # a program's places are the controller's
        return np.asarray(loaded[0].fk(q, T_flange_tool))

    T_base_workpiece = inverse(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    return KnownRobot(fk, cell.controller, cell.tool.T_flange_tcp, T_base_workpiece)


def reading_of(cell: Cell) -> dict[str, Any]:
    """What a cell says of how toolpaths for it are read: keywords of :func:`machopt.formats.toolpath.read_toolpath`."""
    return {"robot": known_robot(cell), "cell_offsets": tuple(cell.offsets)}

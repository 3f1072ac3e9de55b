"""A cell as the 3-D picture shows it: from the planner's robot and bodies."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.domain.cell import Cell
from machopt.model import bodies as checked
from machopt.model.robot import LinkShape, Robot
from machopt.report.scene import Body, Joint, Scene
from machopt.se3 import inverse


def scene_of(cell: Cell, robot: Robot, bodies: Iterable[checked.Body]) -> Scene:
    """The arm as a tree of joints, with what it carries and what stands around it.

    Args:
        cell: with limits as true angles.
        robot: its arm.
        bodies: in base_link at q = 0; the second of two cutters is the first one drawn in, and left out.
    """
    shown: list[Body] = []
    for b in bodies:
        if b.kind != "cutter" or all(s.kind != "cutter" for s in shown):
            shown.append(Body(b.name, b.kind, b.link - 1, b.vertices, b.faces))
    joints = tuple(
        Joint(
            name=name,
            parent=i - 1,
            axis=robot.axis[i],
            point=robot.point[i],
            prismatic=False,
            lower=float(cell.limits.lower[i]),
            upper=float(cell.limits.upper[i]),
        )
        for i, name in enumerate(robot.joints)
    )
    return Scene(
        T_world_root=cell.T_world_base,
        joints=joints,
        bodies=tuple(shown),
        T_root_tool=robot.T_base_flange_zero @ cell.tool.T_flange_tcp,
        T_root_part=inverse(cell.T_world_base) @ cell.workpiece.T_link_workpiece,
        tool_joint=len(joints) - 1,
        coupling=robot.coupling,
    )


def bodies_of(cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...]) -> list[checked.Body]:
    """Everything in the cell that has a shape, where no collision model has read it."""
    cutter = [] if cell.tool.cutter is None else [checked.cutter_body(cell, robot, cell.tool.cutter)]
    return [*checked.robot_bodies(robot, shapes), *checked.cell_bodies(cell, robot), *cutter]

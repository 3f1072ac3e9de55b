"""Machine and bodies of a cell for the 3-D view, from the planner's model."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.collision import bodies as checked
from machopt.data_types.cell import Cell
from machopt.kinematics.machine import Machine, load_machine
from machopt.kinematics.machine_lines import LinkCarriers
from machopt.kinematics.robot import LinkShape, Robot
from machopt.report.scene.scene_types import CellScene, SceneBody, SceneJoint


def build_machine_scene(cell: Cell, robot: Robot, bodies: Iterable[checked.CollisionBody]) -> CellScene:
    """Return the machine as a tree of joints, with their bodies and the surroundings.

    The planner's chain goes from the part over the hall to the tool; the picture's tree grows out of the hall both
    ways, in base_link axes where every joint is at zero.

    Args:
        cell: with limits as true angles.
        robot: its arm.
        bodies: in base_link at zero; the second of two cutters is the first one drawn in, and left out.
    """
    machine = load_machine(cell, robot)
    shown: list[SceneBody] = []
    for b in bodies:
        if b.kind != "cutter" or all(s.kind != "cutter" for s in shown):
            shown.append(
                SceneBody(
                    name=b.name,
                    kind=b.kind,
                    joint=_find_carrying_joint(machine, b.link),
                    vertices=b.vertices,
                    faces=b.faces,
                )
            )
    names = (*robot.joints, *cell.external_joints)
    joints: list[SceneJoint | None] = [None] * len(names)
    for line, column in enumerate(machine.column.tolist()):
        joints[column] = SceneJoint(
            name=names[column],
            parent=_find_parent_joint(machine, line),
            axis=machine.axis[line],
            point=machine.point[line],
            prismatic=bool(machine.slides[line]),
            lower=float(cell.limits.lower[column]),
            upper=float(cell.limits.upper[column]),
        )
    return CellScene(
        T_world_root=machine.T_world_base_zero,
        joints=tuple(j for j in joints if j is not None),
        bodies=tuple(shown),
        T_root_tool=robot.T_base_flange_zero @ cell.tool.T_flange_tcp,
        T_root_part=machine.T_base_workpiece_zero,
        tool_joint=5,
        part_joint=_find_carrying_joint(machine, 0),
        base_joint=_find_carrying_joint(machine, machine.base_link),
        coupling=robot.coupling,
    )


def build_bodies(cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...]) -> list[checked.CollisionBody]:
    """Return every body of the cell that has a shape, where no collision model has read it.

    Args:
        cell: The robot cell.
        robot: The kinematic model of the robot.
        shapes: Shapes of the robot's links.
    """
    machine = load_machine(cell, robot)
    carriers = LinkCarriers(cell, machine)
    cutter = [] if cell.tool.cutter is None else [checked.build_cutter_body(cell, machine, cell.tool.cutter)]
    return [*checked.build_robot_bodies(carriers, shapes), *checked.build_cell_bodies(cell, carriers), *cutter]


def _find_carrying_joint(machine: Machine, link: int) -> int:
    """The joint that carries a link of the chain, by its place in x; −1 for the hall."""
    if link == machine.world_link:
        return -1
    return int(machine.column[link if link < machine.world_link else link - 1])


def _find_parent_joint(machine: Machine, line: int) -> int:
    """The joint that carries the joint of a line of the chain."""
    return _find_carrying_joint(machine, line + 1 if line < machine.world_link else line)

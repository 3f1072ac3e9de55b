"""A cell as the 3-D picture shows it: from the planner's machine and bodies."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.domain.cell import Cell
from machopt.model import bodies as checked
from machopt.model.lines import Carriers
from machopt.model.machine import Machine, load_machine
from machopt.model.robot import LinkShape, Robot
from machopt.report.scene import Body, Joint, Scene


def scene_of(cell: Cell, robot: Robot, bodies: Iterable[checked.Body]) -> Scene:
    """The machine as a tree of joints, with what they carry and what stands around it.

    The planner's chain goes from the part over the hall to the tool; the picture's tree grows out of the hall both
    ways, in base_link axes where every joint is at zero.

    Args:
        cell: with limits as true angles.
        robot: its arm.
        bodies: in base_link at zero; the second of two cutters is the first one drawn in, and left out.
    """
    machine = load_machine(cell, robot)
    shown: list[Body] = []
    for b in bodies:
        if b.kind != "cutter" or all(s.kind != "cutter" for s in shown):
            shown.append(
                Body(name=b.name, kind=b.kind, joint=_carrier(machine, b.link), vertices=b.vertices, faces=b.faces)
            )
    names = (*robot.joints, *cell.external_joints)
    joints: list[Joint | None] = [None] * len(names)
    for line, column in enumerate(machine.column.tolist()):
        joints[column] = Joint(
            name=names[column],
            parent=_parent(machine, line),
            axis=machine.axis[line],
            point=machine.point[line],
            prismatic=bool(machine.slides[line]),
            lower=float(cell.limits.lower[column]),
            upper=float(cell.limits.upper[column]),
        )
    return Scene(
        T_world_root=machine.T_world_base_zero,
        joints=tuple(j for j in joints if j is not None),
        bodies=tuple(shown),
        T_root_tool=robot.T_base_flange_zero @ cell.tool.T_flange_tcp,
        T_root_part=machine.T_base_workpiece_zero,
        tool_joint=5,
        part_joint=_carrier(machine, 0),
        base_joint=_carrier(machine, machine.base),
        coupling=robot.coupling,
    )


def bodies_of(cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...]) -> list[checked.Body]:
    """Everything in the cell that has a shape, where no collision model has read it."""
    machine = load_machine(cell, robot)
    carriers = Carriers(cell, machine)
    cutter = [] if cell.tool.cutter is None else [checked.cutter_body(cell, machine, cell.tool.cutter)]
    return [*checked.robot_bodies(carriers, shapes), *checked.cell_bodies(cell, carriers), *cutter]


def _carrier(machine: Machine, link: int) -> int:
    """The joint that carries a link of the chain, by its place in x; −1 for the hall."""
    if link == machine.hall:
        return -1
    return int(machine.column[link if link < machine.hall else link - 1])


def _parent(machine: Machine, line: int) -> int:
    """The joint that carries the joint of a line of the chain."""
    return _carrier(machine, line + 1 if line < machine.hall else line)

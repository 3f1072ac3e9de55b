"""External axes in the numbering of the controller, and the controller frame that holds the workpiece.

A controller that knows its rail or positioner computes the tool position from all axes. Targets are then given in a
frame that moves with the part. On a positioner it is the flange of that unit (KUKA: an external kinematic, ABB: a work
object on a mechanical unit). With a rail alone it is the fixed frame that the controller calls WORLD. The controller
value of each joint is sign · value + offset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.robot_program import ExternalAxisMap, ExternalProgramAxis, RobotController, RobotProgram
from machopt.errors import PostError
from machopt.numerics.array_types import Array
from machopt.programs.writing.template_language import TemplateColumn, TemplateValue

MOST = 6  # external axes that controllers number
GROUP = 3  # of them in one group of FANUC or Yaskawa
UNIT, MACHINE = "STN1", 2  # assumed and reported where the cell gives none
STILL = 1e-9  # rad or m: an axis that moves less is fixed


@dataclass(frozen=True)
class DrivenAxis:
    """One external axis of a program."""

    axis: ExternalProgramAxis
    drive: ExternalAxisMap
    number: int
    values: Array  # (M,) mm or deg as the controller counts it

    @property
    def word(self) -> str:
        """The unit of its values."""
        return "mm" if self.axis.slides else "deg"


def list_driven_axes(program: RobotProgram, controller: RobotController) -> tuple[DrivenAxis, ...]:
    """List the external axes of a program in the numbering of the controller.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.

    Returns:
        The axes.
    """
    out = []
    for k, axis in enumerate(program.external_axes):
        drive = controller.external.get(axis.joint, ExternalAxisMap())
        values = program.external[:, k] * (1e3 if axis.slides else 180.0 / np.pi)
        out.append(DrivenAxis(axis, drive, drive.number or k + 1, drive.sign * values + drive.offset))
    return tuple(sorted(out, key=lambda d: d.number))


def build_external_columns(
    program: RobotProgram, controller: RobotController
) -> dict[str, Callable[[], TemplateColumn]]:
    """Build the template columns of the external axes.

    ``e1`` … ``e6`` by number; ``rail1`` …, ``table1`` … of the group that carries the robot or the part.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.

    Returns:
        Field → function that computes its column; NaN where there is no such axis.
    """
    axes, n = list_driven_axes(program, controller), len(program)
    by_name: dict[str, DrivenAxis] = {f"e{d.number}": d for d in axes}
    for group, part in (("rail", False), ("table", True)):
        members = [d for d in axes if d.axis.carries_part == part]
        by_name |= {f"{group}{k}": d for k, d in enumerate(members, start=1)}
    names = [f"e{k + 1}" for k in range(MOST)] + [f"{g}{k + 1}" for g in ("rail", "table") for k in range(GROUP)]
    out: dict[str, Callable[[], TemplateColumn]] = {}
    none = np.full(n, np.nan)
    for name in names:
        found = by_name.get(name)
        values, word, pulses = none, "", None
        if found is not None:
            values, word = found.values, found.word
            mates = [d for d in axes if d.axis.carries_part == found.axis.carries_part]
            if all(d.drive.pulses is not None for d in mates):  # a group counts in one unit
                pulses = found.drive.pulses
        out[name] = lambda v=values: v  # type: ignore[misc]
        out[f"{name}_unit"] = lambda w=word: [w] * n  # type: ignore[misc]
        plain, pulsed = (values, none) if pulses is None else (none, values * pulses)
        out[f"{name}_plain"] = lambda v=plain: v  # type: ignore[misc]
        out[f"{name}_pulse"] = lambda v=pulsed: v  # type: ignore[misc]
    for k in range(MOST):
        listed = program.external[:, k] if k < len(program.external_axes) else np.full(n, np.nan)
        out[f"e{k + 1}_si"] = lambda v=listed: v  # type: ignore[misc]
    return out


def build_external_fields(program: RobotProgram, controller: RobotController) -> dict[str, TemplateValue]:
    """Build the template fields of the whole program: number of axes, and the unit that carries the part.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.

    Returns:
        Field → value.
    """
    axes = list_driven_axes(program, controller)
    tables = [d for d in axes if d.axis.carries_part]
    machine, unit = (next((v for d in tables if (v := getattr(d.drive, key))), None) for key in ("machine", "unit"))
    units = dict.fromkeys([*(d.drive.unit for d in axes if d.drive.unit), *([unit or UNIT] if tables else [])])
    return {
        "externals": len(axes),
        "rails": len(axes) - len(tables) or float("nan"),
        "tables": len(tables) or float("nan"),
        "part_unit": (unit or UNIT) if tables else "",
        "part_machine": (machine or MACHINE) if tables else float("nan"),
        "activate": "\n".join(f"    ActUnit {u};" for u in units),
        "external_pulses": bool(axes) and all(d.drive.pulses is not None for d in axes),
        **_build_pulse_fields("rail", [d for d in axes if not d.axis.carries_part]),
        **_build_pulse_fields("table", tables),
    }


def _build_pulse_fields(group: str, axes: Sequence[DrivenAxis]) -> dict[str, TemplateValue]:
    pulsed = bool(axes) and all(d.drive.pulses is not None for d in axes)
    return {f"{group}_pulses": pulsed, f"{group}_units": bool(axes) and not pulsed}


def list_external_assumptions(program: RobotProgram, controller: RobotController, used: frozenset[str]) -> list[str]:
    """List what a coupled controller is assumed to do because the cell does not give it.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.
        used: Names of the template fields that the post uses.

    Returns:
        One sentence per assumption.
    """
    out = []
    for d in list_driven_axes(program, controller):
        if d.axis.joint not in controller.external:
            out.append(
                f"no controller.external.{d.axis.joint} in the cell: external axis {d.number}, same sign and zero"
            )
    if program.part_rides:
        keys = build_external_fields(program, controller)
        drives = [d.drive for d in list_driven_axes(program, controller) if d.axis.carries_part]
        for field, key, value in (("part_unit", "unit", keys["part_unit"]), ("part_machine", "machine", MACHINE)):
            if field in used and not any(getattr(drive, key) for drive in drives):
                out.append(f"no {key} of the positioner under controller.external in the cell: {value} is taken")
        out.append("the flange of the positioner is taken to be the link of the URDF that workpiece.link names")
    elif program.external_axes and controller.T_world_root is None:
        out.append("no controller.world in the cell: the controller's WORLD is the cell's world")
    return out


def list_external_notes(program: RobotProgram, controller: RobotController) -> list[str]:
    """List which external axis is which, for the head of the program.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        controller: Controller settings of the cell.

    Returns:
        Lines of the note.
    """
    carried = {True: "the part", False: "the robot"}
    return [
        f"external axis {d.number} is {d.axis.joint} in {d.word}, it carries {carried[d.axis.carries_part]}"
        for d in list_driven_axes(program, controller)
    ]


def refuse_external_axes(program: RobotProgram, why: str, *, unless_still: bool) -> None:
    """Refuse a program with external axes where a language has none.

    Args:
        program: Robot program: targets, poses and moves in SI units.
        why: Reason, for the message.
        unless_still: Whether external axes that never move are accepted.

    Raises:
        PostError: the program has external axes, or with ``unless_still`` moves some.
    """
    if not program.external_axes:
        return
    span = np.ptp(program.external, axis=0) if len(program) else np.zeros(len(program.external_axes))
    moving = [a.joint for a, s in zip(program.external_axes, span, strict=True) if s > STILL or not unless_still]
    if moving:
        raise PostError(f"{why} (external joints {', '.join(moving)})", where="post")

"""Key ``controller.absolute_accuracy``: whether the controller or machopt corrects geometry and gravity deflection.

A controller with the option "absolute accuracy" corrects the TCP position by its own calibrated model, gravity
included. kinematics.yaml corrects the same errors. Both together would correct twice. With ``on``, machopt therefore
applies none of them: commanded joints are nominal. A compensation then covers the process force alone, which no
controller knows.
"""

from __future__ import annotations

from dataclasses import replace

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions

KEY = "controller.absolute_accuracy"  # the first word of every note and warning made here
ON = f"{KEY} is on: kinematics.yaml is not applied, geometry and gravity sag are left to the controller"
ON_COMPENSATED = f"{KEY} is on: the compensation is of the process force alone"


def apply_absolute_accuracy(cell: Cell, options: PlanOptions) -> Cell:
    """Return the cell that plan and verification use.

    Args:
        cell: as it was read.
        options: of the plan; with ``compensate`` a correction is written even without kinematics.yaml.

    Returns:
        the cell without the corrections that the controller makes itself, with a note; where the cell does not say
        and a correction is written, with a warning; else the same cell.
    """
    corrections = [name for name, is_there in _list_corrections(cell, options) if is_there]
    if not corrections:
        return cell
    if cell.controller.absolute_accuracy == "on":
        notes = [*([ON] if cell.kinematics is not None else []), *([ON_COMPENSATED] if options.compensate else [])]
        return replace(cell, kinematics=None, notes=(*cell.notes, *notes))
    if cell.controller.absolute_accuracy == "unknown":
        warning = (
            f"{KEY} is unknown, and {' and '.join(corrections)} would be corrected twice by a "
            "controller that has it; state on or off in cell.yaml"
        )
        return cell if warning in cell.warnings else replace(cell, warnings=(*cell.warnings, warning))
    return cell


def _list_corrections(cell: Cell, options: PlanOptions) -> tuple[tuple[str, bool], ...]:
    """What a program of this job corrects."""
    return (
        ("what kinematics.yaml corrects", cell.kinematics is not None),
        ("what --compensate corrects", options.compensate),
    )

"""Rails and positioners while the arm is measured: they stand still, at home or where the user says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import InputError, suggest_nearest_word
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array


def set_external_axis_positions(cell: Cell, asked: Sequence[str]) -> Cell:
    """The cell whose home of the external joints is where they are to stand.

    Args:
        cell: the robot cell.
        asked: ``name=value`` (or ``e1=value``), mm of joints that slide and degrees of others.

    Raises:
        InputError: no such joint, no number, or out of the joint's range.
    """
    names, home = list(cell.external_joints), np.array(cell.external_home)
    for word in asked:
        name, equals, text = word.partition("=")
        short = [f"e{k + 1}" for k in range(len(names))]
        name = names[short.index(name)] if name in short and name not in names else name
        if name not in names:
            known = suggest_nearest_word(name, [*names, *short]) if names else "it has none"
            raise InputError(f"{name!r} is no external joint of the cell; {known}", where="--external")
        k = names.index(name)
        unit, per = ("mm", 1e3) if cell.external_prismatic[k] else ("deg", float(np.degrees(1.0)))
        low, high = (float(v[6 + k]) * per for v in (cell.limits.lower, cell.limits.upper))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not equals or not low - 1e-6 <= value <= high + 1e-6:  # mm or deg; round-off of the limits
            raise InputError(
                f"found {word!r}; {name}=VALUE with {low:g} to {high:g} {unit} would work", where="--external"
            )
        home[k] = value / per
    home.setflags(write=False)
    return replace(cell, external_home=home)


def update_base_frame(cell: Cell, robot: Robot) -> Cell:
    """The cell with ``T_world_base`` as it is where the external joints stand: for what is asked of places in world.

    Not for a collision model, which moves the base itself.
    """
    if not cell.external_joints:
        return cell
    T: Array = load_machine(cell, robot).compute_T_world_base(cell.external_home[None])[0]
    return replace(cell, T_world_base=T)


def describe_external_axis_positions(cell: Cell) -> str:
    """Where the external joints stand, in a sentence; empty without any."""
    values = [
        f"{name} at {value * 1e3:g} mm" if slides else f"{name} at {np.degrees(value):g}°"
        for name, value, slides in zip(cell.external_joints, cell.external_home, cell.external_prismatic, strict=True)
    ]
    if not values:
        return ""
    return f"every pose is measured with {' and '.join(values)}; what they give way by themselves is not told apart"

"""Positions of external axes (rails, positioners) during the measurement: fixed, at home or as stated by the user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import OptionError, suggest_nearest_word
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array


def set_external_axis_positions(cell: Cell, position_texts: Sequence[str]) -> Cell:
    """Set the positions of external joints during the measurement.

    Args:
        cell: Robot cell.
        position_texts: Texts ``name=value`` (or ``e1=value``), in mm for prismatic joints and degrees for others.

    Returns:
        The cell with these positions as home of the external joints.

    Raises:
        InputError: An unknown joint, no number, or a position out of range.
    """
    names, home = list(cell.external_joints), np.array(cell.external_home)
    for word in position_texts:
        name, equals, text = word.partition("=")
        short = [f"e{k + 1}" for k in range(len(names))]
        name = names[short.index(name)] if name in short and name not in names else name
        if name not in names:
            known = suggest_nearest_word(name, [*names, *short]) if names else "it has none"
            raise OptionError(f"{name!r} is no external joint of the cell; {known}", where="--external")
        k = names.index(name)
        unit, per = ("mm", 1e3) if cell.external_prismatic[k] else ("deg", float(np.degrees(1.0)))
        low, high = (float(v[6 + k]) * per for v in (cell.limits.lower, cell.limits.upper))
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not equals or not low - 1e-6 <= value <= high + 1e-6:  # mm or deg; round-off of the limits
            raise OptionError(
                f"found {word!r}; {name}=VALUE with {low:g} to {high:g} {unit} would work", where="--external"
            )
        home[k] = value / per
    home.setflags(write=False)
    return replace(cell, external_home=home)


def update_base_frame(cell: Cell, robot: Robot) -> Cell:
    """Update ``T_world_base`` to the positions of the external joints, for positions given in world.

    Not for use with a collision model, which moves the base itself.

    Args:
        cell: Robot cell.
        robot: Kinematic model of the arm.

    Returns:
        The cell with the updated base pose.
    """
    if not cell.external_joints:
        return cell
    T: Array = load_machine(cell, robot).compute_T_world_base(cell.external_home[None])[0]
    return replace(cell, T_world_base=T)


def describe_external_axis_positions(cell: Cell) -> str:
    """Describe the positions of the external joints.

    Args:
        cell: Robot cell.

    Returns:
        One sentence; empty without external joints.
    """
    values = [
        f"{name} at {value * 1e3:g} mm" if slides else f"{name} at {np.degrees(value):g}°"
        for name, value, slides in zip(cell.external_joints, cell.external_home, cell.external_prismatic, strict=True)
    ]
    if not values:
        return ""
    return f"every pose is measured with {' and '.join(values)}; their own deflection cannot be separated"

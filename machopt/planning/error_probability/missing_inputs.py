"""What makes the probability of a tolerance unknown, and the stated accuracy of the arm."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.stiffness import ArmStiffness
from machopt.planning.error_probability.random_draws import has_load_spread
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread


def find_missing_input(
    process: CuttingProcess,
    one: ProcessOperation,
    spread: StiffnessSpread,
    position_std: float,
    *,
    is_stated: bool = True,
) -> str:
    """Return all that makes the probability unknown; empty where nothing is missing.

    Args:
        process: Content of process.yaml.
        one: Operation with a tolerance.
        spread: Random part of the stiffness.
        position_std: m, 1 sigma of a coordinate of the arm at the point; NaN where it is not known.
        is_stated: The spread of the springs is stated at the point.
    """
    stiffness, out = spread.elasticity.stiffness, []
    if stiffness.estimated:
        out.append("the stiffness is estimated, not measured")
    elif not spread.is_known:
        out.append("the stiffness file states no covariance and no spread_percent")
    elif not is_stated:
        out.append("the point lies outside the stiffness grid, where no covariance and no spread_percent is stated")
    if not has_load_spread(process, one):
        out.append("the spread of the force coefficients is not stated")
    if not np.isfinite(position_std):
        word = "absolute_mm" if one.tolerance.reference == "absolute" else "repeatability_mm"
        if stiffness.position is not None and one.tolerance.reference == "absolute":
            out.append("the point lies outside the joint angles of position_error")
        else:
            out.append(f"the arm's accuracy is not stated: accuracy.{word} in cell.yaml")
    return "; ".join(out)


def find_stated_std(cell: Cell, stiffness: ArmStiffness, reference: str) -> float:
    """Return 1 sigma of a coordinate in m as the files state it, NaN where they do not; anywhere in the workspace.

    Args:
        cell: The cell.
        stiffness: Content of stiffness.yaml.
        reference: ``absolute`` or ``relative``, of the tolerance.
    """
    if reference != "absolute":
        return float("nan") if cell.accuracy is None else cell.accuracy.repeatability
    if stiffness.position is not None:
        return stiffness.position.std if cell.kinematics is not None else stiffness.position.plain
    return float("nan") if cell.accuracy is None else cell.accuracy.absolute

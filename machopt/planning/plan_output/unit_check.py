"""Paths that no plan can help because their numbers count another unit than they were read in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import Toolpath
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array

TINY = 5e-4  # m; a whole path with its rapids is longer
_FACTORS = ((25.4, "inches that are mm"), (1e3, "mm that are thousandths of one"))
_HELP = (
    "--unit mm or --unit inch says what the numbers are where the file does not, --decimals N that they have implied "
    "decimals"
)


def compute_maximum_reach(robot: Robot, T_flange_tcp: Array) -> float:
    """m from axis 1 to the tool tip with all links and the tool in one line."""
    links = np.diff(np.vstack([robot.point, robot.T_base_flange_zero[:3, 3]]), axis=0)
    return float(np.linalg.norm(links, axis=1).sum() + np.linalg.norm(T_flange_tcp[:3, 3]))


def explain_wrong_unit(
    toolpath: Toolpath, robot: Robot, T_base_workpiece: Array, T_flange_tcp: Array, *, stated: bool = False
) -> str:
    """Why the path's size cannot be meant, empty where it can.

    It is longer than the arm reaches across, or every cut lies beyond its reach, and the 25.4th or thousandth part
    lies within; or it is shorter than half a millimetre. Where the unit was stated only the first counts: a small path
    is meant, and a part that lies out of reach is that, which the plan tells point by point with distances.

    Args:
        toolpath: points in the workpiece frame.
        robot: its links' lengths are the reach.
        T_base_workpiece, T_flange_tcp: (4, 4).
        stated: the user gave the unit.
    """
    extent = float(np.linalg.norm(np.ptp(toolpath.position, axis=0)))
    if not stated and len(toolpath) > 2 and 0.0 < extent < TINY:
        return (
            f"the whole path spans {1e3 * extent:.3g} mm. If its numbers are metres, write mm; where it is meant, "
            "give --unit mm"
        )
    reach = compute_maximum_reach(robot, T_flange_tcp)

    def beyond(factor: float) -> NDArray[np.bool_]:
        cuts = toolpath.position[toolpath.cutting] / factor
        at = cuts @ T_base_workpiece[:3, :3].T + T_base_workpiece[:3, 3]
        return np.asarray(np.linalg.norm(at - robot.point[0], axis=1) > reach)

    if not (extent > 2.0 * reach or (not stated and beyond(1.0).all())):
        return ""
    for factor, what in _FACTORS:
        if extent / factor > TINY and not beyond(factor).any():
            return (
                f"the path is {extent:.3g} m long and reaches beyond the arm ({reach:.3g} m); at {1 / factor:.4g} of "
                f"its size ({what}) all of it would lie in reach. {_HELP}"
            )
    return ""

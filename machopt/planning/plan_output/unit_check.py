"""Check for paths whose numbers are probably in another unit than assumed."""

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
    """Return the distance in m from axis 1 to the tool tip with all links and the tool in one line.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
    """
    links = np.diff(np.vstack([robot.point, robot.T_base_flange_zero[:3, 3]]), axis=0)
    return float(np.linalg.norm(links, axis=1).sum() + np.linalg.norm(T_flange_tcp[:3, 3]))


def explain_wrong_unit(
    toolpath: Toolpath, robot: Robot, T_base_workpiece: Array, T_flange_tcp: Array, *, stated: bool = False
) -> str:
    """Return why the size of the path is implausible, empty where it is plausible.

    It is implausible if it is longer than the arm's working diameter, or if every cut lies beyond its reach while the
    25.4th or thousandth part lies within, or if it is shorter than half a millimetre. Where the unit was stated only
    the
    first criterion applies: a small path is then intended, and the plan reports a part out of reach point by point.

    Args:
        toolpath: points in the workpiece frame.
        robot: its link lengths define the reach.
        T_base_workpiece: (4, 4) workpiece in base_link.
        T_flange_tcp: (4, 4) TCP relative to the flange.
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

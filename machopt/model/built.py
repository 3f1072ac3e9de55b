"""Where the frames of an arm really are, by the geometry that the cell's kinematics.yaml holds.

See :mod:`machopt.effects.geometry` for the equation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.domain.kinematics import KinematicCorrection, Kinematics
from machopt.effects import geometry
from machopt.effects.protocol import JOINTS
from machopt.se3 import rotation_from_vector, transform

BEHIND_FLANGE = 7  # entry of :func:`ways`


def ways(origins: Array, kinematics: Kinematics | None) -> Array | None:
    """What takes each link, all joints at zero, from where it is drawn to where it is built.

    Args:
        origins: (7, 3) m, of the six joints' frames and of the flange as drawn, base_link with all joints at zero.
        kinematics: of the cell.

    Returns:
        (8, 4, 4) G_0 … G_k: entry 0 base_link itself, k the link that joint k moves, 7 what the flange carries; None
        where no geometry is known.
    """
    known = {c.location: c for c in (kinematics.corrections if kinematics else ()) if c.effect == geometry.EFFECT.name}
    if not known:
        return None
    out = np.broadcast_to(np.eye(4), (8, 4, 4)).copy()
    T = _way(known, geometry.BASE, np.zeros(3))
    for k, (place, at) in enumerate(zip((*JOINTS, geometry.TOOL), origins, strict=True), start=1):
        out[k] = T = T @ _way(known, place, at)
    return out


def _way(known: Mapping[str, KinematicCorrection], place: str, at: Array) -> Array:
    """(4, 4) G of one place: turned about ``at``, then shifted."""
    if place not in known:
        return np.eye(4)
    p = geometry.placed(known[place].parameters)
    R = rotation_from_vector(p.turn)
    return transform(R, at - R @ at + p.shift)

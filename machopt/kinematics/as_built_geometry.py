"""As-built geometry: actual frames of an arm from the measured geometry in the cell's kinematics.yaml.

See :mod:`machopt.effects.structure.as_built_joint_frames` for the equation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.effects.protocol import JOINTS
from machopt.effects.structure import as_built_joint_frames
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, convert_vector_to_rotation

BEHIND_FLANGE = -1  # entry of :func:`compute_link_displacements`


def compute_link_displacements(origins: Array, kinematics: KinematicCorrections | None) -> Array | None:
    """Return the displacement of each link from its nominal to its as-built pose, with all joints at zero.

    Args:
        origins: (n + 1, 3) m, nominal frames of the n joints and of the flange, in base_link with all joints at zero.
        kinematics: corrections of the cell.

    Returns:
        (n + 2, 4, 4) G_0 … G_k: entry 0 base_link itself, k the link that joint k moves, the last the frame
        behind the flange; None where no geometry is known.
    """
    known = {
        c.location: c
        for c in (kinematics.corrections if kinematics else ())
        if c.effect == as_built_joint_frames.EFFECT.name
    }
    if not known:
        return None
    n = len(origins) - 1
    out = np.broadcast_to(np.eye(4), (n + 2, 4, 4)).copy()
    T = _compute_displacement(known, as_built_joint_frames.BASE, np.zeros(3))
    for k, (place, at) in enumerate(zip((*JOINTS[:n], as_built_joint_frames.TOOL), origins, strict=True), start=1):
        out[k] = T = T @ _compute_displacement(known, place, at)
    return out


def _compute_displacement(known: Mapping[str, KinematicCorrection], place: str, at: Array) -> Array:
    """Return (4, 4) G of one place: a rotation about ``at``, then a translation."""
    if place not in known:
        return np.eye(4)
    p = as_built_joint_frames.read_frame_offset(known[place].parameters)
    R = convert_vector_to_rotation(p.turn)
    return build_transform(R, at - R @ at + p.shift)

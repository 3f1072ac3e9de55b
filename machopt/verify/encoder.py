"""Where the joints really stand when the encoders say q: the cell's kinematic corrections, entry by entry.

Written a second time on purpose: nothing here is the planner's.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.arrays import Array
from machopt.domain.kinematics import Kinematics
from machopt.verify.built import WORD


def true_angles(kinematics: Kinematics | None, q: Array) -> Array:
    """Encoder angles plus every correction at their joints.

    Args:
        kinematics: of the cell; None: encoders and joints agree.
        q: (S, 6) rad by encoder; NaN stays NaN.

    Returns:
        (S, 6) rad.

    Raises:
        ValueError: an effect that is no kinematic correction.
    """
    stands = q.copy()
    for entry in kinematics.corrections if kinematics is not None else ():
        if entry.effect == WORD:  # no angle: :mod:`machopt.verify.built`
            continue
        joints = [int(word) - 1 for word in entry.location.split(":")[1].split("-")]
        p = entry.parameters
        if entry.effect == "joint_zero_offset":
            stands[:, joints[0]] += math.pi * p["offset_deg"] / 180.0
        elif entry.effect == "joint_coupling":
            stands[:, joints[1]] += p["ratio"] * q[:, joints[0]]
        elif entry.effect == "transmission_error":
            rows = zip(*(np.atleast_1d(p[key]) for key in ("per_turn", "cos_arcsec", "sin_arcsec")), strict=True)
            for order, cos, sin in rows:  # as one sine: amplitude and phase
                phase, size = math.atan2(cos, sin), math.hypot(cos, sin)
                stands[:, joints[0]] += math.radians(size / 3600.0) * np.sin(order * q[:, joints[0]] + phase)
        else:
            raise ValueError(f"{entry.effect!r} is no kinematic correction")
    return stands

"""True joint angles from encoder angles, by the cell's kinematic corrections.

This is a second implementation, independent of the planner.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_skipped_check
from machopt.verification.motion.kinematics.as_built_frames import GEOMETRY_EFFECT

FADE_OUT_DEG = 5.0  # beyond its range a transmission error is gone
RANGE_KEY = "range_deg"
ORDER_KEYS = {"transmission_error": "per_turn", "kinematic_correction": "orders"}  # effects that are sums of waves


def compute_true_angles(kinematics: KinematicCorrections | None, q: Array) -> Array:
    """Encoder angles plus every correction at their joints.

    Args:
        kinematics: of the cell; None: encoders and joints agree.
        q: (S, 6) rad by encoder; NaN stays NaN.

    Returns:
        (S, 6) rad.

    Raises:
        ValueError: an effect that is no kinematic correction.
    """
    if kinematics is None:
        return q
    true_angles = q.copy()
    for entry in kinematics.corrections:
        if entry.effect == GEOMETRY_EFFECT:  # no angle: :mod:`machopt.verification.motion.kinematics.as_built_frames`
            continue
        joints = parse_joint_location(entry.location)
        p = entry.parameters
        if entry.effect == "joint_zero_offset":
            true_angles[:, joints[0]] += math.pi * p["offset_deg"] / 180.0
        elif entry.effect == "joint_coupling":
            true_angles[:, joints[1]] += p["ratio"] * q[:, joints[0]]
        elif entry.effect in ORDER_KEYS:
            counts = _compute_applied_share(p.get(RANGE_KEY), q[:, joints[0]])
            rows = zip(
                *(np.atleast_1d(p[key]) for key in (ORDER_KEYS[entry.effect], "cos_arcsec", "sin_arcsec")), strict=True
            )
            for order, cos, sin in rows:  # as one sine: amplitude and phase
                phase, size = math.atan2(cos, sin), math.hypot(cos, sin)
                wave = np.sin(order * q[:, joints[0]] + phase)
                true_angles[:, joints[0]] += math.radians(size / 3600.0) * wave * counts
        elif entry.own is not None:
            true_angles[:, joints[1 if len(joints) > 1 else 0]] += entry.own(q[:, joints[0]])
        else:
            raise ValueError(f"{entry.effect!r} is no kinematic correction")
    return true_angles


def list_unchecked_corrections(kinematics: KinematicCorrections | None) -> list[VerificationCheck]:
    """Return a skipped check for each user-defined correction, which has no second implementation.

    Args:
        kinematics: The cell's kinematic corrections; None where it has none.
    """
    return [
        build_skipped_check(
            f"kinematics.yaml {entry.effect} at {entry.location}",
            f"there is no independent formula for {entry.effect!r}; the position of the arm follows from the "
            "user-defined one",
        )
        for entry in (kinematics.corrections if kinematics is not None else ())
        if entry.own is not None
    ]


def check_correction_range(kinematics: KinematicCorrections | None, q: Array) -> list[VerificationCheck]:
    """Report corrections whose measured range the motion exceeds; this fails nothing.

    Args:
        kinematics: The cell's kinematic corrections; None where it has none.
        q: (S, 6) joint positions by encoder, rad.
    """
    out = []
    for entry in kinematics.corrections if kinematics is not None else ():
        if RANGE_KEY not in entry.parameters:
            continue
        low, high = entry.parameters[RANGE_KEY]
        at = np.degrees(q[:, parse_joint_location(entry.location)[0]])
        beyond = (at < low) | (at > high)
        if beyond.any():
            out.append(
                build_skipped_check(
                    f"kinematics.yaml {entry.effect} at {entry.location}",
                    f"{beyond.sum()} of {len(at)} samples lie outside {RANGE_KEY} {low:g} … {high:g}, at "
                    f"{at[beyond].min():.1f} … {at[beyond].max():.1f}; it is not applied there",
                )
            )
    return out


def _compute_applied_share(limits: tuple[float, float] | None, angle: Array) -> Array:
    """(S,) share that is applied: the regularised incomplete beta function of order (4, 4) at either end."""
    if limits is None:
        return np.ones(len(angle))
    away = np.maximum(limits[0] - np.degrees(angle), np.degrees(angle) - limits[1])
    from scipy.special import betainc  # late: kernels of this module are compiled where scipy is not installed

    return np.asarray(1.0 - betainc(4.0, 4.0, np.clip(away / FADE_OUT_DEG, 0.0, 1.0)))

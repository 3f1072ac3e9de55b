"""Intervals of the joint stiffnesses as built, where springs alone may not explain the readings.

The intervals of a fit hold for the fitted model. The compliance of a base, a link or a tool that the model does not
contain is partly taken up by the springs. The posterior of the model discrepancy has this shift and its covariance. Two
parts are added:

- the gain of the force sensor, common to a session, which no replicate shows;
- to the side of less compliance, a body that rotates about nearly the same axis as the joint: no load separates the
  torsion of a base from joint 1, or that of a tool from joint 6. The joint then has the sum less a part of the size
  that the other directions of the body show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from machopt.data_types.discrepancy_names import AXES, format_body_name, format_joint_name
from machopt.data_types.effect_locations import format_link_location
from machopt.data_types.stiffness import ModelDiscrepancy
from machopt.measurement import thresholds
from machopt.numerics.array_types import Array

ROTATIONS, TRANSLATIONS = AXES[3:], AXES[:3]


@dataclass(frozen=True)
class InseparableSum:
    """Compliance that a joint and a body share about one axis, and what it says of each."""

    joint: int  # 1-based
    body: str  # "base" or "tool"
    compliance: tuple[float, float]  # rad/(N·m), interval of the sum

    @property
    def least_joint_stiffness(self) -> float:
        """Lower bound of the joint's stiffness, N·m/rad; there is no upper one."""
        return 1.0 / self.compliance[1]


def widen_stiffness_interval(
    joint: int,
    k: float,
    interval: tuple[float, float],
    doubt: ModelDiscrepancy,
    sessions: int,
    lever: float,
    level: float,
) -> tuple[float, float]:
    """Widen the interval of a joint's stiffness by the misfit.

    Args:
        joint: Joint, 1-based.
        k: Fitted stiffness, N·m/rad.
        interval: Interval of the fit, N·m/rad; its upper end may be infinite.
        doubt: Model discrepancy of the written stiffness.
        sessions: Number of sessions, each with its own force gain.
        lever: Typical distance of the TCP from the flange, m.
        level: Confidence level.

    Returns:
        The interval of the joint as built, N·m/rad.
    """
    name = format_joint_name("joint", joint)
    if name not in doubt.parts:
        return interval
    own = np.zeros(len(doubt.parts))
    own[doubt.parts.index(name)] = 1.0
    low, high = _compute_compliance_interval(own, k, doubt, sessions, level)
    if doubt.misfit:
        z = float(ndtri(0.5 + level / 2.0))
        middle = 0.5 * (low + high)
        shared = z * max(_estimate_body_size(doubt, body, lever) for body in (joint - 1, joint))
        low = middle - float(np.hypot(middle - low, shared))
    ends = (1.0 / max(high, 1e-300), 1.0 / low if low > 0.0 else np.inf)
    return min(ends[0], interval[0], k), max(ends[1], interval[1], k)


def compute_gain_covariance(joints: Array, sessions: int) -> Array:
    """Compute the covariance of the compliances by the force gain: a common factor of all joints.

    Args:
        joints: (6,) N·m/rad.
        sessions: Number of sessions, each with its own force gain.

    Returns:
        (6, 6) (rad/(N·m))².
    """
    c = 1.0 / joints
    return np.asarray(np.outer(c, c) * thresholds.SHARES.force_gain**2 / max(sessions, 1))


def find_inseparable_sums(
    stiffness: dict[int, float], axes: Array, doubt: ModelDiscrepancy, sessions: int, level: float
) -> tuple[InseparableSum, ...]:
    """Find the joints whose compliance no load separates from that of a body.

    Args:
        stiffness: Fitted stiffness of the identified joints, N·m/rad, by joint (1-based).
        axes: (n, 3) unit axes of the joints in base_link at q = 0.
        doubt: Model discrepancy of the written stiffness.
        sessions: Number of sessions.
        level: Confidence level.

    Returns:
        Joint 1 with the base and the last joint with the tool, where springs alone do not explain the readings.
    """
    if not doubt.misfit:
        return ()
    out = []
    for joint, body in ((1, "base"), (len(axes), "tool")):
        if joint in stiffness and format_joint_name("joint", joint) in doubt.parts:
            weights = _weigh_shared_rotation(joint, body, axes[joint - 1], doubt)
            low, high = _compute_compliance_interval(weights, stiffness[joint], doubt, sessions, level)
            out.append(InseparableSum(joint, body, (max(low, 0.0), high)))
    return tuple(out)


def _weigh_shared_rotation(joint: int, body: str, axis: Array, doubt: ModelDiscrepancy) -> Array:
    """Return the weights (K,) of the parts in the compliance of joint and body about the joint's axis."""
    weights = np.zeros(len(doubt.parts))
    weights[doubt.parts.index(format_joint_name("joint", joint))] = 1.0
    for word, share in zip(ROTATIONS, axis**2, strict=True):
        name = format_body_name(body, word)
        if name in doubt.parts:
            weights[doubt.parts.index(name)] = share
    return weights


def _compute_compliance_interval(
    weights: Array, k: float, doubt: ModelDiscrepancy, sessions: int, level: float
) -> tuple[float, float]:
    """Return the interval (rad/(N·m)) of 1/k and a sum of parts, with the shift by missing effects and force gain."""
    gain = thresholds.SHARES.force_gain / np.sqrt(max(sessions, 1))
    sigma = float(np.hypot(np.linalg.norm(doubt.modes @ weights), gain / k))
    middle = 1.0 / k + float(doubt.shift @ weights)
    z = float(ndtri(0.5 + level / 2.0))
    return middle - z * sigma, middle + z * sigma


def _estimate_body_size(doubt: ModelDiscrepancy, body: int, lever: float) -> float:
    """Return the typical rotational compliance (rad/(N·m)) that the readings show of a body: 0 base, n tool."""
    last = len(doubt.torque)
    place = {0: "base", last: "tool"}.get(body, format_link_location(body))
    turns = _compute_part_size(doubt, [format_body_name(place, a) for a in ROTATIONS])
    if body != last or not lever > 0.0:
        return turns
    return max(turns, _compute_part_size(doubt, [format_body_name(place, a) for a in TRANSLATIONS]) / lever**2)


def _compute_part_size(doubt: ModelDiscrepancy, names: list[str]) -> float:
    at = [doubt.parts.index(n) for n in names if n in doubt.parts]
    if not at:
        return 0.0
    return float(np.sqrt(np.mean(doubt.shift[at] ** 2 + np.sum(doubt.modes[:, at] ** 2, axis=0))))

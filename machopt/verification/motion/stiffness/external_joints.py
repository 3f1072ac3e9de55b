"""Compliance of rails and positioners from stiffness.yaml's ``external_joints``, on pinocchio's frames.

A wrench at the TCP acts with opposite sign on the part. Per unit of an external joint the TCP moves by s relative to
the part. The joint carries sᵀw and moves by sᵀw/k. A body's own compliance C is given in its link's frame at a point
of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.data_types.stiffness import ExternalJointSpring
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.stiffness import spring_terms


def compute_uncertain_twists(
    arm: UrdfKinematics, stance: ArmConfiguration, known: Sequence[ExternalJointSpring], programmed: Array
) -> Array:
    """Return (N, K, 3) s·√σ of the joints whose stiffness has a σ, that of 1/k; s: motion of the TCP against the
    part.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        stance: The arm at N configurations, base_link axes.
        known: Springs of the external joints.
        programmed: (N, 3) programmed TCP positions in base_link, m.
    """
    every = [s for s in known if s.std > 0.0]
    out = np.zeros((len(stance.q), len(every), 3))
    for n, spring in enumerate(every):
        link, axis, slides = arm.compute_external_joint_state(spring.joint, stance)
        moves = axis if slides else np.cross(axis, programmed - link[:, :3, 3])
        out[:, n] = moves * np.sqrt(spring.std) / spring.stiffness
    return out


def compute_external_compliance(
    arm: UrdfKinematics, stance: ArmConfiguration, known: Sequence[ExternalJointSpring], programmed: Array | None = None
) -> Array:
    """Return the (N, 6, 6) compliance at the TCP of all external joints, base_link axes.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        stance: The arm at N configurations, base_link axes.
        known: Springs of the external joints.
        programmed: (N, 3) programmed TCP positions in base_link, m, which the TCP reaches under load on a compensated
            path; None: it is where the joints put it.
    """
    out = np.zeros((len(stance.q), 6, 6))
    if not known:
        return out
    tcp = stance.tcp[:, :3, 3] if programmed is None else programmed
    for spring in known:
        link, axis, slides = arm.compute_external_joint_state(spring.joint, stance)
        if np.isfinite(spring.stiffness):
            s = np.zeros((len(out), 6))
            s[:, :3] = axis if slides else np.cross(axis, tcp - link[:, :3, 3])
            s[:, 3:] = 0.0 if slides else axis
            out += np.einsum("ni,nj->nij", s, s) / spring.stiffness
        at = link[:, :3, 3] + np.einsum("nij,j->ni", link[:, :3, :3], spring.at)
        out += spring_terms.shift_compliance(
            spring_terms.rotate_compliance(spring.compliance, link[:, :3, :3]), tcp - at
        )
    return out

"""Uncertain masses of links in measured poses, with the prior of a URDF's masses.

The weight of a link deflects the joints before it. A mass that is 5 % off moves the TCP of a large arm by several times
the noise of a tracker. It resembles a payload, a gravity compensator or a zero offset of joint 2.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.effect_locations import format_link_location
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.effects import prior_scales
from machopt.kinematics.robot import RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown, UncertainInputs
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings


def build_link_mass_inputs(r: StaticReadings) -> UncertainInputs | None:
    """Build the displacement per relative change of each link's mass.

    Args:
        r: Readings of measured poses.

    Returns:
        Columns and unknowns; None where no stated mass moves the TCP.
    """
    parts, unknowns = [], []
    for link in range(1, r.joint_count) if r.masses is not None else ():  # the mass of the last link is the payload's
        own = _select_link(r.masses, link)
        if own is None:
            continue
        turned = r.compliance * compute_weight_torque(r.robot, own, r.state)
        column = np.sum([r.lift_joint_twist(j, turned[:, j : j + 1])[:, :, 0] for j in range(r.joint_count)], axis=0)
        if np.sqrt(np.mean(column[:, :3] ** 2)) <= thresholds.LIMITS.displacement:
            continue
        parts.append(column)
        unknowns.append(
            BaseUnknown(
                name=f"mass of link {link}, relative",
                unit="1",
                location=format_link_location(link),
                prior=prior_scales.LINK_MASS.scale,
                is_stated=False,
            )
        )
    return UncertainInputs(np.stack(parts, axis=2), tuple(unknowns)) if parts else None


def _select_link(masses: RobotMasses | None, link: int) -> RobotMasses | None:
    """Return the masses of one link; None if it has none."""
    if masses is None:
        return None
    own = (masses.body == link) & (masses.mass > 0.0)
    if not own.any():
        return None
    return RobotMasses(body=masses.body[own], mass=masses.mass[own], com=masses.com[own], gravity=masses.gravity)

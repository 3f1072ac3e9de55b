"""Links without stated masses: the effect of their weight on load tests as coefficients of the base model.

Gravity acts on a moving arm. A load that deflects joint l changes the lever arm of the weight about joint i, which
acts as a spring in parallel to the gear (K = ∂τ/∂q). The deflection at rest changes the lever arms of the load. Both
are linear in the first moments of upper arm and forearm (kg·m, including all bodies behind them). An arm without
stated masses cannot be distinguished from one with a gravity compensator, so neither is reported. Stated masses
remain known.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.effect_locations import format_link_location
from machopt.effects import prior_scales
from machopt.kinematics.robot import RobotMasses
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.estimation.reading_covariance import compute_joint_sensitivity
from machopt.measurement.identification.data_quality.unit_checks import estimate_reach
from machopt.numerics.array_types import Array

LONG_LINKS = (2, 3)  # upper arm and forearm: their moments, including the wrist's weight, act on joints 2 and 3


def list_links_without_mass(masses: RobotMasses | None) -> tuple[int, ...]:
    """List the long links without a stated mass; the mass of a tool alone does not count.

    Args:
        masses: Link and tool masses; None if unknown.

    Returns:
        Link numbers.
    """
    known = set() if masses is None else set(masses.body[masses.mass > 0.0].tolist())
    return tuple(link for link in LONG_LINKS if link not in known)


def has_link_mass(masses: RobotMasses | None) -> bool:
    """Return whether the mass of any long link is stated.

    Args:
        masses: Link and tool masses; None if unknown.

    Returns:
        True if stated.
    """
    return list_links_without_mass(masses) != LONG_LINKS


def list_unknown_moments(masses: RobotMasses | None) -> tuple[int, ...]:
    """List the links with an unknown first moment; the moment of a link includes the links behind it.

    Args:
        masses: Link and tool masses; None if unknown.

    Returns:
        Link numbers.
    """
    return tuple(link for link in LONG_LINKS if link <= max(list_links_without_mass(masses), default=0))


def describe_missing_masses(masses: RobotMasses | None) -> str:
    """Describe the links without a stated mass; at least one must be missing.

    Args:
        masses: Link and tool masses; None if unknown.

    Returns:
        Text.
    """
    links = list_links_without_mass(masses)
    return f"the URDF has no mass of link{'s' if len(links) > 1 else ''} {' and '.join(map(str, links))}"


def build_link_moment_columns(
    r: StaticReadings, gravity: Array, links: tuple[int, ...] = LONG_LINKS
) -> tuple[Array, tuple[BaseUnknown, ...]]:
    """Build the displacement per unit first moment of each link.

    Args:
        r: Readings of a load test.
        gravity: (3,) gravity in base_link, m/s².
        links: Long links, by the joint that moves them.

    Returns:
        (N, D, P) m, rad per kg·m, and the unknowns.
    """
    assert r.state.R_bodies is not None  # load-test states include bodies
    z = np.moveaxis(r.state.J[:, 3:], 2, 0)  # (n, N, 3) axes
    moved = compute_joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions]
    deflection = r.load_torque * r.compliance  # rad under the load
    prior = prior_scales.LINK_FIRST_MOMENT.scale * estimate_reach(r.robot, r.T_flange_tcp) ** 4
    out, unknowns = [], []
    for link in links:
        for k, name in enumerate("xyz"):
            u = r.state.R_bodies[:, link, :, k]
            torque, extra = np.zeros((len(r), r.joint_count)), np.zeros((len(r), r.joint_count))
            for i in range(link):
                torque[:, i] = _compute_dot_products(z[i], np.cross(u, gravity))
                for other in range(link):
                    a, b = z[min(i, other)], z[max(i, other)]
                    extra[:, i] += _compute_dot_products(a, np.cross(np.cross(b, u), gravity)) * deflection[:, other]
            turned = r.state.J[:, : r.dimensions] * (extra * r.compliance)[:, None, :]
            column = turned.sum(axis=2) + np.einsum("ndj,nj->nd", moved, torque * r.compliance)
            if not column.any():
                continue
            out.append(column)
            unknowns.append(
                BaseUnknown(
                    name=f"weight of link {link}, {name}",
                    unit="kg·m",
                    location=format_link_location(link),
                    prior=prior,
                    is_stated=False,
                )
            )
    return np.stack(out, axis=2) if out else np.zeros((len(r), r.dimensions, 0)), tuple(unknowns)


def _compute_dot_products(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("nc,nc->n", a, b))

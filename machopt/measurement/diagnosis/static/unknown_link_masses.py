"""Links whose masses no file tells: what their weight may do to a load test, as coefficients of the base model.

Weight turns with the arm. A load that bends joint l moves the weight's lever about joint i, which is a spring of its
own beside the gear (K = ∂τ/∂q), and the sag at rest moves every lever arm of the load. Both are linear in the first
moments of upper arm and forearm (kg·m, with what hangs behind them), so an arm whose file has no masses is told from
one with a balancer by neither, and neither is named for it. What a file does state stays known beside them.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.locations import format_link_location
from machopt.kinematics.robot import RobotMasses
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.estimation.reading_covariance import compute_joint_sensitivity
from machopt.measurement.identification.data_quality.unit_checks import estimate_reach
from machopt.numerics.array_types import Array

LONG_LINKS = (2, 3)  # upper arm and forearm: their moments reach joints 2 and 3, the wrist's weight with them


def list_links_without_mass(masses: RobotMasses | None) -> tuple[int, ...]:
    """The long links whose weight the file does not tell; a tool alone does not make an arm weigh."""
    known = set() if masses is None else set(masses.body[masses.mass > 0.0].tolist())
    return tuple(link for link in LONG_LINKS if link not in known)


def has_link_mass(masses: RobotMasses | None) -> bool:
    """Whether the file tells of any long link what it weighs."""
    return list_links_without_mass(masses) != LONG_LINKS


def list_unknown_moments(masses: RobotMasses | None) -> tuple[int, ...]:
    """Links whose moment is unknown: a link hangs on those before it, whose moments hold its weight at the elbow."""
    return tuple(link for link in LONG_LINKS if link <= max(list_links_without_mass(masses), default=0))


def describe_missing_masses(masses: RobotMasses | None) -> str:
    """What the URDF lacks, in words; not asked where it lacks nothing."""
    links = list_links_without_mass(masses)
    return f"the URDF has no mass of link{'s' if len(links) > 1 else ''} {' and '.join(map(str, links))}"


def build_link_moment_columns(
    r: StaticReadings, gravity: Array, links: tuple[int, ...] = LONG_LINKS
) -> tuple[Array, tuple[BaseUnknown, ...]]:
    """(N, D, P) displacement per kg·m of first moment of each link, and what they are called.

    Args:
        r: of a load test.
        gravity: (3,) m/s² in base_link.
        links: long links, by the joint that moves them.
    """
    assert r.state.R_bodies is not None  # load tests keep them
    z = np.moveaxis(r.state.J[:, 3:], 2, 0)  # (6, N, 3) axes
    moved = compute_joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions]
    bent = r.load_torque * r.compliance  # rad under the load
    prior = thresholds.RESTING.first_moment * estimate_reach(r.robot, r.T_flange_tcp) ** 4
    out, unknowns = [], []
    for link in links:
        for k, name in enumerate("xyz"):
            u = r.state.R_bodies[:, link, :, k]
            torque, extra = np.zeros((len(r), 6)), np.zeros((len(r), 6))
            for i in range(link):
                torque[:, i] = _compute_dot_products(z[i], np.cross(u, gravity))
                for other in range(link):
                    a, b = z[min(i, other)], z[max(i, other)]
                    extra[:, i] += _compute_dot_products(a, np.cross(np.cross(b, u), gravity)) * bent[:, other]
            turned = r.state.J[:, : r.dimensions] * (extra * r.compliance)[:, None, :]
            column = turned.sum(axis=2) + np.einsum("ndj,nj->nd", moved, torque * r.compliance)
            if not column.any():
                continue
            out.append(column)
            unknowns.append(
                BaseUnknown(
                    name=f"weight of link {link}, {name}", unit="kg·m", location=format_link_location(link), prior=prior
                )
            )
    return np.stack(out, axis=2) if out else np.zeros((len(r), r.dimensions, 0)), tuple(unknowns)


def _compute_dot_products(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("nc,nc->n", a, b))

"""Compliance matrices of beams at their loaded end, clamped at the other; local axes, x along the beam.

Order of rows: translation x, y, z in m, rotation x, y, z in rad; of columns: force, moment. Euler–Bernoulli,
prismatic, isotropic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix


def compute_bending_compliance(length: float) -> Array:
    """(6, 6) compliance of bending per unit of 1/(E·I), both planes alike; L³/3, L²/2, L (zhang2025 eq. 19's inverse).

    Args:
        length: m.
    """
    x, y, z = np.eye(3)
    return compute_single_axis_bending_compliance(y, x, length) + compute_single_axis_bending_compliance(z, x, length)


def compute_single_axis_bending_compliance(axis: Array, along: Array, length: float) -> Array:
    """(6, 6) compliance of bending about one principal axis alone, per unit of its 1/(E·I).

    Args:
        axis: (3,) the principal axis.
        along: (3,) the beam's, clamped end to loaded end.
        length: m.
    """
    shift, L = np.cross(axis, along), length  # a moment about z lifts the end of a beam along x to +y
    C = np.zeros((6, 6))
    C[:3, :3] = L**3 / 3.0 * np.outer(shift, shift)
    C[:3, 3:] = L**2 / 2.0 * np.outer(shift, axis)
    C[3:, :3] = C[:3, 3:].T
    C[3:, 3:] = L * np.outer(axis, axis)
    return C


def compute_torsion_compliance(length: float) -> Array:
    """Return the compliance of torsion per unit of 1/(G·J).

    Args:
        length: Length of the beam, m.

    Returns:
        (6, 6) with the length as rotation about the beam per unit moment.
    """
    C = np.zeros((6, 6))
    C[3, 3] = length
    return C


def compute_axial_compliance(length: float) -> Array:
    """Return the compliance of axial extension per unit of 1/(E·A).

    Args:
        length: Length of the beam, m.

    Returns:
        (6, 6) with the length as translation along the beam per unit force.
    """
    C = np.zeros((6, 6))
    C[0, 0] = length
    return C


@dataclass(frozen=True)
class BeamCylinder:
    """One step of a tool: a solid round bar, or a tube."""

    diameter: float  # m
    length: float  # m
    youngs: float  # Pa
    poisson: float = 0.3
    bore: float = 0.0  # m

    @property
    def EI(self) -> float:
        """Bending stiffness E π (D⁴ − d⁴)/64 in N·m². tian2025 calls I "polar"; eq. 2 needs the area moment."""
        return self.youngs * np.pi * (self.diameter**4 - self.bore**4) / 64.0

    @property
    def GJ(self) -> float:
        """Torsional stiffness G π (D⁴ − d⁴)/32 in N·m²."""
        return self.youngs / (2.0 * (1.0 + self.poisson)) * np.pi * (self.diameter**4 - self.bore**4) / 32.0

    @property
    def EA(self) -> float:
        """Axial stiffness E π (D² − d²)/4 in N."""
        return self.youngs * np.pi * (self.diameter**2 - self.bore**2) / 4.0


def compute_cylinder_compliance(cylinder: BeamCylinder) -> Array:
    """Return the compliance of one cylinder at its loaded end: bending, torsion and extension.

    Args:
        cylinder: Dimensions and material of the cylinder.

    Returns:
        (6, 6) in m/N, 1/N and rad/(N·m), x along the cylinder.
    """
    L = cylinder.length
    return np.asarray(
        compute_bending_compliance(L) / cylinder.EI
        + compute_torsion_compliance(L) / cylinder.GJ
        + compute_axial_compliance(L) / cylinder.EA
    )


def compute_stepped_beam_compliance(cylinders: Sequence[BeamCylinder]) -> Array:
    """Return the compliance at the tip of cylinders in series.

    Each cylinder also carries the moment of the tip force and rotates all cylinders after it. The sum of L³/3EI
    (tian2025 eq. 3) neglects this; see :func:`compute_tian2025_tip_compliance`.

    Args:
        cylinders: Cylinders in order, the clamped one first.

    Returns:
        (6, 6) in m/N, 1/N and rad/(N·m), x along the beam.
    """
    C = np.zeros((6, 6))
    for cylinder in cylinders:
        C = shift_compliance_along_beam(C, cylinder.length) + compute_cylinder_compliance(cylinder)
    return C


def shift_compliance_along_beam(C: Array, distance: float) -> Array:
    """Return a compliance at a point rigidly connected further along local x: G C Gᵀ.

    Args:
        C: (6, 6) compliance at the current point.
        distance: Distance along +x, m.

    Returns:
        (6, 6) compliance at the shifted point.
    """
    G = np.eye(6)
    G[:3, 3:] = -skew_matrix(np.array([distance, 0.0, 0.0]))
    return np.asarray(G @ C @ G.T)


def compute_tian2025_tip_compliance(cylinders: Sequence[BeamCylinder]) -> float:
    """Return the lateral tip compliance by tian2025 eqs. 2–3: Σ L³/(3 E I), without lever arms.

    For comparison only. The result is right for a long thin bur behind a stiff holder. It is far too stiff for a soft
    holder far from the tip.

    Args:
        cylinders: Cylinders in order, the clamped one first.

    Returns:
        Lateral compliance, m/N.
    """
    return float(sum(c.length**3 / (3.0 * c.EI) for c in cylinders))

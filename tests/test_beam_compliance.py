"""Beams and stepped cylinders, compared with a numerical sum over slices and with the equations of two papers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from machopt.effects.compliance_matrices.beam_compliance import (
    BeamCylinder,
    compute_axial_compliance,
    compute_bending_compliance,
    compute_cylinder_compliance,
    compute_stepped_beam_compliance,
    compute_tian2025_tip_compliance,
    compute_torsion_compliance,
)

EI, GJ, EA = 3.0e5, 2.2e5, 4.0e8  # N·m², N·m², N: a steel tube of about 120 mm diameter


def slices(w: np.ndarray, length: float, stiffness: list[tuple[float, float, float, float]], n: int) -> np.ndarray:
    """Compute the twist (6,) of the end of a clamped bar under a wrench there by a sum over slices; x along the bar.

    ``stiffness``: (up to which share of the length, EI, GJ, EA). Each slice rotates by κ dx and extends by ε dx; its
    rotation displaces the end by the remaining lever.
    """
    x = (np.arange(n) + 0.5) / n
    section = np.array(stiffness)[np.searchsorted([s[0] for s in stiffness], x)]
    lever = length * (1.0 - x)[:, None] * [1.0, 0.0, 0.0]
    moment = w[3:] + np.cross(lever, w[:3])
    turn = moment / section[:, [2, 1, 1]] * length / n
    shift = np.cross(turn, lever) + (w[0] / section[:, 3] * length / n)[:, None] * [1.0, 0.0, 0.0]
    return np.concatenate([shift.sum(axis=0), turn.sum(axis=0)])


def test_cantilever_equals_the_integrated_beam_equation() -> None:
    L = 0.45
    C = compute_bending_compliance(L) / EI + compute_torsion_compliance(L) / GJ + compute_axial_compliance(L) / EA
    by_slices = np.column_stack([slices(e, L, [(1.0, EI, GJ, EA)], 4000) for e in np.eye(6)])
    # midpoint rule on a quadratic function: relative error 1/(4 n²) = 1.6e-8
    np.testing.assert_allclose(C, by_slices, rtol=1e-7, atol=1e-20)


def test_stepped_cylinder_equals_many_slices() -> None:
    steps = [
        BeamCylinder(0.060, 0.09, 210e9, 0.3, 0.025),
        BeamCylinder(0.032, 0.03, 210e9),
        BeamCylinder(0.020, 0.06, 600e9, 0.22),
    ]
    total = sum(s.length for s in steps)
    ends = np.cumsum([s.length for s in steps]) / total
    parts = [(e + 1e-12, s.EI, s.GJ, s.EA) for e, s in zip(ends, steps, strict=True)]
    # 30 µm; steps are at slice boundaries
    by_slices = np.column_stack([slices(e, total, parts, 6000) for e in np.eye(6)])
    np.testing.assert_allclose(compute_stepped_beam_compliance(steps), by_slices, rtol=1e-7, atol=1e-18)
    # section moments by a sum over rings: ∫ r² dA over the annulus is twice the bending moment of area
    r = np.linspace(0.0125, 0.030, 200_001)
    middle = 0.5 * (r[1:] + r[:-1])
    polar = float(np.sum(2 * np.pi * middle**3 * np.diff(r)))
    assert steps[0].GJ / (steps[0].youngs / 2.6) == pytest.approx(polar, rel=1e-8)
    assert steps[0].EI / steps[0].youngs == pytest.approx(polar / 2, rel=1e-8)
    assert steps[0].EA / steps[0].youngs == pytest.approx(float(np.sum(2 * np.pi * middle * np.diff(r))), rel=1e-8)


def test_tian2025_equations_2_and_3_omit_the_lever_arms() -> None:
    """The sum of L³/3EI compared with the slices: correct for one cylinder, a quarter of the correct value for two
    halves.

    With two halves of one bar the sum is 2 (L/2)³/3EI, a quarter of L³/3EI; the error is larger for a soft holder far
    from the tip.
    """
    bar, half = BeamCylinder(0.02, 0.1, 210e9), BeamCylinder(0.02, 0.05, 210e9)
    assert compute_tian2025_tip_compliance([bar]) == pytest.approx(
        compute_stepped_beam_compliance([bar])[1, 1], rel=1e-12
    )
    assert compute_tian2025_tip_compliance([half, half]) == pytest.approx(
        compute_stepped_beam_compliance([half, half])[1, 1] / 4, rel=1e-12
    )
    np.testing.assert_allclose(
        compute_stepped_beam_compliance([half, half]), compute_stepped_beam_compliance([bar]), rtol=1e-12, atol=1e-22
    )
    holder, bur = BeamCylinder(0.016, 0.06, 110e9), BeamCylinder(0.008, 0.05, 210e9)  # an aluminium holder, a steel bur
    right, printed = (
        compute_stepped_beam_compliance([holder, bur])[1, 1],
        compute_tian2025_tip_compliance([holder, bur]),
    )
    assert printed / right == pytest.approx(0.56, abs=0.01)  # 1.8 times too stiff
    area_for_polar = (
        compute_cylinder_compliance(replace(bar, youngs=2 * bar.youngs))[1, 1] / compute_cylinder_compliance(bar)[1, 1]
    )
    assert area_for_polar == pytest.approx(0.5)  # the literal use of "polar moment of inertia" halves it again


def planar_beam_as_zhang2025(length: float, EI: float, EA: float) -> np.ndarray:
    """Return the (6, 6) matrix of zhang2025 Eqs. 17 and 19 as printed: two nodes of a plane beam, [u, v, θ] at each.

    The paper uses its pseudo-inverse as the spatial stiffness of one end. This is incorrect: rows 4–6 belong to the
    other end of the beam, so a force along z acts on the axial stiffness of the far node. For comparison only.
    """
    L = length
    a, b, c, d, e = EA / L, 12 * EI / L**3, 6 * EI / L**2, 4 * EI / L, 2 * EI / L
    return np.array(
        [
            [a, 0, 0, -a, 0, 0],
            [0, b, c, 0, -b, c],
            [0, c, d, 0, -c, e],
            [-a, 0, 0, a, 0, 0],
            [0, -b, -c, 0, b, -c],
            [0, c, e, 0, -c, d],
        ]
    )


def test_zhang2025_equations_17_and_19_are_not_the_stiffness_of_one_end() -> None:
    """The printed 6 × 6 matrix is singular, and its pseudo-inverse is not a cantilever: comparison of the values."""
    L = 0.4
    K = planar_beam_as_zhang2025(L, EI, EA)
    assert np.linalg.matrix_rank(K / np.abs(K).max(), tol=1e-12) == 3  # a free plane beam has three rigid motions
    for rigid in ([1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], [0, 0, 1, 0, L, 1]):
        assert np.abs(K @ rigid).max() < 1e-9 * np.abs(K).max()
    # clamped at the first node, as the paper assumes, the other half of the matrix is the plane cantilever
    right = compute_bending_compliance(L) / EI + compute_torsion_compliance(L) / GJ + compute_axial_compliance(L) / EA
    plane = np.ix_([0, 1, 5], [0, 1, 5])
    np.testing.assert_allclose(np.linalg.inv(K[3:, 3:]), right[plane], rtol=1e-9, atol=1e-18)
    # the matrix that the paper uses instead, interpreted for (x, y, z, rx, ry, rz)
    P = np.linalg.pinv(K, rcond=1e-12)
    assert P[0, 0] / right[0, 0] == pytest.approx(0.25, rel=1e-9)  # along x: 4 times too stiff
    assert P[1, 1] < 0.15 * right[1, 1]  # lateral: both ends move together and rotate rigidly
    # row 3 is the rotation of the near end about z, but is used for a force along z: the value depends on the length
    # unit
    assert P[2, 2] > 0.2 * L / EI
    assert right[2, 2] == pytest.approx(right[1, 1])  # a round beam has the same bending compliance in both planes
    assert not np.isclose(P[2, 2], P[1, 1], rtol=0.5)
    assert P[3, 3] == pytest.approx(P[0, 0], rel=1e-9)  # a moment about x is assigned the extension of the other end
    assert P[0, 3] == pytest.approx(-P[0, 0], rel=1e-9)  # and extends the near end

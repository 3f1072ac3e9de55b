"""Góra and Trela, FANUC S-420F: numerical example from Table 1 and from formula (A.3)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.urdf_loading import load_robot

CELL = Path(__file__).resolve().parent.parent / "cells" / "s420f_handling"
H = np.pi / 2
ALPHA = (H, 0.0, H, -H, H, 0.0)  # Table 1
L1, L2, L3 = 0.270, 0.900, 0.270  # m
LAMBDA4, LAMBDA6 = 1.300, 0.260  # m
THETA = np.radians([-84.91, 65.00, -12.31, 0.00, 9.64, 0.00])  # section 2.1, "by solving the inverse problem"
POSITION = np.array([279.85, 2751.95, 145.14])  # mm, section 2.1
PUMA = np.array([66.230, 66.50, 11.610, 0.202, 0.101, 0.144]) * 1e3  # N·m/rad
KR240 = np.array([1.410, 0.401, 0.935, 0.360, 0.370, 0.380])  # printed as kN·m/rad
C33_PUMA, C33_MEASURED = 0.00183, 0.0059  # mm/N
K33_PUMA, K33_MEASURED = 546.6, 169.5  # printed in mm/N; N/mm is meant


def chain(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of the flange and its Jacobian from Table 1 by standard Denavit-Hartenberg."""
    T, axes, points = np.eye(4), [], []
    for t, d, a, alpha in zip(theta, (0, 0, 0, LAMBDA4, 0, LAMBDA6), (L1, L2, L3, 0, 0, 0), ALPHA, strict=True):
        axes.append(T[:3, 2])
        points.append(T[:3, 3])
        c, s, ca, sa = np.cos(t), np.sin(t), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    z, lever = np.array(axes), T[:3, 3] - np.array(points)
    return T, np.hstack([np.cross(z, lever), z]).T


def levers_a3(theta: np.ndarray, mended: bool) -> np.ndarray:
    """Return the terms that (A.3) squares and divides by κ_2 … κ_5, in m: as printed except for a stray line, or
    corrected.

    The stray line, "++(s23 c4 s5 − c23 c5) λ6)", belongs to no bracket. Errors: κ_2 has l1, which joint 2 does not
    rotate, and l2 s2 for l2 c2; κ_3 has −c1 s4 for s1 s4; κ_4 has s1 s23 c5 for c1 s23 c5.
    """
    c1, c2, _, c4, c5, _ = np.cos(theta)
    s1, s2, _, s4, s5, _ = np.sin(theta)
    c23, s23 = np.cos(theta[1] + theta[2]), np.sin(theta[1] + theta[2])
    a = (s1 * c23 * c4 - c1 * s4) * s5 + s1 * s23 * c5
    b = (c1 * c23 * c4 + s1 * s4) * s5 + c1 * s23 * c5
    b3 = b if mended else (c1 * c23 * c4 - c1 * s4) * s5 + c1 * s23 * c5
    b4 = b if mended else (c1 * c23 * c4 + s1 * s4) * s5 + s1 * s23 * c5
    upper_s = L2 * c2 if mended else L1 + L2 * c2
    upper_c = L2 * c2 if mended else L2 * s2
    fore = L3 * c23 + s23 * LAMBDA4
    return np.array(
        [
            s1 * (s1 * (upper_s + fore) + LAMBDA6 * a) + c1 * (c1 * (upper_c + fore) + b * LAMBDA6),
            s1 * (s1 * fore + LAMBDA6 * a) + c1 * (c1 * fore + b3 * LAMBDA6),
            c1 * s23 * (s1 * s23 * LAMBDA4 + LAMBDA6 * a) - s1 * s23 * (c1 * s23 * LAMBDA4 + b4 * LAMBDA6),
            LAMBDA6 * ((-c1 * c23 * s4 + s1 * c4) * a + (s1 * c23 * s4 + c1 * c4) * b),
        ]
    )


def c33(levers: np.ndarray, k: np.ndarray) -> float:
    """Return the vertical compliance in mm/N from lever arms (m) of joints 2 and 3; joint 1 has none."""
    return float(1e3 * np.sum(levers[:2] ** 2 / k[1:3]))


# --- formula (A.3) -----------------------------------------------------------------------------------------


def test_a3_has_four_errors_and_is_the_third_jacobian_row_without_them() -> None:
    """κ is the stiffness here; eq. 8 defines it as the compliance."""
    wrong = np.zeros(4)
    for theta in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 6)):
        ours = chain(theta)[1][2, 1:5]
        # the squares remove the signs
        np.testing.assert_allclose(np.abs(levers_a3(theta, mended=True)), np.abs(ours), atol=1e-12)
        wrong = np.maximum(wrong, np.abs(np.abs(levers_a3(theta, mended=False)) - np.abs(ours)))
    assert (wrong[:3] > 0.1).all()  # m
    assert wrong[3] < 1e-12  # κ_5 is printed correctly


def test_shipped_cell_has_the_same_levers() -> None:
    robot = load_robot(load_cell(CELL))
    ours = robot.compute_fk_jacobian(THETA - np.array([0, H, 0, 0, 0, 0]))[1]
    np.testing.assert_allclose(ours[2, 1:3], chain(THETA)[1][2, 1:3], atol=1e-9)


# --- the example -------------------------------------------------------------------------------------------


def test_stated_position_is_out_of_reach() -> None:
    """2766 mm from axis 1; Table 1 reaches at most 2758, and its angles give 2078 on the opposite side."""
    stated = float(np.hypot(POSITION[0], POSITION[1]))
    reach = 1e3 * (L1 + L2 + np.hypot(L3, LAMBDA4) + LAMBDA6)
    assert stated == pytest.approx(2766.1, abs=0.1)
    assert reach == pytest.approx(2757.7, abs=0.1)
    assert stated > reach
    T, _ = chain(THETA)
    np.testing.assert_allclose(1e3 * T[:3, 3], [184.38, -2070.06, 121.72], atol=0.01)
    assert np.hypot(T[0, 3], T[1, 3]) == pytest.approx(2.0783, abs=1e-4)
    # θ1 is the azimuth of the position with the opposite sign, with an error of the 0.73° that it prints as φ_z
    azimuth = np.degrees(np.arctan2(POSITION[1], POSITION[0]))
    assert azimuth == pytest.approx(84.19, abs=0.01)
    assert abs(-84.91) - azimuth == pytest.approx(0.72, abs=0.01)
    # θ2 is also outside the ±57.5° of Table 1 unless its zero is the upright arm (θ2 − 90° = −25°)
    second = float(np.degrees(THETA[1]))
    assert abs(second - 90) < 57.5 < second


def test_computed_compliance_does_not_follow_from_the_stated_inputs() -> None:
    """Printed: 0.00183 mm/N; the PUMA 560 values give 0.225 mm/N from Table 1 and 0.241 mm/N from (A.3) as printed."""
    levers = chain(THETA)[1][2, 1:3]
    np.testing.assert_allclose(levers, [1.8083, 1.4279], atol=1e-4)
    ours = c33(levers, PUMA)
    assert ours == pytest.approx(0.2248, abs=1e-4)
    np.testing.assert_allclose(levers_a3(THETA, mended=False)[:2], [2.0796, 1.4279], atol=1e-4)
    assert c33(levers_a3(THETA, mended=False), PUMA) == pytest.approx(0.2406, abs=1e-4)
    # not a unit error: neither a power of ten, nor 180/π or its square
    assert ours / C33_PUMA == pytest.approx(122.8, abs=0.1)
    # the omitted wrist increases the compliance: 0.1 to 0.2 kN·m/rad with lever arms of about 0.1 m
    full = 1e3 * np.sum(chain(THETA)[1][2] ** 2 / PUMA)
    assert full > ours
    assert full == pytest.approx(0.750, abs=1e-3)
    # the stated position does not explain it: 2.50 m from axis 2, joint 2 alone gives 51 times the printed value
    lever = np.hypot(POSITION[0], POSITION[1]) / 1e3 - L1
    assert 1e3 * lever**2 / PUMA[1] / C33_PUMA == pytest.approx(51.2, abs=0.1)


def test_measured_compliance_is_38_times_stiffer_than_puma_values() -> None:
    """The measured 0.0059 mm/N is 38 times less than with the PUMA values,
    and 3 times *more* than the paper computes."""
    ours = c33(chain(THETA)[1][2, 1:3], PUMA)
    assert ours / C33_MEASURED == pytest.approx(38.1, abs=0.1)
    times = C33_MEASURED / C33_PUMA
    assert times == pytest.approx(
        3.22, abs=0.01
    )  # more compliance; the paper concludes "three times greater" stiffness
    cell = load_cell(CELL)
    assert cell.stiffness is not None  # the shipped values are those of the PUMA times this ratio
    np.testing.assert_allclose(cell.stiffness.joints[:3], PUMA[:3] * ours / C33_MEASURED, rtol=2e-3)  # three digits
    assert c33(chain(THETA)[1][2, 1:3], cell.stiffness.joints) == pytest.approx(C33_MEASURED, rel=2e-3)


def test_printed_stiffness_is_the_reciprocal_not_the_matrix_element() -> None:
    """k33 = 1/c33 to the printed digits; the (3, 3) element of C_tt⁻¹, which the text names, is 3.5 times that."""
    assert pytest.approx(K33_PUMA, rel=3e-3) == 1 / C33_PUMA  # 0.00183 has three digits
    assert pytest.approx(K33_MEASURED, rel=1e-2) == 1 / C33_MEASURED  # two digits
    J = chain(THETA)[1][:3, :3]
    C = 1e3 * (J / PUMA[:3]) @ J.T
    assert np.linalg.inv(C)[2, 2] * C[2, 2] == pytest.approx(3.546, abs=1e-3)


def test_kr240_values_are_cited_a_thousand_times_too_soft() -> None:
    """In kN·m/rad (1.41) the arm of dumas2011 would deflect by 10 mm/N, 46 times a PUMA; in MN·m/rad by 0.010 mm/N."""
    levers = chain(THETA)[1][2, 1:3]
    assert c33(levers, KR240 * 1e3) == pytest.approx(10.33, abs=0.01)
    assert c33(levers, KR240 * 1e3) / c33(levers, PUMA) == pytest.approx(46.0, abs=0.1)
    assert c33(levers, KR240 * 1e6) == pytest.approx(0.01033, abs=1e-5)

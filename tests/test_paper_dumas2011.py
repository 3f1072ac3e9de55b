"""Dumas et al. (2011), KUKA KR240-2: printed values compared with the paper's own equations.

Table 3 states d2, d3, d4, RL4 and RL6 as symbols only. The manufacturer's data sheet has 350, 1250, 55, 1100 and 230
mm; section "geometry" below determines the signs.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.stiffness.kinetostatic_indices import (
    CharacteristicLength,
    GeometricInfluence,
    compute_characteristic_length,
    compute_conditioning_index,
    compute_geometric_influence,
    compute_geometric_stiffness,
    compute_loaded_compliance,
)

CELL = Path(__file__).resolve().parent.parent / "cells" / "kr240_drilling"
D2, D3, D4, RL4, RL6 = 0.350, 1.250, 0.055, 1.100, 0.230  # m
L = 0.682  # m, section 3.1
WRENCH = np.array([0, 0, -2000.0, 200.0, 200.0, 0])  # N, N·m, section 3.2
CITED = np.array([1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5])  # N·m/rad, cited from this paper in gora-trela
TABLE_2 = np.array([3.8e6, 6.6e6, 3.9e6, 5.6e5, 6.6e5, 4.7e5])  # N·m/rad
TABLE_2_ERROR = np.array([3e5, 5.2e5, 3.7e5, 1e4, 1.4e4, 2.2e4])  # N·m/rad
TABLE_2_PERCENT = np.array([8, 8, 9, 2, 2, 5])
ZONES = ((0, 110, -245, -170), (0, 25, 0, 29), (100, 146, 0, 29))  # Table 1: θ2 and θ3 from … to, degrees


def dhm(theta: float, d: float, alpha: float, r: float) -> np.ndarray:
    """Return a row of Table 3: α_j about and d_j along x_(j−1), then θ_j about and r_j along z_j."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s, 0, d], [s * ca, c * ca, -sa, -r * sa], [s * sa, c * sa, ca, r * ca], [0, 0, 0, 1]])


@cache
def table_3(d4: float = D4) -> Robot:
    """Return the paper's arm with the joint ranges of Table 1 and the data sheet;
    its flange is O6, RL6 from the wrist."""
    q = np.pi / 2
    rows = ((0, 0, 0), (D2, q, 0), (D3, 0, 0), (d4, -q, RL4), (0, q, 0), (0, -q, RL6))
    T, axes, points = np.eye(4), [], []
    for d, alpha, r in rows:
        T = T @ dhm(0.0, d, alpha, r)
        axes.append(T[:3, 2])
        points.append(T[:3, 3])
    lower, upper = np.radians([[-185, 0, -245, -350, -125, -350.0], [185, 146, 29, 350, 125, 350.0]])
    return Robot(
        joints=tuple("123456"),
        axis=np.array(axes),
        point=np.array(points),
        T_base_flange_zero=T,
        lower=lower,
        upper=upper,
    )


def printed_jacobian(t: np.ndarray, d2: float, d3: float, d4: float, R4: float, R6: float) -> np.ndarray:
    """Return Eq. 31 as printed, term by term, including misprints."""
    (c1, c2, _, c4, c5, _), (s1, s2, _, s4, s5, _) = np.cos(t), np.sin(t)
    c23, s23 = np.cos(t[1] + t[2]), np.sin(t[1] + t[2])
    return np.array(
        [
            [
                -d2 * s1
                - d3 * c2 * s1
                - d4 * c23 * s1
                + R4 * s1 * s23
                + R6 * c5 * s1 * s23
                + R6 * c23 * c4 * s1 * s5
                + R6 * c1 * s4 * s5,
                -R4 * c1 * c23 - R6 * c1 * c23 * c5 - d3 * c1 * s2 - d4 * c1 * s23 + R6 * c1 * c4 * s23 * s5,
                -R4 * c1 * c23 - R6 * c1 * c23 * c5 - d4 * c1 * s23 + R6 * c1 * c4 * s23 * s5,
                R6 * c4 * s1 * s5 + R6 * c1 * c23 * s4 * s5,
                -R6 * c1 * c23 * c4 * c5 + R6 * c5 * s1 * s4 + R6 * c1 * s23 * s5,
                0,
            ],
            [
                d2 * c1
                + d3 * c1 * c2
                + d4 * c1 * c23
                - R4 * c1 * s23
                - R6 * c1 * c5 * s23
                - R6 * c1 * c23 * c4 * s5
                + R6 * s1 * s4 * s5,
                -R4 * c23 * s1 - R6 * c23 * c5 * s1 - d3 * s1 * s2 - d4 * s1 * s23 + R6 * c4 * s1 * s23 * s5,
                -R4 * c23 * s1 - R6 * c23 * c5 * s1 - d4 * s1 * s23 + R6 * c4 * s1 * s23 * s5,
                -R6 * c1 * c4 * s5 + R6 * c23 * s1 * s4 * s5,
                -R6 * c23 * c4 * c5 * s1 - R6 * c1 * c5 * s4 + R6 * s1 * s23 * s5,
                0,
            ],
            [
                0,
                d3 * c2
                + d4 * c23
                - R4 * s23
                - R6 * c5 * s23
                - R6 * c23 * c4 * s5 * d4 * c23
                - R4 * s23
                - R6 * c5 * s23
                - R6 * c23 * c4 * s5,
                R6 * s23 * s4 * s5,
                -R6 * c4 * c5 * s23,
                -R6 * c23 * s5,
                0,
            ],
            [0, s1, s1, -c1 * s23, c4 * s1 + c1 * c23 * s4, -c1 * c5 * s23 - c1 * c23 * c4 * s5 + s1 * s4 * s5],
            [0, -c1, -c1, -s1 * s23, -c1 * c4 + c23 * s1 * s4, -c5 * s1 * s23 - c23 * c4 * s1 * s5 - c1 * s4 * s5],
            [1, 0, 0, c23, s23 * s4, c23 * c5 - c4 * s23 * s5],
        ]
    )


def plane(step: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (θ2, θ3) in degrees over the joint ranges of Table 1, and q with θ1 = 0,
    θ4 = θ5 = θ6 = 45° (section 3.1)."""
    two, three = np.meshgrid(np.arange(0, 146.5, step), np.arange(-245, 29.5, step), indexing="ij")
    q = np.full((*two.shape, 6), np.pi / 4)
    q[..., 0], q[..., 1], q[..., 2] = 0.0, np.radians(two), np.radians(three)
    return two, three, q


def in_zone(two: np.ndarray, three: np.ndarray, zone: tuple[int, int, int, int]) -> np.ndarray:
    return np.asarray((two >= zone[0]) & (two <= zone[1]) & (three >= zone[2]) & (three <= zone[3]))


# --- appendix A: the Jacobian ------------------------------------------------------------------------------


def test_equation_31_is_correct_except_its_third_row() -> None:
    """J_32 contains J_33 (a product where the line should end), and the following labels are shifted by one."""
    robot, wrong = table_3(), np.zeros((6, 6))
    for t in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 6)):
        ours, theirs = robot.compute_fk_jacobian(t)[1], printed_jacobian(t, D2, D3, D4, RL4, RL6)
        wrong = np.maximum(wrong, np.abs(ours - theirs))
        c2, c4, c5, s4, s5 = np.cos(t[1]), np.cos(t[3]), np.cos(t[4]), np.sin(t[3]), np.sin(t[4])
        c23, s23 = np.cos(t[1] + t[2]), np.sin(t[1] + t[2])
        j33 = D4 * c23 - RL4 * s23 - RL6 * c5 * s23 - RL6 * c23 * c4 * s5  # the unlabelled second half of "J_32"
        assert ours[2, 2] == pytest.approx(j33, abs=1e-12)
        assert ours[2, 1] == pytest.approx(D3 * c2 + j33, abs=1e-12)
        assert ours[2, 3] == pytest.approx(theirs[2, 2], abs=1e-12)  # "J_33" is J_34
        assert theirs[2, 2] == pytest.approx(RL6 * s23 * s4 * s5, abs=1e-15)
        # J_35 is divided into "J_34" and "J_35"
        assert ours[2, 4] == pytest.approx(theirs[2, 3] + theirs[2, 4], abs=1e-12)
    slips = np.zeros((6, 6), bool)
    slips[2, 1:5] = True
    assert wrong[~slips].max() < 1e-12
    assert wrong[slips].min() > 0.1  # m/rad: J_32 to J_35, each wrong by more than half of RL6


def test_shipped_cell_equals_table_3_in_kuka_angles() -> None:
    """θ = (−A1, −A2, −A3 − 90°, −A4, −A5, −A6): Table 1's θ3 of −245° to 29° is the A3 of 155° to −119°."""
    cell = load_cell(CELL)
    shipped, paper = load_robot(cell), table_3()
    A = np.random.default_rng(1).uniform(np.maximum(shipped.lower, -3), np.minimum(shipped.upper, 3), (20, 6))
    sign = -np.ones(6)
    theta = sign * A - np.array([0, 0, np.pi / 2, 0, 0, 0])
    ours, theirs = shipped.compute_fk_jacobian(A)[1], paper.compute_fk_jacobian(theta)[1]
    np.testing.assert_allclose(ours, theirs * sign, atol=1e-12)
    np.testing.assert_allclose(
        shipped.compute_fk(A)[:, :3, 3], paper.compute_fk(theta)[:, :3, 3] + [0, 0, 0.750], atol=1e-12
    )
    mirrored = table_3(-D4).compute_fk_jacobian(theta)[1]
    assert np.abs(ours - mirrored * sign).max() > 0.1  # with RL4 > 0 the 55 mm of the data sheet are d4 = +55


# --- geometry: L, reach, zones -----------------------------------------------------------------------------


def length_of(robot: Robot, tool: np.ndarray, bounded: bool = False) -> CharacteristicLength:
    return compute_characteristic_length(
        robot, tool, (robot.lower, robot.upper) if bounded else None, starts=512, refined=8
    )


def test_characteristic_length_agrees_at_the_bare_flange_within_the_joint_ranges() -> None:
    """Section 3.1: 0.682 m. Only d4 = +55 mm, the ranges of the data sheet and the flange give its three digits."""
    robot = table_3()
    bounded = length_of(robot, np.eye(4), bounded=True)
    assert bounded.length == pytest.approx(0.68215, abs=2e-5)
    assert round(bounded.length, 3) == L
    free = length_of(robot, np.eye(4))
    assert free.length == pytest.approx(0.68260, abs=2e-5)  # without ranges: 0.683
    assert free.condition < bounded.condition
    mirror = table_3(-D4)
    other = length_of(mirror, np.eye(4), bounded=True)
    assert other.length == pytest.approx(free.length, abs=2e-5)  # d4 = −55: the free minimum is within the ranges
    shipped = load_robot(load_cell(CELL))
    same = length_of(shipped, np.eye(4), bounded=True)
    assert same.length == pytest.approx(bounded.length, abs=2e-5)
    # the length depends on the end point: it differs at the wrist centre and with the shipped spindle
    wrist, tool = np.eye(4), load_cell(CELL).tool.T_flange_tcp
    wrist[2, 3] = -RL6
    assert length_of(robot, wrist).length == pytest.approx(0.773, abs=1e-3)
    assert length_of(shipped, tool).length == pytest.approx(0.594, abs=1e-3)


def test_reach_of_2700_mm_is_the_stretched_wrist_centre() -> None:
    """Section 4: 2700 mm = 350 + 1250 + 1100; with the 55 mm it is 1.4 mm more."""
    reach, straight = D2 + D3 + np.hypot(RL4, D4), D2 + D3 + RL4
    assert straight == pytest.approx(2.700)
    wrist = np.eye(4)
    wrist[2, 3] = -RL6
    q = np.array([0, 0, np.arctan2(D4, RL4) - np.pi / 2, 0, 0, 0])
    assert np.linalg.norm(table_3().compute_fk(q, wrist)[:3, 3]) == pytest.approx(reach, abs=1e-12)
    assert reach == pytest.approx(2.7014, abs=5e-5)


def test_zones_of_table_1_are_the_dexterous_ones() -> None:
    two, three, q = plane()
    index = compute_conditioning_index(table_3().compute_fk_jacobian(q)[1], L)
    zones = [in_zone(two, three, z) for z in ZONES]
    outside = np.median(index[~(zones[0] | zones[1] | zones[2])])
    assert index.max() == pytest.approx(0.557, abs=1e-3)
    assert outside == pytest.approx(0.316, abs=1e-3)
    for zone, low, middle in zip(zones, (0.380, 0.467, 0.440), (0.449, 0.524, 0.498), strict=True):
        assert index[zone].min() == pytest.approx(low, abs=2e-3)
        assert np.median(index[zone]) == pytest.approx(middle, abs=2e-3)
        assert index[zone].min() > outside
    # zhang2025 cites this paper for "K_C is negligible above 0.45": not all of the zones are above it (nor does the
    # paper state that)
    assert [np.mean(index[z] > 0.45) for z in zones] == pytest.approx([0.48, 1.0, 0.98], abs=0.01)
    # of as many best configurations as the zones contain, 73 % are in the zones; 26 % would be by chance
    area = np.mean(zones[0] | zones[1] | zones[2])
    best = index >= np.quantile(index, 1 - area)
    assert area == pytest.approx(0.263, abs=1e-3)
    assert np.mean(best[zones[0] | zones[1] | zones[2]]) == pytest.approx(0.726, abs=2e-3)


def test_singular_lines_of_figure_3() -> None:
    """det J = d3 √(d4² + RL4²) r sin(θ3 − θ3s) sin θ5, where r is the distance of the wrist centre from axis 1.

    The oblique line r = 0 is as in the paper. The horizontal line inside the joint range is the stretched arm (θ3s =
    −87°), not "folded": the folded arm, 93°, is out of range.
    """
    q = plane()[2]
    stretched = float(np.arctan2(D4, RL4)) - np.pi / 2
    t2, t23 = q[..., 1], q[..., 1] + q[..., 2]
    r = D2 + D3 * np.cos(t2) + D4 * np.cos(t23) - RL4 * np.sin(t23)
    closed = D3 * np.hypot(D4, RL4) * r * np.sin(q[..., 2] - stretched) * np.sin(np.pi / 4)
    J = table_3().compute_fk_jacobian(q)[1]
    np.testing.assert_allclose(np.linalg.det(J), closed, atol=1e-13)
    assert np.degrees(stretched) == pytest.approx(-87.14, abs=0.01)
    assert -245 < np.degrees(stretched) < 29
    assert np.degrees(stretched) + 180 > 29
    on_line = q[::20, 0].copy()
    on_line[:, 2] = stretched
    assert (
        compute_conditioning_index(table_3().compute_fk_jacobian(on_line)[1], L).max() < 1e-12
    )  # the angle itself is rounded to 1e-16
    # the oblique line passes between Z2c (θ2 ≤ 25°) and Z3c (θ2 ≥ 100°), at the height of both
    t3 = np.radians(14.5)
    near, far = (D2 + D3 * np.cos(t) + D4 * np.cos(t + t3) - RL4 * np.sin(t + t3) for t in np.radians([25.0, 100.0]))
    assert near > 0 > far


def test_location_of_the_zones_depends_on_the_length() -> None:
    """Section 3.1 states that it does not. This is true for the singular lines; the best quarter of the plane moves."""
    q = plane()[2]
    robot = table_3()
    J = robot.compute_fk_jacobian(q)[1]
    base = compute_conditioning_index(J, L)
    best = base >= np.quantile(base, 0.737)  # the same share as the zones of Table 1
    retained = []
    for length in (L / 2, 2 * L):
        other = compute_conditioning_index(J, length)
        retained.append(float(np.mean((other >= np.quantile(other, 0.737))[best])))
    assert retained == pytest.approx([0.80, 0.67], abs=0.01)
    turned = q[::10, ::10].copy()
    turned[..., 0] = 1.1  # "the first revolute joint does not affect the robot dexterity": this is correct
    np.testing.assert_allclose(
        compute_conditioning_index(robot.compute_fk_jacobian(turned)[1], L), base[::10, ::10], rtol=1e-10
    )


# --- section 3.2: the influence of K_C ---------------------------------------------------------------------


def influence(k: np.ndarray, tool: float = 0.0, wrench: np.ndarray = WRENCH) -> GeometricInfluence:
    T = np.eye(4)
    T[2, 3] = tool
    J = table_3().compute_fk_jacobian(plane(2.0)[2], T)[1]
    return compute_geometric_influence(J, k, compute_geometric_stiffness(J, wrench), wrench)


def test_complementary_stiffness_is_small_with_the_cited_joint_stiffness() -> None:
    """ν_p ≤ 0.016 and ν_r ≤ 0.025°: near the bound with the cited values, ten times smaller with Table 2."""
    cited, table = influence(CITED), influence(TABLE_2)
    assert cited.nu_p.max() == pytest.approx(0.0141, abs=2e-4)
    assert np.degrees(cited.nu_r.max()) == pytest.approx(0.0071, abs=2e-4)
    assert table.nu_p.max() == pytest.approx(0.00124, abs=2e-5)
    assert np.degrees(table.nu_r.max()) == pytest.approx(0.0001, abs=5e-5)
    for found in (cited, table):
        assert found.nu_p.max() <= 0.016
        assert np.degrees(found.nu_r.max()) <= 0.025
    # an end point 0.4 m in front of the flange gives 0.016; the paper does not state the point of application of the
    # load
    ahead = influence(CITED, 0.4)
    assert ahead.nu_p.max() == pytest.approx(0.0160, abs=2e-4)
    assert np.degrees(ahead.nu_r.max()) == pytest.approx(0.0103, abs=2e-4)  # two fifths of the printed bound
    # the bound is valid for this wrench, not for the arm: with one moment reversed it is exceeded
    reversed_moment = influence(CITED, wrench=WRENCH * np.array([1, 1, 1, -1, 1, 1]))
    assert reversed_moment.nu_p.max() == pytest.approx(0.0164, abs=2e-4)


def test_measured_displacements_support_table_2() -> None:
    """Section 5.3: an average gap of 0.1 mm is the unexplained 20 % of the displacement, which is therefore 0.5 mm.

    Under 2000 N of hanging weight the median in the zones is 0.9 mm with Table 2 and 9 mm with the cited values, for
    which 20 % would be 1.8 mm. The influence of K_C (above) and the displacements belong to different sets of values.
    """
    two, three, q = plane(5.0)
    J = table_3().compute_fk_jacobian(q)[1]
    weight = np.array([0, 0, -2000.0, 0, 0, 0])
    zones = np.any([in_zone(two, three, z) for z in ZONES], axis=0)
    middle = []
    for k in (TABLE_2, CITED):
        C = compute_loaded_compliance(J, k, compute_geometric_stiffness(J, weight))
        middle.append(float(np.median(np.linalg.norm((C @ weight)[zones][:, :3], axis=1))))
    assert middle == pytest.approx([0.00093, 0.0092], rel=0.02)


# --- section 5.2: scatter of the identified stiffness ------------------------------------------------------


def test_table_2_percentages_follow_from_its_errors_but_the_text_does_not() -> None:
    share = 100 * TABLE_2_ERROR / TABLE_2
    np.testing.assert_allclose(share, TABLE_2_PERCENT, atol=0.5)  # rounded to whole percent
    # the text gives joint 2 as "±1e5 N·m/rad, i.e. 8 %"; 8 % of 6.6e6 is 5.3e5, as in Table 2
    assert 100 * 1e5 / TABLE_2[1] == pytest.approx(1.5, abs=0.05)


def scatter(k: np.ndarray, in_mm: bool, seed: int, draws: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviation and bias of k in percent, by eq. 26 from ten simulated tests with the stated errors.

    A hanging force of 1000 to 2500 N on a lever of 0.5 m (at most 1250 N·m); three targets 0.3 m around the flange,
    each measured to 0.03 mm before and after; balance 0.1 kg; encoders 0.01°.
    """
    rng, robot, n = np.random.default_rng(seed), table_3(), 10
    low, high = np.radians([[-90, 0, 0, -90, 30, -180.0], [90, 0, 0, 90, 90, 180.0]])
    q = rng.uniform(low, high, (n, 6))
    for i in range(n):
        z = np.radians(ZONES[i % 3])
        q[i, 1:3] = rng.uniform(z[[0, 2]], z[[1, 3]])
    force, lever = rng.normal(size=(2, n, 3))
    force *= rng.uniform(1000, 2500, (n, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
    lever *= 0.5 / np.linalg.norm(lever, axis=1, keepdims=True)

    def regressor(q: np.ndarray, force: np.ndarray) -> np.ndarray:  # A of eq. 21, stacked as eq. 23
        J = robot.compute_fk_jacobian(q)[1]
        return np.asarray(J * np.einsum("nci,nc->ni", J, np.c_[force, np.cross(lever, force)])[:, None, :])

    angle = 2 * np.pi * np.arange(3) / 3
    targets = 0.3 * np.c_[np.cos(angle), np.sin(angle), 0 * angle] @ np.swapaxes(robot.compute_fk(q)[:, :3, :3], 1, 2)
    x, y, z = np.moveaxis(targets, -1, 0)
    o = np.zeros_like(x)
    spin = np.stack([np.stack(r, -1) for r in ([o, z, -y], [-z, o, x], [y, -x, o])], -2)  # ω × p
    screw = np.linalg.pinv(np.concatenate([np.broadcast_to(np.eye(3), spin.shape), spin], -1).reshape(n, 9, 6))
    moved = np.einsum("nij,j->ni", regressor(q, force), 1 / k)
    weight = np.array([1e3 if in_mm else 1.0] * 3 + [1.0] * 3)
    fits = []
    for _ in range(draws):
        noise = rng.normal(0, 0.03e-3 * np.sqrt(2), (n, 9, 1))
        pull = 1 + rng.normal(0, 0.1 * 9.81, (n, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
        A = regressor(q + rng.normal(0, np.radians(0.01), (n, 6)), force * pull)
        c = moved + (screw @ noise)[..., 0]
        fits.append(1 / np.linalg.lstsq((A * weight[:, None]).reshape(-1, 6), (c * weight).ravel(), rcond=None)[0])
    return 100 * np.std(fits, axis=0) / k, 100 * (np.mean(fits, axis=0) / k - 1)


def test_plain_least_squares_scatters_as_in_table_2() -> None:
    """Table 2 prints 2 to 9 %; ten random tests in the zones give 2.3 to 9.0 %, median 3 to 5 % per joint.

    The distribution over the joints is not that of the paper (8, 8, 9, 2, 2, 5): it depends on the ten tests, which are
    not given.
    """
    runs = np.array([scatter(TABLE_2, in_mm=False, seed=s) for s in range(16)])
    np.testing.assert_allclose(np.median(runs[:, 0], axis=0), [3.6, 4.2, 4.5, 4.3, 5.1, 3.1], atol=0.3)
    assert runs[:, 0].min() > 1.5  # the printed 2 and 9 are whole percent
    assert runs[:, 0].max() < 9.5
    assert (
        np.abs(runs[:, 1]).max() < 2.0
    )  # percent of bias: 1/x of a scattered x, the square of 9 %, and its own scatter
    # the softer cited values would give larger displacements under the same loads and far less scatter than the printed
    # 8 to 9 %
    soft = np.array([scatter(CITED, in_mm=False, seed=s)[0] for s in range(16)])
    np.testing.assert_allclose(np.median(soft, axis=0)[:3], [1.3, 0.25, 1.1], atol=0.1)


def test_equation_26_depends_on_the_unit_of_length() -> None:
    """Eq. 26 adds squares of metres and of radians; in millimetres it is a different estimator."""
    metres, mm = (np.median([scatter(TABLE_2, u, s)[0] for s in range(8)], axis=0) for u in (False, True))
    assert (mm[:3] < 0.7 * metres[:3]).all()  # the noisy rotations no longer have influence next to the translations
    assert mm[3] > 1.2 * metres[3]  # but the rotations determine the wrist stiffness

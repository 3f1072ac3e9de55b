"""Stability: published numbers, the coupled limit against full solutions, known stability limits, modes, resonance."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from delay_reference import ChebyshevMap, DelaySystem, first_unstable, semi_discretization_radius
from numpy.typing import NDArray

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import CuttingInputError
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.milling_cut import MillingCut, MillingCutter
from machopt.process.stability import (
    DelayLaw,
    StructuralModes,
    build_tool_modes,
    compute_arm_modes,
    compute_depth_limit,
    compute_directional_matrix,
    compute_feedback_coefficients,
    compute_single_mode_limits,
    compute_stability_lobes,
    compute_tooth_period,
    find_lobe_minimum,
    find_resonances,
    merge_modes,
)

Array = NDArray[np.float64]
TWO = MillingCutter(diameter=0.02, teeth=2, helix=math.radians(30), length=0.1)

# 13 modes of a milling robot: direction, damped frequency (Hz), damping (%), imaginary residue (cited)
MODES_13 = np.array(
    [
        [-0.34, 0.90, 0.23, 7.07, 3.74, 4.38e-5],
        [-0.47, 0.21, -0.85, 10.29, 2.21, 3.105e-5],
        [-0.92, -0.17, 0.33, 16.02, 2.30, 2.353e-5],
        [-0.32, 0.92, 0.20, 18.49, 3.32, 2.6875e-5],
        [-0.76, 0.62, 0.14, 34.39, 4.00, 1.28e-5],
        [-0.91, 0.04, 0.40, 37.81, 3.84, 1.78e-5],
        [-0.53, 0.84, -0.14, 72.67, 5.05, 3.888e-5],
        [-0.72, 0.35, 0.58, 107.81, 4.84, 1.345e-5],
        [-0.79, -0.12, 0.59, 116.76, 7.60, 2.92e-5],
        [0.75, 0.35, 0.55, 121.93, 3.44, 2.525e-6],
        [-0.64, -0.55, 0.51, 141.74, 2.07, 2.53e-6],
        [-0.83, -0.39, 0.38, 193.88, 3.67, 7.04e-6],
        [0.40, 0.81, -0.42, 253.25, 3.88, 3.72e-6],
    ]
)
ROBOT_CUT = (632.6e6, -205.8e6, -43.5e6)  # N/m²; the radial coefficient is negative in the source
ANGLES = (0, 45, 90, 135)
SCREEN = {  # mm, published limits, one mode at a time
    3000: (1.68, 0.95, 2.52, 0.70),
    7200: (4.02, 2.28, 6.05, 1.68),
    12000: (6.70, 3.81, 10.09, 2.81),
    18000: (10.05, 5.71, 15.13, 4.21),
}
FULL = {  # mm, published limits, semi-discretization with 24 intervals
    7200: (4.33, 2.58, 6.19, 1.69),
    12000: (6.96, 4.13, 10.12, 2.81),
    18000: (10.21, 6.11, 15.31, 4.21),
}


def coefficients(Kt: float, Kr: float, Ka: float = 0.0) -> MillingCoefficients:
    return MillingCoefficients(
        Ktc_Pa=Kt,
        Krc_Pa=Kr,
        Kac_Pa=Ka,
        Kte_N_m=0.0,
        Kre_N_m=0.0,
        Kae_N_m=0.0,
        h_range_m=(0.0, 1e-3),
        sigma_log=0.0,
        source="",
    )


def robot_modes(angles: tuple[int, ...] = ANGLES) -> StructuralModes:
    """Return the cited modes for feed angles in degrees: the shapes rotate by minus the angle."""
    zeta, residue = MODES_13[:, 4] / 100, MODES_13[:, 5]
    omega = 2 * np.pi * MODES_13[:, 3] / np.sqrt(1 - zeta**2)
    u = MODES_13[:, :3] / np.linalg.norm(MODES_13[:, :3], axis=1, keepdims=True) * np.sqrt(2 * residue * omega)[:, None]
    turned = []
    for angle in np.radians(angles):
        c, s = np.cos(angle), np.sin(angle)
        turned.append(u @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]).T)
    many = (len(angles), 13)
    return StructuralModes(np.broadcast_to(omega, many).copy(), np.broadcast_to(zeta, many).copy(), np.array(turned))


def directional(K: tuple[float, float, float], cutter: MillingCutter, side: str, ae: float) -> Array:
    cut = MillingCut(side)
    arc = compute_contact_arc(cutter, cut, np.array(ae), cutter.radius)
    return compute_directional_matrix(coefficients(*K), cutter, cut, arc)


def reference(
    modes: StructuralModes, row: int, K: tuple[float, float, float], side: str, ae: float, T: float
) -> DelaySystem:
    theta = math.acos(1 - 2 * ae / TWO.diameter)
    start, end = (0.0, theta) if side == "up" else (math.pi - theta, math.pi)
    return DelaySystem(modes.omega[row], modes.zeta[row], modes.shape[row], 2, start, end, K, T)


def one_mode(omega: float, zeta: float, stiffness: float, direction: tuple[float, float, float]) -> StructuralModes:
    return build_tool_modes([omega / 2 / np.pi], [zeta], [stiffness], np.array([direction]))


# --- tests of the references

SLOT = {"omega": 2 * np.pi * 922, "mass": 0.03993, "zeta": 0.011}


def slot_benchmark(rpm: float, immersion: float) -> DelaySystem:
    shape = np.array([[1 / math.sqrt(SLOT["mass"]), 0.0, 0.0]])
    start = math.acos(2 * immersion - 1)
    period = 60 / (2 * rpm)
    return DelaySystem(
        np.array([SLOT["omega"]]), np.array([SLOT["zeta"]]), shape, 2, start, math.pi, (6e8, 2e8, 0.0), period
    )


def test_published_multipliers_of_the_slot_benchmark() -> None:
    full = ChebyshevMap(slot_benchmark(5000, 1.0), 24, 3)
    found = [full.radius(w * 1e-3) for w in (0.2, 0.5, 0.7, 1.0)]
    np.testing.assert_allclose(found, [0.819743, 1.073976, 1.221556, 1.406473], atol=2e-4)


@pytest.mark.parametrize(
    ("immersion", "expected"),
    [
        (1.0, (0.4086, 0.3206, 0.3224, 2.7070, 0.3866, 0.5076, 1.4175, 3.9399)),
        (0.5, (0.8472, 1.6120, 2.1047, 0.6570, 2.5962, 1.0884, 0.7196, 1.0377)),
        (0.1, (1.2963, 1.9213, 2.5184, 1.0125, 4.3437, 1.3757, 1.2215, 1.6288)),
        (0.05, (2.2069, 2.6226, 4.0907, 1.7846, 8.2125, 2.2831, 2.2987, 2.9117)),
    ],
)
def test_published_depths_of_the_slot_benchmark(immersion: float, expected: tuple[float, ...]) -> None:
    for rpm, depth in zip((5000, 7500, 10000, 12500, 15000, 17500, 20000, 25000), expected, strict=True):
        full = ChebyshevMap(slot_benchmark(rpm, immersion), 16, 3)
        low, high = (full.radius(depth * 1e-3 * share) for share in (0.99, 1.01))
        assert low < 1 < high, (rpm, low, high)


@pytest.mark.slow
def test_semi_discretization_converges_to_the_collocation() -> None:
    """With 30 intervals per cycle of the mode the limit is about 1 % too large, as published."""
    system = slot_benchmark(5000, 1.0)
    cycles = SLOT["omega"] / 2 / np.pi * system.period
    coarse, fine = (semi_discretization_radius(system, 0.2e-3, round(k * cycles)) for k in (30, 60))
    exact = ChebyshevMap(system, 24, 3).radius(0.2e-3)
    assert abs(fine - exact) < 0.6 * abs(coarse - exact) < 0.01


# --- single-mode limit and coupled limit


def test_published_screen_of_the_robot() -> None:
    H = directional(ROBOT_CUT, TWO, "down", 0.005)
    modes = robot_modes()
    for rpm, expected in SCREEN.items():
        found = compute_single_mode_limits(modes, H, compute_tooth_period(rpm, 2)).min(axis=1)
        np.testing.assert_allclose(found * 1e3, expected, rtol=1e-3, atol=0.005)


def test_published_feedback_coefficient_of_the_robot() -> None:
    """The published program includes arcs at entry and exit, which the closed form neglects: 6 %."""
    H = directional(ROBOT_CUT, TWO, "down", 0.005)
    gain = compute_feedback_coefficients(robot_modes((90,)), H, float(compute_tooth_period(7200, 2)), 1e-3)
    assert gain[0, 0] == pytest.approx(0.17374, rel=0.06)


def test_the_sign_of_the_radial_coefficient_matters() -> None:
    """Published limits: 6.05 and 10.34 mm at a feed angle of 90°."""
    T = compute_tooth_period(7200, 2)
    for Kr, depth in ((-205.8e6, 6.05), (205.8e6, 10.34)):
        H = directional((632.6e6, Kr, -43.5e6), TWO, "down", 0.005)
        limits = compute_single_mode_limits(robot_modes((90,)), H, T)
        assert limits.min() * 1e3 == pytest.approx(depth, abs=0.01)


@pytest.mark.parametrize("rpm", [7200, 12000, 18000])
def test_the_coupled_limit_of_the_robot_against_the_full_solution(rpm: int) -> None:
    """All chatter has ωT < 0.5: the limit is never above the full solution, at most 5 % below it; the published full
    solution agrees within 1.8 %."""
    modes, T = robot_modes(), float(compute_tooth_period(rpm, 2))
    limit = compute_depth_limit(modes, directional(ROBOT_CUT, TWO, "down", 0.005), T)
    assert (limit.omega * T < 0.5).all()
    for row, depth in enumerate(limit.depth):
        full = ChebyshevMap(reference(modes, row, ROBOT_CUT, "down", 0.005, T), 10)
        assert full.radius(depth) < 1
        assert full.radius(depth / 0.95) > 1
        exact = first_unstable(full.radius, 0.9 * depth, 2 * depth, 1.02)
        assert exact * 1e3 == pytest.approx(FULL[rpm][row], rel=0.018)  # the published solution has 24 intervals


def test_the_coupled_limit_of_the_robot_at_low_speed_is_on_the_safe_side() -> None:
    """At 3000 rpm chatter has ωT up to 1: the limit is 0 to 15 % below the full solution."""
    modes, T = robot_modes(), float(compute_tooth_period(3000, 2))
    limit = compute_depth_limit(modes, directional(ROBOT_CUT, TWO, "down", 0.005), T)
    for row, depth in enumerate(limit.depth):
        full = ChebyshevMap(reference(modes, row, ROBOT_CUT, "down", 0.005, T), 12)
        assert full.radius(depth) < 1
        assert full.radius(depth / 0.85) > 1


def random_modes(rng: np.random.Generator) -> StructuralModes:
    n = int(rng.integers(2, 4))
    f = [rng.uniform(7, 12)]
    while len(f) < n:
        f.append(f[-1] * (rng.uniform(1.003, 1.15) if rng.random() < 0.45 else rng.uniform(1.15, 1.5)))
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    omega = 2 * np.pi * np.array(f)
    shape = u * (omega / np.sqrt(10 ** rng.uniform(5.5, 6.7, n)))[:, None]
    return StructuralModes(omega[None], rng.uniform(0.02, 0.05, (1, n)), shape[None])


@pytest.mark.proof
def test_the_coupled_limit_of_random_modes_against_the_full_solution() -> None:
    """200 sets of two or three modes, more than a third of them closer than 15 %, all modes with ωT < 0.5."""
    rng = np.random.default_rng(39)
    K, ratios, close, sets, high = (767e6, 168.8e6, 222e6), [], 0, 0, []
    while sets < 200:
        modes, rpm, ae = random_modes(rng), rng.uniform(6000, 18000), rng.uniform(0.001, 0.010)
        side, T = ("up", "down")[int(rng.integers(2))], 60 / (2 * rpm)
        if modes.omega.max() * T > 0.5:
            continue
        sets += 1
        close += bool((modes.omega[0, 1:] / modes.omega[0, :-1] < 1.15).any())
        limit = compute_depth_limit(modes, directional(K, TWO, side, ae), T, largest=0.08)
        full = ChebyshevMap(reference(modes, 0, K, side, ae, T), 8)
        exact = first_unstable(full.radius, 1e-6, 0.08, 1.05)
        if limit.omega[0] * T < 0.5:
            ratios.append(limit.depth[0] / exact)
        else:  # chatter far above the modes, at depths that are stable only because the process stiffens the modes
            high.append((limit.depth[0], exact))
    assert close >= 67
    assert len(ratios) > 80
    assert max(ratios) <= 1.0
    assert min(ratios) >= 0.95
    for depth, exact in high:
        assert exact > 0.01
        assert min(depth, 0.08) < 1.15 * min(exact, 0.08)


@pytest.mark.slow
def test_the_limit_is_the_least_depth_of_the_characteristic_equation() -> None:
    """Reference: eigenvalues of the expanded equation as a function of depth, chatter below ωT = 1."""
    rng = np.random.default_rng(7)
    K, found = (767e6, 168.8e6, 222e6), 0
    for _ in range(60):
        modes, T = random_modes(rng), 60 / (2 * rng.uniform(6000, 18000))
        H = directional(K, TWO, ("up", "down")[int(rng.integers(2))], rng.uniform(0.001, 0.01))
        limit = compute_depth_limit(modes, H, T, DelayLaw.SECOND_ORDER).depth[0]
        w, z, u = modes.omega[0], modes.zeta[0], modes.shape[0]
        G, n = u @ H @ u[:, :2].T, len(w)

        def growth(a: float, w: Array = w, z: Array = z, G: Array = G, T: float = T, n: int = n) -> float:
            inverse = np.linalg.inv(np.eye(n) + a * T * T / 2 * G)
            lower = np.hstack([-inverse @ np.diag(w**2), -inverse @ (np.diag(2 * z * w) - a * T * G)])
            values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))
            return float(values[np.abs(values) * T < 1].real.max())

        depths = 1e-6 * 1.02 ** np.arange(700)
        unstable = next((k for k, a in enumerate(depths) if growth(a) > 0), None)
        if math.isfinite(limit):
            found += 1
            assert unstable is not None
            assert depths[unstable - 1] * (1 - 1e-6) <= limit <= depths[unstable] * (1 + 1e-6)
    assert found > 20


def scan_depth(modes: StructuralModes, H: Array, T: float, exact: bool) -> float:
    """Reference: both eigenvalues on a dense frequency grid, linearly interpolated."""
    w, z, u = modes.omega[0], modes.zeta[0], modes.shape[0]
    circles = [x * (1 + y * np.tan(np.linspace(-1.55, 1.55, 3000))) for x, y in zip(w, z, strict=True)]
    grid = np.unique(np.concatenate([np.linspace(1e-3, max(w.max() * 3, 2 * np.pi / T), 30000), *circles]))
    grid = grid[grid > 0] if exact else grid[(grid > 0) & (grid * T < 1)]
    inverse = 1 / (w**2 - grid[:, None] ** 2 + 2j * z * w * grid[:, None])
    p = 1 - np.exp(-1j * grid * T) if exact else 1j * grid * T + 0.5 * (grid * T) ** 2
    f = np.linalg.eigvals(np.einsum("wn,ni,nj->wij", inverse, u[:, :2], u @ H)) * p[:, None]
    for a, b in itertools.pairwise(f):
        if abs(b - a).sum() > abs(b[::-1] - a).sum():
            b[:] = b[::-1].copy()
    best = 0.0
    for y in f.T:
        for i in np.flatnonzero((y.imag[1:] > 0) != (y.imag[:-1] > 0)):
            share = y.imag[i] / (y.imag[i] - y.imag[i + 1])
            best = max(best, float(y.real[i] + share * (y.real[i + 1] - y.real[i])))
    return 1 / best if best > 1 else math.inf


@pytest.mark.proof
@pytest.mark.parametrize("exact", [False, True])
def test_every_zero_crossing_is_found(exact: bool) -> None:
    """One to six modes, some nearly equal, arbitrary matrices, ωT up to 30."""
    rng, law = np.random.default_rng(11), DelayLaw.ZEROTH_ORDER if exact else DelayLaw.SECOND_ORDER
    found = 0
    for _ in range(60):
        n = int(rng.integers(1, 7))
        w = np.sort(2 * np.pi * rng.uniform(6, 80, n))
        if n > 1 and rng.random() < 0.5:
            w[1] = w[0] * rng.uniform(1.0005, 1.05)
        u = rng.normal(size=(n, 3)) * rng.uniform(0.01, 0.1, (n, 1))
        modes = StructuralModes(np.sort(w)[None], rng.uniform(0.005, 0.08, (1, n)), u[None])
        H, T = rng.normal(size=(3, 2)) * 1e9, 10 ** rng.uniform(-3, -1.2)
        limit, dense = compute_depth_limit(modes, H, T, law).depth[0], scan_depth(modes, H, T, exact)
        assert math.isinf(limit) == math.isinf(dense)
        if math.isfinite(limit):
            found += 1
            assert limit == pytest.approx(dense, rel=3e-3)
    assert found > 20


def test_lobes_are_found_at_many_turns_of_the_delay() -> None:
    """A mode at 1.5 kHz and 300 rpm: ωT is 940, and the limit is near the absolute minimum."""
    modes = one_mode(2 * np.pi * 1500, 0.02, 2e7, (0.0, 1.0, 0.0))
    H = directional((767e6, 168.8e6, 222e6), TWO, "up", 0.01)
    limit, least = compute_stability_lobes(modes, H, np.array([300.0]), 2).depth[0], find_lobe_minimum(modes, H).depth
    assert least <= limit < 1.02 * least


def test_mirrored_spindle_mirrors_the_directional_matrix() -> None:
    left = replace(TWO, helix=-TWO.helix)
    arc = compute_contact_arc(TWO, MillingCut("up"), np.array([0.004, 0.01]), TWO.radius)
    K = coefficients(767e6, 168.8e6, 222e6)
    m3 = compute_directional_matrix(K, TWO, MillingCut("up", "cw"), arc)
    m4 = compute_directional_matrix(K, left, MillingCut("up", "ccw"), arc)
    np.testing.assert_allclose(m4, np.array([1, -1, 1])[:, None] * m3 * np.array([1, -1]))


def test_directional_matrix_equals_the_mean_over_one_rotation() -> None:
    for side in ("up", "down"):
        H = directional((767e6, 168.8e6, 222e6), TWO, side, 0.006)
        system = reference(robot_modes((0,)), 0, (767e6, 168.8e6, 222e6), side, 0.006, 1.0)
        mean = np.mean([system.directional((k + 0.5) / 20000) for k in range(20000)], axis=0)
        np.testing.assert_allclose(H, mean, rtol=0, atol=1e-3 * np.abs(H).max())


# --- zeroth-order solution

LEEKUN = build_tool_modes(
    [456.78, 1448.89, 516.52, 1408.45],
    [0.1117, 0.01704, 0.02458, 0.03136],
    [7.933e6, 14.692e6, 9.375e6, 12.406e6],
    np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]]),
)
ALUMINIUM = (1319.4e6, 788.8e6, 0.0)


def test_published_minimum_of_the_lobes() -> None:
    half = find_lobe_minimum(LEEKUN, directional(ALUMINIUM, TWO, "down", 0.01))
    assert half.depth * 1e3 == pytest.approx(0.9571, rel=2e-4)
    assert half.omega / 2 / np.pi == pytest.approx(1440.2, abs=0.1)
    slot = find_lobe_minimum(LEEKUN, directional(ALUMINIUM, TWO, "slot", 0.02))
    assert slot.depth * 1e3 == pytest.approx(0.5230, rel=2e-4)
    assert slot.omega / 2 / np.pi == pytest.approx(1448, abs=0.6)


def test_published_lobes_over_the_spindle_speed() -> None:
    H = directional(ALUMINIUM, TWO, "down", 0.01)
    speeds = np.array([4000, 6000, 8000, 10000, 12000, 15000.0])
    lobes = compute_stability_lobes(LEEKUN, H, speeds, 2)
    np.testing.assert_allclose(lobes.depth * 1e3, [1.091, 1.607, 1.134, 1.449, 0.959, 1.719], rtol=1e-2)


@pytest.mark.slow
def test_published_semi_discretization_of_the_two_directions() -> None:
    """The published values use 120 intervals; converged limits are up to 4 % lower, because few intervals per cycle
    overestimate the limit."""
    published = np.array([0.985, 1.863, 1.140, 1.569, 0.917, 1.629])
    for rpm, depth in zip((4000, 6000, 8000, 10000, 12000, 15000), published * 1e-3, strict=True):
        system = reference(LEEKUN, 0, ALUMINIUM, "down", 0.01, 60 / (2 * rpm))
        low, high = (semi_discretization_radius(system, depth * share, 120) for share in (0.99, 1.01))
        assert low < 1 < high
        full = ChebyshevMap(system, 24, 2)
        exact = first_unstable(full.radius, 0.7 * depth, 1.1 * depth, 1.02)
        assert 0.955 * depth < exact < depth


def test_lobes_touch_but_never_fall_below_their_minimum() -> None:
    H = directional(ALUMINIUM, TWO, "down", 0.01)
    least = find_lobe_minimum(LEEKUN, H)
    lobes = compute_stability_lobes(LEEKUN, H, np.linspace(3000, 25000, 800), 2)
    assert lobes.depth.min() >= least.depth * (1 - 1e-9)
    assert lobes.depth.min() < 1.001 * least.depth
    assert set(lobes.mode) <= {0, 1, 2, 3}


def test_turning_limit_equals_the_closed_form() -> None:
    """One direction, constant H: b = −1 / (2 K Re G), at least 2 k ζ (1 + ζ) / K."""
    k, zeta, K = 5e6, 0.03, 2e9
    modes = one_mode(2 * np.pi * 100, zeta, k, (1.0, 0, 0))
    # the chip thickness increases with the displacement, and the force opposes it
    H = np.array([[-K, 0], [0, 0], [0, 0]])
    least = find_lobe_minimum(modes, H)
    assert least.depth == pytest.approx(2 * k * zeta * (1 + zeta) / K, rel=1e-6)
    for rpm in (2500.0, 4000.0, 7000.0):
        limit = compute_stability_lobes(modes, H, np.array([rpm]), 1)
        w = limit.omega[0]
        G = 1 / (k * (1 - (w / modes.omega[0, 0]) ** 2 + 2j * zeta * w / modes.omega[0, 0]))
        assert limit.depth[0] == pytest.approx(-1 / (2 * K * G.real), rel=1e-6)
        assert abs(1 + limit.depth[0] * K * (1 - np.exp(-1j * w * 60 / rpm)) * G) < 1e-6


def test_hayes_stability_border_of_the_collocation() -> None:
    """The stability limit of ẋ = a x + b x(t − 1) is at a + b = 0 and at (ω / tan ω, −ω / sin ω)."""

    def radius(a: float, b: float, nodes: int = 20) -> float:
        from delay_reference import chebyshev

        D = chebyshev(nodes)[1]
        system = 2 * D[1:, 1:] - a * np.eye(nodes)
        right = np.hstack([-2 * D[1:, :1], b * np.eye(nodes)])  # x(0) and the history at the nodes
        found = np.linalg.solve(system, right)
        return float(np.abs(np.linalg.eigvals(np.vstack([found[-1:], found]))).max())

    assert radius(-0.5, 0.5) == pytest.approx(1, abs=1e-8)
    for w in (0.5, 1.5, 2.5):
        assert radius(w / math.tan(w), -w / math.sin(w)) == pytest.approx(1, abs=1e-8)


# --- modes


def test_modes_of_an_arm_solve_the_eigenvalue_problem() -> None:
    rng = np.random.default_rng(1)
    B = rng.normal(size=(5, 6, 6))
    M = B @ np.swapaxes(B, 1, 2) + 6 * np.eye(6)
    C = 1 / rng.uniform(1e5, 1e6, 6)
    J = rng.normal(size=(5, 3, 6))
    modes = compute_arm_modes(M, C, J, 0.03)
    assert (np.diff(modes.omega, axis=1) >= 0).all()
    force = rng.normal(size=3)
    for p, w in itertools.product(range(5), (3.0, 150.0)):
        G = J[p] @ np.linalg.inv(np.diag(1 / C) - w**2 * M[p]) @ J[p].T
        u = modes.shape[p]
        np.testing.assert_allclose(G @ force, (u.T / (modes.omega[p] ** 2 - w**2)) @ (u @ force), rtol=1e-8)
    full = compute_arm_modes(M, np.broadcast_to(np.diag(C), (5, 6, 6)), J, 0.03)
    np.testing.assert_allclose(full.omega, modes.omega, rtol=1e-9)
    static = np.sum(modes.shape[0, :, 0] ** 2 / modes.omega[0] ** 2)
    assert static == pytest.approx((J[0] @ np.diag(C) @ J[0].T)[0, 0])


def test_damping_outside_the_list_makes_the_limit_unknown() -> None:
    M, J = np.eye(3)[None] * [[[4.0]]], np.eye(3)[None]
    C = np.array([1e-6, 2e-6, 3e-6])
    modes = compute_arm_modes(M, C, J, (0.03, 0.02))
    np.testing.assert_array_equal(np.isnan(modes.zeta), [[False, False, True]])
    H = directional((767e6, 168.8e6, 222e6), TWO, "down", 0.005)
    limit = compute_depth_limit(modes, H, 0.002)
    assert np.isnan(limit.depth[0])
    assert limit.mode[0] == -1
    known = StructuralModes(modes.omega[:, :2].copy(), modes.zeta[:, :2].copy(), modes.shape[:, :2].copy())
    assert not np.isnan(compute_depth_limit(known, H, 0.002).depth[0])


def test_merged_modes_are_in_ascending_order() -> None:
    arm = build_tool_modes([8.0, 30.0], [0.02, 0.03], [1e6, 2e6], np.eye(3)[:2], 2)
    tool = build_tool_modes([20.0], [0.01], [1e7], np.array([[0, 1.0, 0]]), 2)
    both = merge_modes(arm, tool)
    np.testing.assert_allclose(both.frequency, [[8, 20, 30]] * 2)
    np.testing.assert_allclose(both.stiffness, [[1e6, 1e7, 2e6]] * 2)
    np.testing.assert_allclose(both.zeta[0], [0.02, 0.01, 0.03])


def test_impossible_modes_and_speeds_are_refused() -> None:
    M, J = np.eye(2)[None], np.zeros((1, 3, 2))
    for mass, compliance, damping, key in (
        (-M, np.ones(2), 0.03, "modes"),
        (M, np.array([1.0, 0.0]), 0.03, "stiffness"),
        (M, -M, 0.03, "stiffness"),
        (M, np.ones(2), 0.0, "damping_percent"),
        (M, np.ones(2), (0.03, 1.2), "damping_percent"),
    ):
        with pytest.raises(CuttingInputError) as raised:
            compute_arm_modes(mass, compliance, J, damping)
        assert raised.value.key == key
    for f, k, direction in ((0.0, 1e6, (1, 0, 0)), (10.0, 0.0, (1, 0, 0)), (10.0, 1e6, (0, 0, 0))):
        with pytest.raises(CuttingInputError):
            build_tool_modes([f], [0.02], [k], np.array([direction]))
    with pytest.raises(CuttingInputError, match="spindle speed"):
        compute_tooth_period(0.0, 2)
    with pytest.raises(CuttingInputError, match="teeth"):
        compute_tooth_period(1000.0, 0)
    modes = one_mode(100.0, 0.02, 1e6, (1, 0, 0))
    with pytest.raises(CuttingInputError, match="tooth period"):
        compute_depth_limit(modes, np.zeros((3, 2)), 0.0)
    with pytest.raises(CuttingInputError, match="largest depth"):
        compute_depth_limit(modes, np.zeros((3, 2)), 0.1, largest=math.inf)


def test_zero_force_feedback_has_no_limit() -> None:
    modes = one_mode(100.0, 0.02, 1e6, (0, 0, 1))  # an axial displacement does not change the chip thickness
    limit = compute_depth_limit(modes, directional((767e6, 168.8e6, 222e6), TWO, "down", 0.005), 0.01)
    assert limit.depth[0] == math.inf
    assert np.isnan(limit.omega[0])


def test_excitation_frequency_near_a_mode_is_found() -> None:
    """Published case: 500 rpm with two teeth, 8.3 and 16.7 Hz, near modes at 8.7, 11.4 and 14.2 Hz."""
    modes = build_tool_modes([8.7, 11.4, 14.2, 60.0], [0.02, 0.02, 0.02, 0.02], [1e6] * 4, np.eye(3)[[0, 1, 2, 0]])
    found = find_resonances(modes, 500.0, 2)
    assert [(m.excitation, m.mode) for m in found] == [("spindle", 0)]
    assert found[0].amplification == pytest.approx(1 / math.hypot(1 - (500 / 60 / 8.7) ** 2, 0.04 * 500 / 60 / 8.7))
    assert find_resonances(modes, 12000.0, 2) == []
    after = build_tool_modes([9.4, 12.2, 16.5], [0.02] * 3, [1e6] * 3, np.eye(3))
    assert [(m.excitation, m.mode) for m in find_resonances(after, 500.0, 2)] == [("spindle", 0), ("tooth", 2)]
    damped = build_tool_modes([8.4], [0.25], [1e6], np.array([[1.0, 0, 0]]))
    assert find_resonances(damped, 500.0, 2) == []  # high damping: no resonance warning
    unknown = build_tool_modes([8.4], [math.nan], [1e6], np.array([[1.0, 0, 0]]))
    assert len(find_resonances(unknown, 500.0, 2)) == 1

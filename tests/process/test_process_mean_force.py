"""Mean milling forces: published means, closed forms, quadrature of the instantaneous force, derivatives, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import CuttingInputError
from machopt.process.milling.engagement_angles import ContactArc, compute_chip_thickness, compute_contact_arc
from machopt.process.milling.mean_force import compute_mean_load, compute_mean_load_of_arc
from machopt.process.milling.milling_cut import (
    MillingCut,
    MillingCutter,
    check_milling_coefficients,
    compute_feed_per_tooth,
)

HELICAL = MillingCoefficients(
    Ktc_Pa=447.88e6,
    Krc_Pa=374.21e6,
    Kac_Pa=97e6,
    Kte_N_m=70298.0,
    Kre_N_m=12603.0,
    Kae_N_m=0.0,
    h_range_m=(0.0, 1e-3),
    sigma_log=0.0,
    source="Altıntaş' helical example",
)
EDGES = replace(HELICAL, Kae_N_m=3000.0)
FOUR = MillingCutter(diameter=0.0181, teeth=4, helix=math.radians(30), length=0.05)
BULL = replace(FOUR, corner_radius=0.004)
BALL = replace(FOUR, corner_radius=0.00905)
FZ, AP = 5e-5, 5.08e-3


@pytest.mark.parametrize(
    ("side", "share", "travel", "normal", "tangential"),
    [
        ("up", 0.5, -351.840, 213.213, 429.5),
        ("down", 0.5, 175.3, 355.2, 429.5),
        ("slot", 1.0, -176.6, 568.5, 859.1),
        ("up", 0.1, -162.5, 16.0, 160.8),
        ("down", 0.1, 136.3, 86.7, 160.8),
    ],
)
def test_published_means_of_the_helical_example(
    side: str, share: float, travel: float, normal: float, tangential: float
) -> None:
    load = compute_mean_load(HELICAL, FOUR, MillingCut(side), share * FOUR.diameter, AP).compute_load(FZ)[0]
    assert load[0] == pytest.approx(travel, rel=1e-3, abs=0.05)
    assert load[1] == pytest.approx(normal, rel=1e-3, abs=0.05)
    assert load[3] / FOUR.radius == pytest.approx(tangential, rel=1e-3)
    if share == 0.5:
        assert load[2] == pytest.approx(-15.685, abs=5e-4)  # right-hand helix, M3: pulls the tool towards the workpiece


def test_slot_equals_the_closed_form() -> None:
    load = compute_mean_load(EDGES, FOUR, MillingCut("slot"), FOUR.diameter, AP).compute_load(FZ)[0]
    n = FOUR.teeth * AP
    x = -n / 4 * EDGES.Krc_Pa * FZ - n / np.pi * EDGES.Kre_N_m
    y = n / 4 * EDGES.Ktc_Pa * FZ + n / np.pi * EDGES.Kte_N_m
    z = -(n / np.pi * EDGES.Kac_Pa * FZ + n / 2 * EDGES.Kae_N_m)
    np.testing.assert_allclose(load[:3], [x, y, z], rtol=1e-12)


def test_mirrored_spindle_direction_and_helix_hand_mirror_the_forces() -> None:
    """M4 with a left-hand helix is the mirror image of M3 with a right-hand one."""
    left = replace(FOUR, helix=-FOUR.helix)
    ae = 0.3 * FOUR.diameter
    m3 = compute_mean_load(EDGES, FOUR, MillingCut("up", "cw"), ae, AP).compute_load(FZ)[0]
    m4 = compute_mean_load(EDGES, left, MillingCut("up", "ccw"), ae, AP).compute_load(FZ)[0]
    np.testing.assert_allclose(m4, m3 * [1, -1, 1, -1], rtol=1e-12)
    push = compute_mean_load(EDGES, left, MillingCut("up", "cw"), ae, AP).compute_load(FZ)[0]
    np.testing.assert_allclose(push, m3 * [1, 1, -1, 1], rtol=1e-12)


@pytest.mark.parametrize("cutter", [FOUR, BULL, BALL])
@pytest.mark.parametrize("side", ["up", "down"])
@pytest.mark.parametrize("boundary", ["previous_pass", "plane"])
def test_means_equal_the_sum_of_thin_slices(cutter: MillingCutter, side: str, boundary: str) -> None:
    """Reference: numerical sum over slices in z and rotation angles of the force of each element."""
    cut, ae, ap = MillingCut(side, "cw", boundary), 0.006, 0.0075
    load = compute_mean_load(EDGES, cutter, cut, ae, ap).compute_load(FZ)[0]
    total, rc = np.zeros(4), cutter.corner_radius
    u = (np.arange(1500) + 0.5) / 1500
    z = ap * u**3  # a finer grid near the tip of a ball cutter, where the edge is long
    dz = 3 * ap * u**2 / 1500
    phi = (np.arange(720) + 0.5) * np.pi / 720
    kappa = np.where(z < rc, np.arccos(np.clip(1 - z / max(rc, 1e-9), -1, 1)), np.pi / 2)
    radius = cutter.radius - rc * (1 - np.sin(kappa))
    wall = (radius if boundary == "previous_pass" else np.full_like(radius, cutter.radius)) - ae
    away = np.outer(radius, np.cos(phi)) * (1 if side == "up" else -1)
    inside = away >= wall[:, None]
    sin, cos = np.sin(phi), np.cos(phi)
    h, db = FZ * np.outer(np.sin(kappa), sin), (dz / np.sin(kappa))[:, None]
    ft = (EDGES.Ktc_Pa * h + EDGES.Kte_N_m) * db * inside
    fr = (EDGES.Krc_Pa * h + EDGES.Kre_N_m) * db * inside
    fa = (EDGES.Kac_Pa * h + EDGES.Kae_N_m) * db * inside
    flat = fr * np.sin(kappa)[:, None] + fa * np.cos(kappa)[:, None]
    total[0] = (-ft * cos - flat * sin).sum()
    total[1] = (ft * sin - flat * cos).sum()
    total[2] = (fr * np.cos(kappa)[:, None] - fa * np.sin(kappa)[:, None]).sum()
    total[3] = (ft * radius[:, None]).sum()
    total *= cutter.teeth / 720 / 2
    np.testing.assert_allclose(load, total, rtol=6e-3, atol=2e-3 * np.abs(total).max())


@pytest.mark.parametrize("cutter", [FOUR, BULL, BALL])
@pytest.mark.parametrize(
    "cut", [MillingCut(s, d, b) for s, d in (("up", "cw"), ("down", "ccw")) for b in ("previous_pass", "plane")]
)
def test_derivatives_agree_with_finite_differences(cutter: MillingCutter, cut: MillingCut) -> None:
    ae = np.array([0.0021, 0.0043, 0.0093, 0.0131])
    step = 2e-7
    mean = compute_mean_load(EDGES, cutter, cut, ae, 0.0075)
    up, down = (compute_mean_load(EDGES, cutter, cut, ae + d, 0.0075).compute_load(FZ) for d in (step, -step))
    numeric = (up - down) / (2 * step)
    analytic = mean.compute_load_by_ae(FZ)
    np.testing.assert_allclose(analytic, numeric, rtol=0, atol=1e-6 * np.abs(numeric).max())
    feed = (mean.compute_load(FZ * 1.01) - mean.compute_load(FZ * 0.99)) / (0.02 * FZ)
    np.testing.assert_allclose(mean.slope, feed, rtol=1e-6, atol=1e-6 * np.abs(feed).max())


def test_given_arc_and_equivalent_depth_give_equal_forces() -> None:
    cut, ae = MillingCut("down"), np.array([0.001, 0.008])
    arc = compute_contact_arc(FOUR, cut, ae, FOUR.radius)
    a = compute_mean_load(EDGES, FOUR, cut, ae, AP).compute_load(FZ)
    b = compute_mean_load_of_arc(EDGES, FOUR, cut, arc, AP).compute_load(FZ)
    np.testing.assert_allclose(a, b, rtol=1e-12)


def test_zero_depth_gives_zero_force() -> None:
    ae, ap = np.array([0.0, 0.002, 0.0]), np.array([0.001, 0.0, 0.0])
    for cutter in (FOUR, BALL):
        mean = compute_mean_load(EDGES, cutter, MillingCut("up"), ae, ap)
        assert not mean.compute_load(FZ).any()
        assert np.isfinite(mean.compute_load_by_ae(FZ)).all()


def test_chip_thickness_of_an_arc() -> None:
    arc = ContactArc(*(np.array(x) for x in ([0.0, 2.0, 1.0], [np.pi, np.pi, 1.0], [0.0] * 3, [0.0] * 3)))
    mean, peak = compute_chip_thickness(np.full(3, 1e-4), arc)
    np.testing.assert_allclose(mean, [2e-4 / np.pi, 1e-4 * (np.cos(2) + 1) / (np.pi - 2), 0])
    np.testing.assert_allclose(peak, [1e-4, 1e-4 * np.sin(2), 0])


def test_feed_per_tooth_requires_the_number_of_teeth() -> None:
    assert compute_feed_per_tooth(np.array([1.5 / 60]), 6000, 2)[0] == pytest.approx(0.125e-3)
    with pytest.raises(CuttingInputError, match="0 rpm"):
        compute_feed_per_tooth(np.array([0.1]), 0.0, 2)
    with pytest.raises(CuttingInputError, match="0 teeth"):
        compute_feed_per_tooth(np.array([0.1]), 100.0, 0)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"Krc_Pa": -205.8e6}, "Krc"),
        ({"Ktc_Pa": 1198e6, "Krc_Pa": 3857e6}, "Krc"),  # a public data set with both coefficients exchanged
        ({"Kac_Pa": -1.0}, "Kac"),
        ({"Kte_N_m": -1.0}, "Kte"),
    ],
)
def test_suspicious_coefficients_are_refused_unless_accepted(change: dict[str, float], key: str) -> None:
    with pytest.raises(CuttingInputError, match=r"accept: true") as raised:
        check_milling_coefficients(replace(EDGES, **change))
    assert raised.value.key == key
    check_milling_coefficients(replace(EDGES, **change), accept_unusual=True)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"Ktc_Pa": 0.0}, "Ktc"),
        ({"Kre_N_m": math.nan}, "Kre"),
        ({"h_range_m": (1e-4, 1e-5)}, "h_mm"),
        ({"sigma_log": -0.1}, "spread_percent"),
    ],
)
def test_impossible_coefficients_are_refused(change: dict[str, object], key: str) -> None:
    with pytest.raises(CuttingInputError) as raised:
        check_milling_coefficients(replace(EDGES, **change), accept_unusual=True)
    assert raised.value.key == key


@pytest.mark.parametrize(
    ("cutter", "side", "ae", "ap", "key", "words"),
    [
        (FOUR, "up", 0.019, 0.001, "ae_mm", "ae is 19 mm; at most the diameter 18.1 mm"),
        (FOUR, "up", 0.001, 0.051, "ap_mm", "ap is 51 mm; at most the length of the cutting edges 50 mm"),
        (FOUR, "slot", 0.01, 0.001, "ae_mm", "a slot has the full diameter"),
        (FOUR, "up", -0.001, 0.001, "ae_mm", "0 or more"),
        (FOUR, "up", math.nan, 0.001, "ae_mm", "0 or more"),
        (replace(FOUR, helix=0.0), "up", 0.001, 0.001, "helix_deg", "hand of the helix"),
        (replace(FOUR, corner_radius=0.01), "up", 0.001, 0.001, "corner_radius_mm", "half the diameter"),
        (replace(FOUR, teeth=0), "up", 0.001, 0.001, "teeth", "1 or more"),
        (replace(FOUR, runout=-1e-6), "up", 0.001, 0.001, "runout_mm", "0 or more"),
        (replace(FOUR, diameter=0.0), "up", 0.001, 0.001, "diameter_mm", "larger than 0"),
        (replace(FOUR, helix=2.0), "up", 0.001, 0.001, "helix_deg", "between"),
    ],
)
def test_impossible_cuts_are_refused(
    cutter: MillingCutter, side: str, ae: float, ap: float, key: str, words: str
) -> None:
    with pytest.raises(CuttingInputError, match=words) as raised:
        compute_mean_load(EDGES, cutter, MillingCut(side), ae, ap)
    assert raised.value.key == key


def test_point_with_an_invalid_depth_is_named() -> None:
    with pytest.raises(CuttingInputError, match="at point 2;"):
        compute_mean_load(EDGES, FOUR, MillingCut("up"), np.array([0.001, 0.002, 0.02]), 0.001)


@pytest.mark.parametrize("fz", [0.0, -1e-5, math.nan, math.inf])
def test_nonpositive_feed_is_refused(fz: float) -> None:
    mean = compute_mean_load(EDGES, FOUR, MillingCut("up"), 0.001, 0.001)
    for compute in (mean.compute_load, mean.compute_load_by_ae):
        with pytest.raises(CuttingInputError, match="feed per tooth"):
            compute(fz)

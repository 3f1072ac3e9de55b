"""Force over the rotation angle: published peaks and harmonics, energy, run-out, surface; converted coefficients."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import CuttingInputError
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.instantaneous_force import (
    compute_surface_generation_load,
    compute_waveform,
    find_peak_force,
)
from machopt.process.milling.kienzle_conversion import linearize_kienzle
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import MillingCut, MillingCutter
from machopt.process.milling.orthogonal_to_oblique import TI6AL4V, compute_oblique_coefficients

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
FZ, AP = 5e-5, 5.08e-3


def mean_over_a_turn(K: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, ae: float) -> NDArray[np.float64]:
    """Integrate by Gauss quadrature between the angles at which a tooth enters or exits at the tip or at the top."""
    arc = compute_contact_arc(cutter, cut, np.array(ae), cutter.radius)
    lag = math.tan(cutter.helix) / cutter.radius * cut.mirror * AP
    at = [
        a + d + 2 * np.pi * j / cutter.teeth
        for a in (arc.start, arc.end)
        for d in (0, lag)
        for j in range(cutter.teeth)
    ]
    bounds = [0.0, *np.sort(np.array(at) % (2 * np.pi)), 2 * np.pi]
    x, w = np.polynomial.legendre.leggauss(12)
    total = np.zeros(4)
    for a, b in itertools.pairwise(bounds):
        load = compute_waveform(K, cutter, cut, (ae, AP), FZ, 0.5 * (a + b) + 0.5 * (b - a) * x).load
        total += 0.5 * (b - a) * w @ load
    return total / (2 * np.pi)


def test_published_peaks_and_harmonics_of_the_helical_example() -> None:
    wave = compute_waveform(HELICAL, FOUR, MillingCut("up"), (FOUR.radius, AP), FZ)
    assert np.abs(wave.load[:, 0]).max() == pytest.approx(412.6, abs=0.05)
    assert np.abs(wave.load[:, 1]).max() == pytest.approx(435.6, abs=0.05)
    assert find_peak_force(wave) == pytest.approx(492.5, abs=0.05)
    many = np.arange(46080) * (2 * np.pi / 46080)
    dense = compute_waveform(HELICAL, FOUR, MillingCut("up"), (FOUR.radius, AP), FZ, many)
    c = np.abs(np.fft.rfft(dense.load[:, 1])) / len(many)
    np.testing.assert_allclose(c[[4, 8, 12]], [89.105, 32.458, 13.746], atol=6e-4)
    assert np.delete(c[:20], [0, 4, 8, 12, 16]).max() < 1e-9  # without run-out: multiples of the tooth frequency only
    shifted = replace(FOUR, runout=1e-5, runout_angle=0.3)
    wave = compute_waveform(HELICAL, shifted, MillingCut("up"), (FOUR.radius, AP), FZ)
    # with run-out: also multiples of the spindle frequency
    assert np.abs(np.fft.rfft(wave.load[:, 1]))[1:4].min() > 1.0


@pytest.mark.parametrize("helix", [30.0, -30.0, 55.0, 1e-3])
@pytest.mark.parametrize(("side", "share"), [("up", 0.4), ("down", 0.07), ("slot", 1.0), ("down", 0.8)])
@pytest.mark.parametrize("spindle", ["cw", "ccw"])
def test_mean_over_one_turn_equals_the_closed_form_and_energy_is_conserved(
    helix: float, side: str, share: float, spindle: str
) -> None:
    cutter, cut = replace(FOUR, helix=math.radians(helix)), MillingCut(side, spindle)
    ae = share * cutter.diameter
    mean = mean_over_a_turn(EDGES, cutter, cut, ae)
    closed = compute_mean_load(EDGES, cutter, cut, ae, AP).compute_load(FZ)[0]
    np.testing.assert_allclose(mean, closed, rtol=1e-9, atol=1e-9 * np.abs(closed).max())
    arc = compute_contact_arc(cutter, cut, np.array(ae), cutter.radius)
    work = abs(mean[3]) * 2 * np.pi  # J per revolution
    volume = cutter.teeth * FZ * ae * AP
    edge = EDGES.Kte_N_m * cutter.teeth * AP * float(arc.end - arc.start) * cutter.radius
    assert work == pytest.approx(EDGES.Ktc_Pa * volume + edge, rel=1e-9)


def test_waveform_equals_the_sum_of_its_elements() -> None:
    """Reference: numerical sum over the axial elements, with run-out and helix."""
    cutter = replace(FOUR, teeth=3, runout=4e-5, runout_angle=0.8)
    cut, ae = MillingCut("up"), 0.5 * FOUR.diameter
    z = (np.arange(20000) + 0.5) / 20000 * AP
    lag, N = math.tan(cutter.helix) / cutter.radius * z, cutter.teeth
    end = math.acos(1 - 2 * ae / cutter.diameter)
    angles = np.array([0.2, 1.1, 2.5, 5.9])
    for phi, load in zip(angles, compute_waveform(EDGES, cutter, cut, (ae, AP), FZ, angles).load, strict=True):
        radius = [cutter.runout * np.cos(0.8 - 2 * np.pi * j / N + lag) for j in range(N)]
        total = np.zeros(4)
        for j in range(N):
            psi = (phi + 2 * np.pi * j / N - lag) % (2 * np.pi)
            h = np.min([m * FZ * np.sin(psi) + radius[j] - radius[(j + m) % N] for m in range(1, N + 1)], axis=0)
            on = (psi <= end) & (h > 0)
            ft, fr, fa = (
                np.where(on, Kc * h + Ke, 0.0)
                for Kc, Ke in (
                    (EDGES.Ktc_Pa, EDGES.Kte_N_m),
                    (EDGES.Krc_Pa, EDGES.Kre_N_m),
                    (EDGES.Kac_Pa, EDGES.Kae_N_m),
                )
            )
            total += [
                (-ft * np.cos(psi) - fr * np.sin(psi)).mean() * AP,
                (ft * np.sin(psi) - fr * np.cos(psi)).mean() * AP,
                -fa.mean() * AP,
                ft.mean() * AP * cutter.radius,
            ]
        np.testing.assert_allclose(load, total, rtol=1e-3, atol=1e-3 * np.abs(total).max())


@pytest.mark.parametrize("runout", [5e-6, 2e-5, 1e-4])
def test_runout_keeps_the_volume_and_lifts_teeth_out_of_the_cut(runout: float) -> None:
    cutter, cut, ae = replace(FOUR, runout=runout, runout_angle=0.7), MillingCut("down"), 0.4 * FOUR.diameter
    free = replace(EDGES, Kte_N_m=0.0, Kre_N_m=0.0, Kae_N_m=0.0)
    angles = np.arange(7200) * (2 * np.pi / 7200)
    wave = compute_waveform(free, cutter, cut, (ae, AP), FZ, angles)
    work = wave.load[:, 3].mean() * 2 * np.pi
    assert work == pytest.approx(free.Ktc_Pa * cutter.teeth * FZ * ae * AP, rel=1e-6)
    still = compute_waveform(free, replace(cutter, runout=0.0), cut, (ae, AP), FZ, angles)
    assert find_peak_force(wave) > find_peak_force(still)
    if runout == 1e-4:  # run-out of twice the feed per tooth: teeth out of contact have no edge force
        edge = replace(EDGES, Ktc_Pa=1.0)
        with_all = compute_waveform(edge, replace(cutter, runout=0.0), cut, (ae, AP), FZ).load[:, 3].mean()
        assert compute_waveform(edge, cutter, cut, (ae, AP), FZ).load[:, 3].mean() < 0.8 * with_all


@pytest.mark.parametrize("corner", [0.003, 0.00905])
def test_corner_slices_have_the_mean_of_the_closed_form(corner: float) -> None:
    cutter, ae, ap = replace(FOUR, corner_radius=corner), 0.4 * FOUR.diameter, 0.006
    for side in ("up", "down"):
        mean = compute_waveform(EDGES, cutter, MillingCut(side), (ae, ap), FZ).load.mean(axis=0)
        closed = compute_mean_load(EDGES, cutter, MillingCut(side), ae, ap).compute_load(FZ)[0]
        np.testing.assert_allclose(mean, closed, rtol=2e-3, atol=2e-3 * np.abs(closed).max())


def test_straight_teeth_enter_over_the_whole_depth_at_once() -> None:
    cutter = replace(FOUR, helix=0.0)
    free = replace(EDGES, Kac_Pa=0.0, Kae_N_m=0.0)
    load = compute_waveform(free, cutter, MillingCut("up"), (FOUR.radius, AP), FZ, np.array([0.4])).load[0]
    ft, fr = ((Kc * FZ * math.sin(0.4) + Ke) * AP for Kc, Ke in ((447.88e6, 70298.0), (374.21e6, 12603.0)))
    expected = [-ft * math.cos(0.4) - fr * math.sin(0.4), ft * math.sin(0.4) - fr * math.cos(0.4), 0, ft * FOUR.radius]
    np.testing.assert_allclose(load, expected, rtol=1e-12, atol=1e-12)


def test_zero_depth_gives_zero_force() -> None:
    assert not compute_waveform(EDGES, FOUR, MillingCut("up"), (0.0, AP), FZ).load.any()
    assert not compute_waveform(EDGES, FOUR, MillingCut("up"), (0.001, 0.0), FZ).load.any()


@pytest.mark.parametrize(("side", "wall"), [("up", 0.0), ("down", math.pi)])
def test_helix_lag_delays_the_generated_surface(side: str, wall: float) -> None:
    heights, cut, ae = np.array([0.0, 0.002, 0.005]), MillingCut(side), 0.002
    k = math.tan(FOUR.helix) / FOUR.radius
    found = compute_surface_generation_load(EDGES, FOUR, cut, (ae, AP), FZ, heights)
    there = compute_waveform(EDGES, FOUR, cut, (ae, AP), FZ, wall + k * heights).load
    np.testing.assert_allclose(found, there, atol=1e-9)
    shifted = replace(FOUR, runout=3e-5, runout_angle=2.0)
    found = compute_surface_generation_load(EDGES, shifted, cut, (ae, AP), FZ, heights)
    for z, load in zip(heights, found, strict=True):  # the longest tooth at that height generates the surface
        tooth = max(range(4), key=lambda j: math.cos(2.0 - j * math.pi / 2 + k * z))
        at = np.array([wall - tooth * math.pi / 2 + k * z])
        np.testing.assert_allclose(load, compute_waveform(EDGES, shifted, cut, (ae, AP), FZ, at).load[0], atol=1e-9)


def test_invalid_cut_is_refused() -> None:
    for ae, ap, fz, key in ((0.02, AP, FZ, "ae_mm"), (0.002, 0.06, FZ, "ap_mm"), (0.002, AP, 0.0, "feed per tooth")):
        with pytest.raises(CuttingInputError) as raised:
            compute_waveform(EDGES, FOUR, MillingCut("up"), (ae, ap), fz)
        assert raised.value.key == key


@pytest.mark.parametrize(
    ("span", "cutting", "edge", "worst"), [((0.02, 0.10), 1232, 21.5, 0.085), ((0.005, 0.05), 1514, 11.1, 0.24)]
)
def test_published_linear_form_of_kienzle(span: tuple[float, float], cutting: float, edge: float, worst: float) -> None:
    """The published line was fitted to samples of the range, ours to the whole range."""
    low, high = (1e-3 * h for h in span)
    line = linearize_kienzle(800e6, 0.25, (low, high))
    assert line.cutting_Pa * 1e-6 == pytest.approx(cutting, rel=2e-3)
    assert line.edge_N_m * 1e-3 == pytest.approx(edge, rel=8e-3)
    assert line.worst_deviation == pytest.approx(worst, abs=6e-3)
    h = np.linspace(low, high, 100001)
    force = 800e6 * (h / 1e-3) ** -0.25 * h
    np.testing.assert_allclose(np.polyfit(h, force, 1), [line.cutting_Pa, line.edge_N_m], rtol=1e-4)
    assert np.abs((line.cutting_Pa * h + line.edge_N_m) / force - 1).max() == pytest.approx(
        line.worst_deviation, rel=1e-6
    )


def test_kienzle_with_exponent_zero_is_linear() -> None:
    line = linearize_kienzle(800e6, 0.0, (1e-5, 1e-4))
    assert line.cutting_Pa == pytest.approx(800e6)
    assert line.worst_deviation < 1e-9
    for kc1, mc, span in ((0.0, 0.2, (1e-5, 1e-4)), (1e9, 1.0, (1e-5, 1e-4)), (1e9, 0.2, (1e-4, 1e-5))):
        with pytest.raises(CuttingInputError):
            linearize_kienzle(kc1, mc, span)


@pytest.mark.parametrize(("rake", "expected"), [(12, (1510, 215, 515)), (0, (1775, 559, 652))])
def test_published_oblique_coefficients_of_titanium(rake: float, expected: tuple[float, float, float]) -> None:
    """A public program uses the rake in radians in the fitted laws and gives 1799, 284, 574 for 12°."""
    found = compute_oblique_coefficients(TI6AL4V, math.radians(rake), math.radians(30), 5e-5, 0.1)
    np.testing.assert_allclose(np.array([found.Ktc_Pa, found.Krc_Pa, found.Kac_Pa]) * 1e-6, expected, atol=0.6)
    assert (found.Kte_N_m, found.Kre_N_m) == (24e3, 43e3)
    left = compute_oblique_coefficients(TI6AL4V, math.radians(rake), math.radians(-30), 5e-5, 0.1)
    assert left.Kac_Pa == found.Kac_Pa  # the sign of the helix hand is applied by the cutter


def test_angles_outside_the_data_are_refused() -> None:
    for rake, helix, h in ((70.0, 30.0, 5e-5), (12.0, 95.0, 5e-5), (12.0, 30.0, 0.0)):
        with pytest.raises(CuttingInputError):
            compute_oblique_coefficients(TI6AL4V, math.radians(rake), math.radians(helix), h, 0.1)

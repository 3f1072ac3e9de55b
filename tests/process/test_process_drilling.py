"""Drilling: published numbers, phases of a stroke against numerical summation, inversion, pressure foot,
breakthrough, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from machopt.data_types.cutting_coefficients import DrillingCoefficients, convert_spread_to_sigma
from machopt.errors import CuttingInputError
from machopt.process.drilling.breakthrough_velocity import (
    compute_axial_compliance,
    compute_axial_mass,
    compute_breakthrough_velocity,
)
from machopt.process.drilling.drilling_tools import DrillingTool, MaterialLayer, build_countersink, build_reamer
from machopt.process.drilling.feed_inversion import find_largest_feed
from machopt.process.drilling.pressure_foot import compute_foot_load, compute_skid_margin
from machopt.process.drilling.stroke_phases import (
    build_drilling_stroke,
    compute_load_at_depth,
    compute_stroke_maximum,
    get_stroke_phase,
)
from machopt.process.drilling.thrust_and_torque import (
    build_feed_power_law,
    compute_feed_per_revolution,
    compute_full_load,
    compute_vendor_load,
)


def coefficients(kc1: float, mc: float, chisel: float | None = None) -> DrillingCoefficients:
    return DrillingCoefficients(
        kc1_Pa=kc1 * 1e6,
        mc=mc,
        chisel_Pa=None if chisel is None else chisel * 1e6,
        thrust_sigma_log=convert_spread_to_sigma(60),
        torque_sigma_log=convert_spread_to_sigma(25),
        source="VDI 3323",
    )


TEN = DrillingTool(diameter=0.01, half_point_angle=math.radians(70))
WEB = replace(TEN, web=0.0012)
SOFT, HARD = coefficients(800, 0.25, 100), coefficients(2110, 0.22, 300)


@pytest.mark.parametrize(
    ("kc1", "mc", "torque", "thrust"), [(1775, 0.24, 10.65, 2002), (1350, 0.21, 7.64, 1436), (800, 0.25, 4.90, 920)]
)
def test_published_numbers_of_kienzle(kc1: float, mc: float, torque: float, thrust: float) -> None:
    load = compute_full_load(coefficients(kc1, mc), TEN, 0.3e-3)
    assert load.torque[0] == pytest.approx(torque, rel=1e-3)
    assert load.thrust[0] == pytest.approx(thrust, rel=1e-3)


@pytest.mark.parametrize(("factor", "torque", "thrust"), [(2.22, 12.61, 4548), (1.01, 5.74, 2069)])
def test_published_numbers_of_the_vendor(factor: float, torque: float, thrust: float) -> None:
    load = compute_vendor_load(factor, 0.01, 0.3e-3)
    assert load.torque[0] == pytest.approx(torque, rel=1e-3)
    assert load.thrust[0] == pytest.approx(thrust, rel=1e-3)


def test_pilot_hole_chisel_edge_and_rake_angle() -> None:
    full, feed = compute_full_load(SOFT, WEB, 2e-4), 2e-4
    lips = compute_full_load(coefficients(800, 0.25), TEN, 2e-4)
    assert full.thrust[0] - lips.thrust[0] == pytest.approx(100e6 * 0.0012 * feed)
    assert full.torque[0] == lips.torque[0]
    pilot = compute_full_load(SOFT, replace(WEB, inner_diameter=0.004), feed)
    assert pilot.thrust[0] == pytest.approx(lips.thrust[0] * 0.6)  # with a pilot hole the chisel edge does not cut
    assert pilot.torque[0] == pytest.approx(lips.torque[0] * (1 - 0.16))
    raked = compute_full_load(coefficients(800, 0.25), replace(TEN, rake=math.radians(10)), feed)
    assert raked.thrust[0] == pytest.approx(0.9 * lips.thrust[0])


def test_countersink_and_reamer_are_rings() -> None:
    sink = build_countersink(0.012, 0.006, math.radians(100), 3)
    kc = 800e6 * (0.1 / 3 * math.sin(math.radians(50))) ** -0.25
    load = compute_full_load(SOFT, sink, 1e-4)
    assert load.thrust[0] == pytest.approx(0.5 * kc * 0.003 * 1e-4 * math.sin(math.radians(50)))
    assert sink.point_length == pytest.approx(0.003 / math.tan(math.radians(50)))
    reamer = build_reamer(0.01, 0.0002, math.radians(45), 6)
    load = compute_full_load(SOFT, reamer, 6e-4)
    kc = 800e6 * (0.1 * math.sin(math.radians(45))) ** -0.25
    assert load.torque[0] == pytest.approx(kc * 6e-4 * (0.01**2 - 0.0098**2) / 8)


@pytest.mark.parametrize("tool", [WEB, replace(WEB, inner_diameter=0.004)])
def test_thrust_along_the_depth_equals_the_sum_over_the_lips(tool: DrillingTool) -> None:
    """Reference: numerical sum over rings of the lips, each in the layer at its depth."""
    layers = (MaterialLayer(SOFT, 0.0012), MaterialLayer(HARD, 0.003), MaterialLayer(SOFT, 0.002))
    stroke, feed = build_drilling_stroke(tool, layers), 3e-4
    rho = np.linspace(tool.inner_diameter / 2, tool.diameter / 2, 20001)
    rho = 0.5 * (rho[1:] + rho[:-1])
    bounds = np.array([0, 0.0012, 0.0042, 0.0062])
    full = [compute_full_load(c, replace(tool, web=1e-9), feed) for c in (SOFT, HARD, SOFT)]
    for z in np.linspace(-0.0003, 0.0085, 23):
        at = np.searchsorted(bounds, z - (rho - tool.inner_diameter / 2) / math.tan(tool.half_point_angle)) - 1
        thrust = sum(full[n].thrust[0] * np.mean(at == n) for n in range(3))
        torque = sum(full[n].torque[0] * (rho * (at == n)).sum() / rho.sum() for n in range(3))
        if tool.inner_diameter == 0:
            tip = int(np.searchsorted(bounds, z)) - 1
            thrust += (0, 100e6, 300e6, 100e6, 0)[tip + 1] * 0.0012 * feed
        load = compute_load_at_depth(stroke, z, feed)
        assert load.thrust[0] == pytest.approx(thrust, rel=2e-3, abs=0.5)
        assert load.torque[0] == pytest.approx(torque, rel=2e-3, abs=2e-3)


def test_drilling_phases_of_a_material_stack() -> None:
    stroke = build_drilling_stroke(WEB, (MaterialLayer(SOFT, 0.004), MaterialLayer(HARD, 0.003)))
    depths = (-0.001, 0.001, 0.003, 0.0045, 0.0065, 0.008, 0.02)
    phases = ["outside", "entry", "full", "layer change", "full", "exit", "outside"]
    assert [get_stroke_phase(stroke, z) for z in depths] == phases


@pytest.mark.parametrize("thick", [0.0005, 0.003])
def test_largest_thrust_of_a_stroke_is_found(thick: float) -> None:
    layers = (MaterialLayer(SOFT, 0.002), MaterialLayer(HARD, thick), MaterialLayer(SOFT, 0.002))
    stroke = build_drilling_stroke(replace(WEB, half_point_angle=math.radians(59)), layers)
    found = compute_stroke_maximum(stroke, [1e-4, 3e-4])
    dense = [compute_load_at_depth(stroke, np.linspace(0, 0.012, 40001), f) for f in (1e-4, 3e-4)]
    np.testing.assert_allclose(found.thrust, [d.thrust.max() for d in dense], rtol=1e-4)
    np.testing.assert_allclose(found.torque, [d.torque.max() for d in dense], rtol=1e-4)
    short = compute_stroke_maximum(stroke, 3e-4, last_depth=0.001)
    assert short.thrust[0] == pytest.approx(compute_load_at_depth(stroke, 0.001, 3e-4).thrust[0])


def test_blind_hole_in_a_thick_layer() -> None:
    stroke = build_drilling_stroke(WEB, (MaterialLayer(HARD, math.inf),))
    np.testing.assert_allclose(compute_stroke_maximum(stroke, 2e-4).thrust, compute_full_load(HARD, WEB, 2e-4).thrust)


def test_largest_feed_inverts_the_thrust_equation() -> None:
    stroke = build_drilling_stroke(WEB, (MaterialLayer(SOFT, 0.004), MaterialLayer(HARD, 0.003)))
    limit = np.array([-1.0, 0.0, 50.0, 700.0, 3000.0, 1e12])
    feed = find_largest_feed(stroke, limit, factor=1.25)
    assert feed[0] == feed[1] == 0
    assert feed[-1] == math.inf
    np.testing.assert_allclose(1.25 * compute_stroke_maximum(stroke, feed[2:-1]).thrust, limit[2:-1], rtol=1e-9)
    law = build_feed_power_law(coefficients(2110, 0.22), TEN)  # without a chisel edge the inverse has a closed form
    blind = build_drilling_stroke(TEN, (MaterialLayer(coefficients(2110, 0.22), math.inf),))
    closed = (700.0 / law.lips) ** (1 / law.exponent)
    np.testing.assert_allclose(find_largest_feed(blind, 700.0), closed, rtol=1e-9)


def test_clamping_force_has_two_regimes() -> None:
    foot = compute_foot_load(np.array([200.0, 900.0, 1200.0]), 900.0)
    np.testing.assert_array_equal(foot.arm, [900, 900, 1200])
    np.testing.assert_array_equal(foot.lifted, [False, False, True])
    free = compute_foot_load(300.0, 0.0)
    assert free.arm[0] == 300.0
    assert not free.lifted[0]  # no pressure foot
    margin = compute_skid_margin(np.array([100.0, -100.0, 100.0]), np.array([0.0, 600.0, 1000.0]), 900.0, 0.2)
    np.testing.assert_allclose(margin, [80, -40, -100])


def test_breakthrough_velocity_of_a_point_mass() -> None:
    axis, C = np.array([[0, 0, 1.0]]), np.diag([1e-6, 2e-6, 3e-6])[None]
    mass = compute_axial_mass(np.diag([10.0, 40.0])[None], np.array([[[1.0, 0], [0, 1], [0, 2]]]), axis)
    assert mass[0] == pytest.approx(10.0)  # 40 kg·m² with a factor of 2 m
    c = compute_axial_compliance(C, axis)
    v = compute_breakthrough_velocity(1000.0, c, mass, 0.01)
    assert v[0] == pytest.approx(0.3845 * math.sqrt(1e6 * 3e-6 / 10 + 1e-4))


def test_feed_per_revolution() -> None:
    assert compute_feed_per_revolution(np.array([0.6 / 60]), 3000)[0] == pytest.approx(0.2e-3)
    with pytest.raises(CuttingInputError, match="rpm"):
        compute_feed_per_revolution(np.array([0.1]), -1.0)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"diameter": 0.0}, "diameter_mm"),
        ({"inner_diameter": 0.01}, "pilot_mm"),
        ({"half_point_angle": 0.0}, "point_deg"),
        ({"lips": 0}, "teeth"),
        ({"rake": 2.0}, "rake_deg"),
        ({"web": 0.02}, "web_mm"),
        ({"web": None}, "web_mm"),  # required by the chisel edge coefficient
    ],
)
def test_impossible_tools_are_refused(change: dict[str, float | None], key: str) -> None:
    with pytest.raises(CuttingInputError) as raised:
        compute_full_load(SOFT, replace(WEB, **change), 1e-4)
    assert raised.value.key == key


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"kc1_Pa": 0.0}, "kc1"),
        ({"mc": 1.0}, "mc"),
        ({"chisel_Pa": -1.0}, "chisel_N_mm2"),
        ({"thrust_sigma_log": -0.1}, "thrust_spread_percent"),
        ({"torque_sigma_log": math.nan}, "torque_spread_percent"),
    ],
)
def test_impossible_coefficients_are_refused(change: dict[str, float], key: str) -> None:
    with pytest.raises(CuttingInputError) as raised:
        compute_full_load(replace(SOFT, **change), WEB, 1e-4)
    assert raised.value.key == key


def test_further_invalid_input_is_refused() -> None:
    with pytest.raises(CuttingInputError, match="feed"):
        compute_full_load(SOFT, WEB, [1e-4, 0.0])
    with pytest.raises(CuttingInputError, match="one layer"):
        build_drilling_stroke(WEB, ())
    for thickness in (0.0, math.nan):
        with pytest.raises(CuttingInputError, match="layer 1"):
            build_drilling_stroke(WEB, (MaterialLayer(SOFT, thickness),))
    with pytest.raises(CuttingInputError, match="layer 1"):  # no layer can follow an infinite one
        build_drilling_stroke(WEB, (MaterialLayer(SOFT, math.inf), MaterialLayer(HARD, 0.001)))
    stroke = build_drilling_stroke(WEB, (MaterialLayer(SOFT, 0.004),))
    with pytest.raises(CuttingInputError, match="cuts nothing"):
        compute_stroke_maximum(stroke, 1e-4, last_depth=0.001, first_depth=0.002)
    with pytest.raises(CuttingInputError, match="factor"):
        find_largest_feed(stroke, 100.0, factor=0.0)
    for clamp, friction in ((-1.0, 0.2), (900.0, -0.1)):
        with pytest.raises(CuttingInputError):
            compute_skid_margin(10.0, 0.0, clamp, friction)
    with pytest.raises(CuttingInputError, match="clamp"):
        compute_foot_load(10.0, math.inf)
    with pytest.raises(CuttingInputError, match="factor"):
        compute_vendor_load(0.0, 0.01, 1e-4)
    with pytest.raises(CuttingInputError, match="diameter"):
        compute_vendor_load(1.0, 0.0, 1e-4)

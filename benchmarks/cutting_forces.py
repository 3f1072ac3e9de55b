"""Published cutting forces, coefficients and stability limits beside those of this package.

Run: ``python benchmarks/cutting_forces.py``. One line a number: source, published, ours, deviation. The inputs are
cited with each block. The stability limits are the closed solutions of the package; the tests hold them against full
solutions of the delay equations (tests/process).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.process.drilling import DrillingTool, compute_full_load, compute_vendor_load
from machopt.process.materials import find_drilling_coefficients
from machopt.process.milling import (
    TI6AL4V,
    MillingCut,
    MillingCutter,
    compute_mean_load,
    compute_oblique_coefficients,
    compute_waveform,
    find_peak_force,
    linearize_kienzle,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "process"))

HELICAL = MillingCoefficients(
    Ktc_Pa=447.88e6,
    Krc_Pa=374.21e6,
    Kac_Pa=97e6,
    Kte_N_m=70298.0,
    Kre_N_m=12603.0,
    Kae_N_m=0.0,
    h_range_m=(0.0, 1e-3),
    sigma_log=0.0,
    source="helical example after Altıntaş",
)
FOUR = MillingCutter(diameter=0.0181, teeth=4, helix=math.radians(30), length=0.05)
Row = tuple[str, float, float]


def list_milling_rows() -> Iterable[Row]:
    """Means of five cuts (N 4, D 18.1 mm, ap 5.08 mm, 0.05 mm a tooth), and peaks of the first."""
    published = {
        ("up", 0.5): (-351.840, 213.213, 429.5),
        ("down", 0.5): (175.3, 355.2, 429.5),
        ("slot", 1.0): (-176.6, 568.5, 859.1),
        ("up", 0.1): (-162.5, 16.0, 160.8),
        ("down", 0.1): (136.3, 86.7, 160.8),
    }
    for (side, share), (travel, normal, tangential) in published.items():
        load = compute_mean_load(HELICAL, FOUR, MillingCut(side), share * FOUR.diameter, 5.08e-3).compute_load(5e-5)[0]  # type: ignore[arg-type]
        name = f"mean force, {side}, ae/D {share:g}"
        yield f"{name}: travel (N)", travel, float(load[0])
        yield f"{name}: normal (N)", normal, float(load[1])
        yield f"{name}: tangential (N)", tangential, float(load[3]) / FOUR.radius
    wave = compute_waveform(HELICAL, FOUR, MillingCut("up"), (FOUR.radius, 5.08e-3), 5e-5)
    yield "peak, up, ae/D 0.5: travel (N)", 412.6, float(np.abs(wave.load[:, 0]).max())
    yield "peak, up, ae/D 0.5: normal (N)", 435.6, float(np.abs(wave.load[:, 1]).max())
    yield "peak, up, ae/D 0.5: resultant (N)", 492.5, find_peak_force(wave)


def list_coefficient_rows() -> Iterable[Row]:
    """Ti6Al4V by the oblique transformation (helix 30°, h 0.05 mm), and Kienzle as a line."""
    for rake, values in ((12, (1510, 215, 515)), (0, (1775, 559, 652))):
        found = compute_oblique_coefficients(TI6AL4V, math.radians(rake), math.radians(30), 5e-5, 0.1)
        for name, value, ours in zip(
            ("Ktc", "Krc", "Kac"), values, (found.Ktc_Pa, found.Krc_Pa, found.Kac_Pa), strict=True
        ):
            yield f"Ti6Al4V, rake {rake}°: {name} (N/mm²)", value, ours * 1e-6
    for low, high, cutting, edge in ((0.02, 0.10, 1232, 21.5), (0.005, 0.05, 1514, 11.1)):
        line = linearize_kienzle(800e6, 0.25, (low * 1e-3, high * 1e-3))
        yield f"Kienzle 800, 0.25 over {low:g} to {high:g} mm: Kc (N/mm²)", cutting, line.cutting_Pa * 1e-6
        yield f"Kienzle 800, 0.25 over {low:g} to {high:g} mm: Ke (N/mm)", edge, line.edge_N_m * 1e-3


def list_drilling_rows() -> Iterable[Row]:
    """One hole: D 10 mm, f 0.3 mm, point angle 140°, by three published forms."""
    drill = DrillingTool(diameter=0.01, half_point_angle=math.radians(70))
    for group, torque, thrust in (("vdi 6", 10.65, 2002), ("vdi 1", 7.64, 1436), ("vdi 22", 4.90, 920)):
        load = compute_full_load(find_drilling_coefficients(group), drill, 3e-4)
        yield f"Kienzle, {group}: torque (N·m)", torque, float(load.torque[0])
        yield f"Kienzle, {group}: thrust (N)", thrust, float(load.thrust[0])
    for name, factor, torque, thrust in (("S20C", 2.22, 12.61, 4548), ("aluminium", 1.01, 5.74, 2069)):
        load = compute_vendor_load(factor, 0.01, 3e-4)
        yield f"vendor's form, {name}: torque (N·m)", torque, float(load.torque[0])
        yield f"vendor's form, {name}: thrust (N)", thrust, float(load.thrust[0])


def list_stability_rows() -> Iterable[Row]:
    """Screen of 13 modes of a milling robot, lobes of two directions, multipliers of a one-mode slot."""
    import test_process_stability as cases
    from delay_reference import ChebyshevMap

    from machopt.process.stability import (
        compute_depth_limit,
        compute_single_mode_limits,
        compute_stability_lobes,
        compute_tooth_period,
        find_lobe_minimum,
    )

    H, modes = cases.directional(cases.ROBOT_CUT, cases.TWO, "down", 0.005), cases.robot_modes()
    for rpm, published in cases.SCREEN.items():
        T = compute_tooth_period(rpm, 2)
        screen = compute_single_mode_limits(modes, H, T).min(axis=1) * 1e3
        coupled = compute_depth_limit(modes, H, T).depth * 1e3
        for row, angle in enumerate(cases.ANGLES):
            yield f"robot, {rpm} rpm, feed {angle}°: screen (mm)", published[row], float(screen[row])
            if rpm in cases.FULL:
                full = ChebyshevMap(cases.reference(modes, row, cases.ROBOT_CUT, "down", 0.005, float(T)), 10)
                exact = cases.first_unstable(full.radius, 0.8e-3 * coupled[row], 2e-3 * coupled[row], 1.02)
                name = f"robot, {rpm} rpm, feed {angle}°"
                yield f"{name}: published full solution against ours (mm)", cases.FULL[rpm][row], exact * 1e3
                yield f"{name}: our full solution against the coupled limit (mm)", exact * 1e3, float(coupled[row])
    H = cases.directional(cases.ALUMINIUM, cases.TWO, "down", 0.01)
    least = find_lobe_minimum(cases.LEEKUN, H)
    yield "two directions: least depth of the lobes (mm)", 0.9571, least.depth * 1e3
    yield "two directions: its frequency (Hz)", 1440.2, least.omega / 2 / math.pi
    speeds = np.array([4000, 6000, 8000, 10000, 12000, 15000.0])
    lobes = compute_stability_lobes(cases.LEEKUN, H, speeds, 2).depth * 1e3
    for rpm, value, ours in zip(speeds, (1.091, 1.607, 1.134, 1.449, 0.959, 1.719), lobes, strict=True):
        yield f"two directions, {rpm:.0f} rpm: lobe (mm)", value, float(ours)
    full = ChebyshevMap(cases.slot_benchmark(5000, 1.0), 24, 3)
    for depth, value in ((0.2, 0.819743), (0.5, 1.073976), (0.7, 1.221556), (1.0, 1.406473)):
        yield f"slot, 5000 rpm, {depth:g} mm: multiplier (reference of the tests)", value, full.radius(depth * 1e-3)


def main() -> None:
    """Print the table."""
    print(f"{'number':78}{'published':>12}{'ours':>12}{'off':>9}")
    for rows in (list_milling_rows(), list_coefficient_rows(), list_drilling_rows(), list_stability_rows()):
        for name, published, ours in rows:
            print(f"{name:78}{published:12.6g}{ours:12.6g}{100 * (ours / published - 1):8.2f} %")


if __name__ == "__main__":
    main()

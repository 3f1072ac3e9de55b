"""Peak force in a revolution, summed layer by layer, compared with exact integrals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.process.milling.instantaneous_force import compute_waveform, find_peak_force
from machopt.process.milling.milling_cut import MillingCut, MillingCutter
from machopt.verification.motion.process.peak_load import GIVEN_SHARE, _cut_into_slices, compute_peak_force


@pytest.mark.parametrize("seed", range(12))
def test_random_cutters_and_cuts(seed: int) -> None:
    """Flat, bull-nose and ball cutters; helix of either hand or none; run-out;
    up, down, slot; both spindle directions."""
    rng = np.random.default_rng(seed)
    D, teeth = rng.uniform(6e-3, 25e-3), int(rng.integers(1, 6))
    corner = float(rng.choice([0.0, 0.1, 0.5])) * D
    helix = math.radians(float(rng.choice([0, -20, 30, 45])))
    runout, ap, feed = float(rng.choice([0.0, 10e-6, 30e-6])), rng.uniform(0.3e-3, 12e-3), rng.uniform(10e-6, 150e-6)
    side, spindle = rng.choice(["up", "down", "slot"]), rng.choice(["cw", "ccw"])
    ae = D if side == "slot" else rng.uniform(0.05, 1.0) * D
    axial = 0.0 if helix == 0.0 else 1.0
    coefficients = MillingCoefficients(
        Ktc_Pa=767e6,
        Krc_Pa=169e6,
        Kac_Pa=222e6 * axial,
        Kte_N_m=27.7e3,
        Kre_N_m=26.6e3,
        Kae_N_m=700.0 * axial,
        h_range_m=(0.0, 1e-3),
        sigma_log=0.0,
        source="",
    )
    cutter = MillingCutter(diameter=D, teeth=teeth, helix=helix, length=0.1, corner_radius=corner, runout=runout)
    geometry = CutterGeometry(diameter=D, length=0.1, teeth=teeth, helix=helix, corner=corner, runout=runout)
    exact = find_peak_force(compute_waveform(coefficients, cutter, MillingCut(side, spindle), (ae, ap), feed))
    slices = _cut_into_slices(geometry, ae, ap, side)
    found = compute_peak_force(coefficients, geometry, spindle, slices, feed)
    assert found == pytest.approx(exact, rel=0.5 * GIVEN_SHARE)

"""Mean milling load of the verifier compared with the closed form of the planner."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.process import CutSide
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import MillingCut, MillingCutter
from machopt.verification.motion.process.mill_load import compute_mill_load

COEFFICIENTS = MillingCoefficients(
    Ktc_Pa=767e6,
    Krc_Pa=169e6,
    Kac_Pa=222e6,
    Kte_N_m=27700.0,
    Kre_N_m=26600.0,
    Kae_N_m=700.0,
    sigma_log=0.2,
    h_range_m=None,
    source="test",
)
FEED_PER_TOOTH = 1e-4  # m


@pytest.mark.parametrize("corner_mm", [0.5, 2.0, 6.0, 8.5])
@pytest.mark.parametrize("ae_mm", [0.2, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("side", ["up", "down"])
def test_mean_load_agrees_with_the_closed_form(corner_mm: float, ae_mm: float, side: CutSide) -> None:
    helix, corner, ae, ap = np.deg2rad(30.0), 1e-3 * corner_mm, 1e-3 * ae_mm, 6e-3
    cutter = MillingCutter(diameter=17e-3, teeth=2, helix=helix, length=80e-3, corner_radius=corner)
    expected = compute_mean_load(COEFFICIENTS, cutter, MillingCut(side), ae, ap).compute_load(FEED_PER_TOOTH)[0]
    geometry = CutterGeometry(diameter=17e-3, length=80e-3, corner=corner, teeth=2, helix=helix)
    edge, slope = compute_mill_load(COEFFICIENTS, geometry, side, "cw", (ae, ap))
    found = edge + slope * FEED_PER_TOOTH
    assert np.linalg.norm((found - expected)[:3]) <= 1e-6 * np.linalg.norm(expected[:3])
    assert found[3] == pytest.approx(expected[3], rel=1e-6)

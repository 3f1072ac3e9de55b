"""Verification of the depth limit over the whole delay: correct limits pass and wrong ones fail for any ωT."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.milling_cut import MillingCut, MillingCutter
from machopt.process.stability import StructuralModes, compute_depth_limit, compute_directional_matrix
from machopt.verification.motion.checks.stability_columns import LIMIT_SHARE, compute_excess, is_limit_reached
from machopt.verification.motion.process.delay_stability_sweep import DelaySweep
from machopt.verification.motion.process.stability import DelayLaw

Array = NDArray[np.float64]
CUTTER = MillingCutter(diameter=0.02, teeth=2, helix=0.5, length=0.1)
ALUMINIUM = MillingCoefficients(
    Ktc_Pa=767e6,
    Krc_Pa=169e6,
    Kac_Pa=222e6,
    Kte_N_m=0.0,
    Kre_N_m=0.0,
    Kae_N_m=0.0,
    h_range_m=(0.0, 1e-3),
    sigma_log=0.0,
    source="",
)


@dataclass(frozen=True)
class RandomCut:
    """Modes, directions and delay, and the limit that a plan states."""

    law: DelayLaw
    stated: float  # m; without a limit: the depth above which no limit is stated
    is_limited: bool


def draw_cuts(count: int, seed: int) -> list[RandomCut]:
    """Draw two to six modes of 6 to 300 Hz, a quarter with two close ones; 300 to 24,000 rev/min; any side and ae."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        n = int(rng.integers(2, 7))
        hertz = np.exp(rng.uniform(math.log(6), math.log(300), n)) if k % 3 == 0 else rng.uniform(7, 30, n)
        hertz = np.sort(hertz)
        if k % 4 == 0:
            hertz[1] = hertz[0] * rng.uniform(1.0, 1.15)
            hertz = np.sort(hertz)
        omega, zeta = 2.0 * math.pi * hertz, rng.uniform(0.01, 0.06, n)
        shape = rng.standard_normal((n, 3)) / np.sqrt(rng.uniform(20, 800, n))[:, None]
        T = 60.0 / (2.0 * math.exp(rng.uniform(math.log(300), math.log(24_000))))
        cut = MillingCut("up" if rng.random() < 0.5 else "down")
        arc = compute_contact_arc(CUTTER, cut, np.array(rng.uniform(0.2e-3, 20e-3)), CUTTER.radius)
        H = compute_directional_matrix(ALUMINIUM, CUTTER, cut, arc)
        largest = 10.0 ** rng.uniform(-3.0, -0.5)
        limit = float(
            compute_depth_limit(StructuralModes(omega[None], zeta[None], shape[None]), H, T, largest=largest).depth[0]
        )
        G = shape @ np.hstack([H, np.zeros((3, 1))]) @ shape.T
        out.append(RandomCut(DelayLaw(zeta, omega, G, T), min(limit, largest), math.isfinite(limit)))
    return out


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_correct_limits_pass_at_all_spindle_speeds(seed: int) -> None:
    cuts = draw_cuts(150, seed)
    assert sum(cut.is_limited for cut in cuts) > 60
    assert [cut for cut in cuts if compute_excess(cut.law, cut.stated) > LIMIT_SHARE] == []
    assert [cut for cut in cuts if cut.is_limited and not is_limit_reached(cut.law, cut.stated)] == []


@pytest.mark.parametrize("seed", [1, 2])
def test_wrong_limits_are_found_at_all_spindle_speeds(seed: int) -> None:
    """Includes fast modes: in a third of the sets, the first mode rotates by more than 1 rad in a tooth period."""
    cuts = [cut for cut in draw_cuts(150, seed) if cut.is_limited]
    assert sum(cut.law.omega[0] * cut.law.T > 1.0 for cut in cuts) > 0.25 * len(cuts)
    assert [cut for cut in cuts if compute_excess(cut.law, 1.05 * cut.stated) <= LIMIT_SHARE] == []
    assert [cut for cut in cuts if is_limit_reached(cut.law, 0.6 * cut.stated)] == []


def test_limit_of_one_mode_equals_that_of_the_real_part() -> None:
    """For one mode b = −1 / (2 G Re Φ), at the worst lobe 2 k ζ (1 + ζ) / G; Altıntaş (2012), eq. 3.44."""
    omega, zeta, gain = 2.0 * math.pi * 20.0, 0.03, -0.05e6
    least = 2.0 * omega**2 * zeta * (1.0 + zeta) / abs(gain)
    found = []
    for T in np.linspace(0.5, 3.0, 60) * 2.0 * math.pi / omega:
        law = DelayLaw(np.array([zeta]), np.array([omega]), np.array([[gain]]), float(T))
        sweep = DelaySweep(law, 10.0 * least)
        sweep.doubling = math.inf  # period doubling occurs only in interrupted cuts
        found.append(sweep.find_limit())
    assert min(found) == pytest.approx(least, rel=0.01)
    assert min(found) >= least * 0.999


def test_stated_limit_with_unknown_damping_is_wrong() -> None:
    law = draw_cuts(1, 1)[0].law
    unknown = DelayLaw(np.append(law.zeta[:-1], np.nan), law.omega, law.G, law.T)
    assert compute_excess(unknown, 1e-3) == math.inf
    assert not is_limit_reached(unknown, 1e-3)

"""Waves of a joint that may be named as a transmission error, and waves that are a correction without a name.

A sum of low orders on a part of a turn is any smooth curve. It lowers the error, but its cause is not known. A wave is
named only if the readings cover its period, and if its amplitude is one that gears have. A wave of a worn gear is
larger. It is named where the readings cover two periods of an order that neither frames nor gravity compensators have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.effects.joint.harmonic_functions import ARCSEC
from machopt.effects.joint.joint_angle_errors import (
    CORRECTION,
    ORDINAL_WORDS,
    WAVES,
    ZERO,
    TransmissionError,
    UnnamedAngleError,
    ZeroOffset,
)
from machopt.effects.measured_angle_range import RANGE_KEY
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding

ORDERS, UNNAMED_ORDERS = TransmissionError.shape[0].key, UnnamedAngleError.shape[0].key
COS, SIN = (p.key for p in TransmissionError.coefficients)
OFFSET = ZeroOffset.coefficients[0].key


@dataclass(frozen=True)
class SplitWaves:
    """A finding of waves, separated."""

    named: Finding | None  # transmission error of the waves that may be named
    unnamed: Finding | None  # correction of the others


def split_waves(finding: Finding) -> SplitWaves:
    """Separate the waves of a transmission error that may be named from the others.

    Args:
        finding: Any finding.

    Returns:
        Both parts; a finding that is no transmission error with an angle range is named as a whole. The waves of a
        gravity compensator only state its rotation in kinematics.yaml.
    """
    c = finding.correction
    if (
        finding.effect != WAVES.file_word
        or not isinstance(c, KinematicCorrection)
        or c.effect != WAVES.file_word
        or RANGE_KEY not in c.parameters
    ):
        return SplitWaves(finding, None)
    orders, cos, sin = (np.atleast_1d(np.asarray(c.parameters[key], float)) for key in (ORDERS, COS, SIN))
    low, high = c.parameters[RANGE_KEY]
    periods = orders * (high - low) / 360.0
    is_sure = (periods >= thresholds.LIMITS.certain_periods) & (orders >= thresholds.LIMITS.gear_order)
    largest = np.where(is_sure, thresholds.RATIOS.implausible, thresholds.LEVELS.three_sigma)
    is_plausible = np.hypot(cos, sin) <= largest * TransmissionError.prior / ARCSEC
    is_named = (periods >= thresholds.LIMITS.named_periods) & is_plausible
    if is_named.all():
        return SplitWaves(finding, None)
    unnamed = convert_to_unnamed(finding, ~is_named)
    if not is_named.any():
        return SplitWaves(None, unnamed)
    correction = replace(c, parameters=_select_waves(c.parameters, is_named.tolist(), ORDERS))
    sizes = _select_sizes(finding.parameters, orders[is_named].tolist())
    return SplitWaves(replace(finding, correction=correction, parameters=sizes, curve=None), unnamed)


def convert_to_unnamed(finding: Finding, which: Sequence[bool] | NDArray[np.bool_] | None = None) -> Finding:
    """Return waves of a finding as a correction without a name; other findings stay as they are.

    Args:
        finding: Finding with a kinematic correction.
        which: Waves to convert; None: all.
    """
    c = finding.correction
    if not isinstance(c, KinematicCorrection) or c.effect != WAVES.file_word:
        return finding
    chosen = [True] * len(np.atleast_1d(c.parameters[ORDERS])) if which is None else [bool(v) for v in which]
    correction = KinematicCorrection(
        CORRECTION.file_word, c.location, _select_waves(c.parameters, chosen, UNNAMED_ORDERS)
    )
    return replace(finding, effect=CORRECTION.file_word, correction=correction, curve=None)


def is_constant_of_unnamed_waves(finding: Finding, unnamed: Sequence[Finding]) -> bool:
    """Return whether a zero offset is the constant part of waves of its joint that have no name.

    A wave of less than two periods and a constant are one smooth function of the angle. If its cause is not known, the
    cause of its constant part is not known either, unless that part is the largest.

    Args:
        finding: Any finding.
        unnamed: Waves of certain size that have no name.

    Returns:
        True if so.
    """
    c = finding.correction
    if finding.effect != ZERO.file_word or not isinstance(c, KinematicCorrection):
        return False
    offset = abs(np.radians(float(c.parameters[OFFSET]))) / ARCSEC
    waves = [
        u.correction.parameters
        for u in unnamed
        if isinstance(u.correction, KinematicCorrection)
        and (u.effect, u.location) == (CORRECTION.file_word, c.location)
    ]
    return any(_find_largest_slow_amplitude(w) > offset for w in waves)


def _find_largest_slow_amplitude(wave: Mapping[str, Any]) -> float:
    """Return the largest amplitude (arcsec) of the waves of less than two periods within the range of the joint."""
    low, high = wave.get(RANGE_KEY, (0.0, 0.0))
    periods = np.asarray(wave[UNNAMED_ORDERS]) * (high - low) / 360.0
    return float(np.where(periods < thresholds.LIMITS.certain_periods, np.hypot(wave[COS], wave[SIN]), 0.0).max())


def _select_waves(parameters: Mapping[str, object], chosen: Sequence[bool], order_key: str) -> dict[str, object]:
    out: dict[str, object] = {}
    for key, name in ((ORDERS, order_key), (COS, COS), (SIN, SIN)):
        values = np.atleast_1d(np.asarray(parameters[key], float)).tolist()
        out[name] = [v for v, keep in zip(values, chosen, strict=True) if keep]
    return out | ({RANGE_KEY: parameters[RANGE_KEY]} if RANGE_KEY in parameters else {})


def _select_sizes(parameters: Mapping[str, EstimatedValue], orders: Sequence[float]) -> dict[str, EstimatedValue]:
    """Return the sizes of the named waves, numbered anew."""
    words = ("", *(f"{word}_" for word in ORDINAL_WORDS))
    first = parameters["order"].value
    found = []
    for k, word in enumerate(words):
        size, order = parameters.get(f"{word}amplitude"), parameters.get(f"{word}order")
        if size is None:
            break
        value = (k + 1.0) * first if order is None else order.value
        if any(abs(value - n) <= 1e-6 * n for n in orders):
            found.append((size, order or replace(parameters["order"], value=value)))
    out = dict[str, EstimatedValue]()
    for word, (size, order) in zip(words, found, strict=False):
        out |= {f"{word}amplitude": size, f"{word}order": order}
    return out

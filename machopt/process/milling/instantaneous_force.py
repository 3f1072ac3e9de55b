"""Force of an end mill along its rotation: exact axial integral with helix lag and run-out.

The element of tooth j at the height z has the angle ψ = φ + 2π j/N − k z with k = tan β / R. Run-out offsets the
cutter's axis by ρ in a direction that turns with the spindle. The chip of a tooth is what the teeth before it left,

    h = max(0, min over m = 1 … N of m c sin ψ + R_j − R_(j+m)),   R_j(z) = R + ρ cos(λ + φ − ψ),

so that a tooth may leave the cut. Every candidate is A sin ψ + B cos ψ with A and B common to all teeth at one rotation
φ. The angles at which two candidates, or one of them and zero, are equal divide the arc of contact into intervals of
one sinusoid each. The axial integral over each is closed. Run-out does not change the arc of contact here. A corner
radius is divided into slices of constant radius and κ.

Source: Altıntaş, Manufacturing Automation, 2nd ed. (2012), section 2.8; run-out: Kline & DeVor, Int. J. Mach. Tool Des.
Res. 23 (1983) 123.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.mean_force import get_axial_hand
from machopt.process.milling.milling_cut import (
    MillingCut,
    MillingCutter,
    check_cut_dimensions,
    check_cutter,
    check_feed_per_tooth,
)

ROTATION_STEPS = 720  # rotation angles of a revolution: a peak is found to 1e-5 of the force's amplitude
CORNER_SLICES = 64
_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class CuttingWaveform:
    """Load on the tool over one revolution."""

    angle: Array  # (n,) rad, rotation φ of tooth 0 at the tip, evenly spaced
    load: Array  # (n, 4) travel, normal, axial force in N, torque in N·m

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True, kw_only=True)
class CutterSlice:
    """Part of the cutter between two heights, of one radius and κ."""

    low: float  # m
    high: float
    radius: float
    kappa: float
    start: float  # rad, arc of contact
    end: float


@dataclass(frozen=True)
class _ChipIntervals:
    """Chip thickness A sin ψ + B cos ψ over intervals of ψ, one row a rotation; ``cuts`` is 0 outside of the cut."""

    edges: Array  # (n, b + 1) rad, ascending
    A: Array  # (n, b) m
    B: Array
    cuts: Array


def compute_waveform(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    cut: MillingCut,
    depths: tuple[float, float],
    fz: float,
    angles: Array | None = None,
) -> CuttingWaveform:
    """Return the load along the rotation.

    Args:
        coefficients: milling coefficients.
        cutter: end mill.
        cut: direction of the cut.
        depths: radial and axial depth of cut, m.
        fz: m, feed per tooth.
        angles: (n,) rad, rotations; None: one revolution in ``ROTATION_STEPS`` steps.

    Raises:
        CuttingInputError: an impossible cutter, cut or feed.
    """
    check_cutter(cutter, coefficients)
    check_cut_dimensions(cutter, cut, np.array([depths[0]]), np.array([depths[1]]))
    check_feed_per_tooth(np.array([fz]))
    return compute_slices_waveform(coefficients, cutter, cut, _divide_cutter(cutter, cut, *depths), fz, angles)


def compute_slices_waveform(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    cut: MillingCut,
    parts: Sequence[CutterSlice],
    fz: float,
    angles: Array | None = None,
) -> CuttingWaveform:
    """Return the load along the rotation of a cutter whose slices have known arcs of contact.

    Args:
        coefficients: milling coefficients.
        cutter: end mill.
        cut: direction of the cut; its spindle direction counts.
        parts: slices; one with several arcs occurs several times.
        fz: m, feed per tooth.
        angles: (n,) rad, rotations; None: one revolution in ``ROTATION_STEPS`` steps.
    """
    phi = np.linspace(0.0, _TURN, ROTATION_STEPS, endpoint=False)
    if angles is not None:
        phi = np.asarray(angles, float)
    total = np.zeros((len(phi), 4))
    for part in parts:
        if part.end > part.start and part.high > part.low:
            total += _compute_slice(coefficients, cutter, cut, part, fz, phi)
    return CuttingWaveform(phi, total)


def find_peak_force(waveform: CuttingWaveform) -> float:
    """Return the largest resultant of travel and normal force over the revolution, N.

    It follows from the model's rotation and run-out, not from measured peaks: a dynamometer shows other ones.

    Args:
        waveform: load over one revolution.
    """
    return float(np.hypot(waveform.load[:, 0], waveform.load[:, 1]).max())


def compute_surface_generation_load(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    cut: MillingCut,
    depths: tuple[float, float],
    fz: float,
    heights: Array,
) -> Array:
    """Return the load at the moment when the wall is made at each height, (n, 4).

    A tooth makes the wall at ψ = 0 (up and slot) or ψ = π (down). With helix, the height z is made at the rotation
    φ = ψ − 2π j/N + k z. With run-out, j is the tooth of the largest radius at that height.

    Args:
        coefficients: milling coefficients.
        cutter: end mill.
        cut: direction of the cut; the other wall of a slot is the ``down`` cut of full depth.
        depths: radial and axial depth of cut, m.
        fz: m, feed per tooth.
        heights: (n,) m above the tip.

    Raises:
        CuttingInputError: an impossible cutter, cut or feed.
    """
    at = find_generation_angles(cutter, cut, heights)
    return compute_waveform(coefficients, cutter, cut, depths, fz, at).load


def find_generation_angles(cutter: MillingCutter, cut: MillingCut, heights: Array) -> Array:
    """Return (n,) rad, the rotations at which the wall is made at each height.

    Args:
        cutter: end mill.
        cut: direction of the cut.
        heights: (n,) m above the tip.
    """
    lag = _compute_lag(cutter, cut) * np.asarray(heights, float)
    teeth = np.arange(cutter.teeth) * (_TURN / cutter.teeth)
    longest = np.argmax(np.cos(cutter.runout_angle - teeth + lag[:, None]), axis=1) if cutter.runout else 0
    return np.asarray((math.pi if cut.side == "down" else 0.0) - teeth[longest] + lag)


def _compute_lag(cutter: MillingCutter, cut: MillingCut) -> float:
    """Return k, rad of lag per m of height: positive where helix and spindle have the same hand."""
    return math.tan(cutter.helix) / cutter.radius * cut.mirror


def _divide_cutter(cutter: MillingCutter, cut: MillingCut, ae: float, ap: float) -> list[CutterSlice]:
    parts, rc = [], cutter.corner_radius
    top = min(ap, rc)
    if rc > 0.0:
        edges = np.linspace(0.0, math.acos(max(1.0 - top / rc, 0.0)), CORNER_SLICES + 1)
        for a, b in itertools.pairwise(edges):
            low, high = rc * (1.0 - math.cos(a)), rc * (1.0 - math.cos(b))
            kappa = math.asin(min((high - low) / (rc * (b - a)), 1.0))  # dz / sin κ is the length of the edge
            parts.append((low, high, cutter.radius - rc + rc * math.sin(0.5 * (a + b)), kappa))
    if ap > rc:
        parts.append((rc, ap, cutter.radius, math.pi / 2))
    found = []
    for low, high, radius, kappa in parts:
        arc = compute_contact_arc(cutter, cut, np.array(min(ae, cutter.diameter)), radius)
        start, end = float(arc.start), float(arc.end)
        found.append(CutterSlice(low=low, high=high, radius=radius, kappa=kappa, start=start, end=end))
    return found


def _compute_slice(
    K: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, part: CutterSlice, fz: float, phi: Array
) -> Array:
    chips = _find_chip_intervals(cutter, part, fz, phi)
    k = _compute_lag(cutter, cut)
    first = phi[:, None] + np.arange(cutter.teeth) * (_TURN / cutter.teeth)  # ψ at the tip
    if abs(k) * (part.high - part.low) < 1e-9:
        moments = (part.high - part.low) * _evaluate_moments(chips, first - k * part.low)
    else:
        moments = (
            _integrate_moments(chips, first - k * part.low) - _integrate_moments(chips, first - k * part.high)
        ) / k
    hs, hc, h, s, c, one = np.moveaxis(moments.sum(axis=1), -1, 0)
    sine, cosine, hand = math.sin(part.kappa), math.cos(part.kappa), get_axial_hand(cutter, cut)
    s, c, one = s / sine, c / sine, one / sine  # h db = h_ψ dz and db = dz / sin κ
    t_sin, t_cos, t = K.Ktc_Pa * hs + K.Kte_N_m * s, K.Ktc_Pa * hc + K.Kte_N_m * c, K.Ktc_Pa * h + K.Kte_N_m * one
    r_sin, r_cos, r = K.Krc_Pa * hs + K.Kre_N_m * s, K.Krc_Pa * hc + K.Kre_N_m * c, K.Krc_Pa * h + K.Kre_N_m * one
    a_sin, a_cos, a = K.Kac_Pa * hs + K.Kae_N_m * s, K.Kac_Pa * hc + K.Kae_N_m * c, K.Kac_Pa * h + K.Kae_N_m * one
    return np.column_stack(
        [
            -t_cos - r_sin * sine - hand * a_sin * cosine,
            cut.mirror * (t_sin - r_cos * sine - hand * a_cos * cosine),
            r * cosine - hand * a * sine,
            cut.mirror * part.radius * t,
        ]
    )


def _find_chip_intervals(cutter: MillingCutter, part: CutterSlice, fz: float, phi: Array) -> _ChipIntervals:
    n = len(phi)
    if cutter.runout == 0.0:
        one = np.ones((n, 1))
        return _ChipIntervals(np.tile([part.start, part.end], (n, 1)), fz * one, 0.0 * one, one)
    m = np.arange(1, cutter.teeth + 1)
    towards = cutter.runout_angle + phi[:, None]  # direction of the offset
    before = towards - m * (_TURN / cutter.teeth)  # tooth j + m passed the same place m tooth periods ago
    rho = cutter.runout
    A = np.column_stack([np.zeros(n), m * fz + rho * (np.sin(towards) - np.sin(before))])
    B = np.column_stack([np.zeros(n), rho * (np.cos(towards) - np.cos(before))])
    i, j = np.triu_indices(cutter.teeth + 1, 1)
    meet = np.arctan2(-(B[:, i] - B[:, j]), A[:, i] - A[:, j]) % math.pi  # ψ in 0 … π where two are equal
    ends = np.tile([part.start, part.end], (n, 1))
    edges = np.sort(np.column_stack([ends, np.clip(meet, part.start, part.end)]), axis=1)
    middle = 0.5 * (edges[:, :-1] + edges[:, 1:])
    h = A[:, None, 1:] * np.sin(middle)[..., None] + B[:, None, 1:] * np.cos(middle)[..., None]
    least = h.argmin(axis=-1)
    cuts = np.take_along_axis(h, least[..., None], axis=-1)[..., 0] > 0.0
    row = np.arange(n)[:, None]
    return _ChipIntervals(edges, A[row, 1 + least] * cuts, B[row, 1 + least] * cuts, cuts.astype(float))


def _integrate_moments(chips: _ChipIntervals, psi: Array) -> Array:
    """Integrate h sin, h cos, h, sin, cos, 1 over the contact from 0 to ψ, whole turns included: (n, N, 6)."""
    turns = np.floor(psi / _TURN)
    low, high = chips.edges[:, None, :-1], chips.edges[:, None, 1:]
    total = _sum_intervals(chips, low, high)
    upper = np.clip((psi - turns * _TURN)[..., None], low, high)
    return np.asarray(turns[..., None] * total + _sum_intervals(chips, low, upper))


def _sum_intervals(chips: _ChipIntervals, low: Array, high: Array) -> Array:
    A, B, cuts = chips.A[:, None, :], chips.B[:, None, :], chips.cuts[:, None, :]
    s0, c0, s1, c1 = np.sin(low), np.cos(low), np.sin(high), np.cos(high)
    sc, turn = 0.5 * (s1**2 - s0**2), high - low
    ss, cc = 0.5 * (turn - (s1 * c1 - s0 * c0)), 0.5 * (turn + (s1 * c1 - s0 * c0))
    s, c = c0 - c1, s1 - s0
    parts = (A * ss + B * sc, A * sc + B * cc, A * s + B * c, cuts * s, cuts * c, cuts * turn)
    return np.stack([p.sum(axis=-1) for p in parts], axis=-1)


def _evaluate_moments(chips: _ChipIntervals, psi: Array) -> Array:
    """Return h sin, h cos, h, sin, cos, 1 at ψ where the tooth cuts: (n, N, 6)."""
    at = (psi % _TURN)[..., None]
    inside = ((at >= chips.edges[:, None, :-1]) & (at < chips.edges[:, None, 1:])).astype(float)
    A, B, cuts = ((inside * x[:, None, :]).sum(axis=-1) for x in (chips.A, chips.B, chips.cuts))
    s, c = np.sin(psi), np.cos(psi)
    h = A * s + B * c
    return np.stack([h * s, h * c, h, cuts * s, cuts * c, cuts], axis=-1)

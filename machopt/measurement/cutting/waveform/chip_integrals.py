"""Integrals of the chip over the engaged edges as CasADi expressions, with exact derivatives.

The element of tooth j at the height z has the angle ψ = φ + 2π j/N − k z. Its chip is what the teeth before it left,

    h = max(0, min over m = 1 … N of h_m),
    h_m = m c sin ψ + r_j − r_(j+m) + m² c² cos² ψ/(2 R) − m N c² sin ψ cos ψ/(2π R),
    r_j = ρ_c cos α + ρ_s sin α,   α = ψ − φ.

Tooth j + m runs 2π m/N ahead of tooth j and passed the same place m tooth periods earlier. The terms in c² are those of
trochoidal paths to second order. They follow from the line through the spindle's axis and the element, which the
earlier tooth crossed at D = m c (1 − N c cos ψ/(2π R)) behind: h_m = r_j + D sin ψ − √(r_(j+m)² − D² cos² ψ).
Run-out turns an element by (ρ_s cos α − ρ_c sin α)/R, too, and shifts the end of the arc at the width of cut, where
(R + r_j) |cos ψ| = R − ae.

At one rotation φ every candidate is A_m sin ψ + B_m cos ψ up to a small part, the same for all teeth; B_m holds
± m² c²/(2 R) before and behind ψ = π/2. The angles at which two candidates, or one of them and zero, are equal divide
the arc into intervals of one sinusoid each, and the integral over each is closed, small part included. The limits of
the intervals are differentiable functions of φ and of the run-out, so that the derivative of the sum is exact, entry,
exit and loss of contact included.

Source: Martellotti, Trans. ASME 63 (1941) 677 (paths); Kline & DeVor, Int. J. Mach. Tool Des. Res. 23 (1983) 123.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from machopt.numerics.array_types import Array
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.milling_cut import MillingCut, MillingCutter

LEAST_LAG = 0.02  # rad over the depth of cut: straight teeth enter within this angle instead of at once
STRAIGHT = 1e-12  # rounding of the sine where the arc ends at a wall
_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class ChipIntegrals:
    """Function of φ (rad), c, ρ_c, ρ_s (m): six integrals over z and their derivatives by φ, ρ_c and ρ_s.

    The integrals are h sin ψ, h cos ψ, h in m², and sin ψ, cos ψ, 1 in m, summed over the teeth.
    """

    function: ca.Function  # (φ, c, ρ_c, ρ_s) → (6,), (6, 3)

    def evaluate(self, phi: Array, feed_per_tooth: float, runout: Array) -> tuple[Array, Array]:
        """Return the integrals and their derivatives at S rotations.

        Args:
            phi: (S,) rad.
            feed_per_tooth: m.
            runout: (2,) m, (ρ_c, ρ_s).

        Returns:
            (S, 6), and (S, 6, 3) by φ, ρ_c, ρ_s.
        """
        count = len(phi)
        given = (ca.DM(phi % _TURN).T, float(feed_per_tooth), float(runout[0]), float(runout[1]))
        values, slopes = self.function.map(count)(*given)
        return np.asarray(values).T, np.asarray(slopes).reshape(6, count, 3).transpose(1, 0, 2)


@dataclass(frozen=True, kw_only=True)
class _Sinusoid:
    """Chip A sin ψ + B cos ψ + E (cos² ψ − side cos ψ) + F sin ψ cos ψ from ``low`` to ``high``."""

    low: ca.SX  # rad
    high: ca.SX
    A: ca.SX  # m
    B: ca.SX
    E: ca.SX
    F: ca.SX
    side: float  # +1 before ψ = π/2, −1 behind
    cuts: ca.SX  # 0 where nothing is cut


@dataclass(frozen=True)
class _RunningIntegral:
    """Integral from the start of the arc to ψ; a piece has five factors of h and six offsets."""

    low: list[ca.SX]  # rad, ascending, where each piece starts
    steps: list[ca.SX]  # (11,) the first piece, then the change from piece to piece
    end: ca.SX  # rad
    total: ca.SX  # (6,) over the whole arc


@dataclass(frozen=True)
class _Candidates:
    """Chips against the surface left by the teeth m = 1 … N before; index 0 is zero."""

    A: list[ca.SX]  # m
    B: list[ca.SX]
    E: list[ca.SX]
    F: list[ca.SX]


def build_chip_integrals(cutter: MillingCutter, cut: MillingCut, ae: float, ap: float) -> ChipIntegrals:
    """Return the integrals of a flat end mill.

    Args:
        cutter: end mill of corner radius 0.
        cut: direction of the cut.
        ae: m, radial depth of cut.
        ap: m, axial depth of cut.
    """
    phi, c, rho_c, rho_s = (ca.SX.sym(name) for name in ("phi", "c", "rho_c", "rho_s"))
    arc = compute_contact_arc(cutter, cut, np.array(min(ae, cutter.diameter)), cutter.radius)
    early = cutter.teeth * c / (2.0 * cutter.radius)  # rad, by which a tooth may cut before ψ = 0 and behind π
    start, end = _build_arc(cutter, (float(arc.start), float(arc.end)), early, phi, (rho_c, rho_s))
    candidates = _build_candidates(cutter, phi, c, (rho_c, rho_s))
    chips = []
    if float(arc.start) < 0.5 * math.pi:
        chips += _divide_arc(candidates, start, ca.fmin(end, 0.5 * math.pi), 1.0)
    if float(arc.end) > 0.5 * math.pi:
        chips += _divide_arc(candidates, ca.fmax(start, 0.5 * math.pi), end, -1.0)
    lag = cut.mirror * math.tan(cutter.helix) / cutter.radius
    if abs(lag) * ap < LEAST_LAG:
        lag = math.copysign(LEAST_LAG / ap, lag)
    integral = _build_running_integral(chips)
    total = ca.SX.zeros(6, 1)
    for j in range(cutter.teeth):
        ends = []
        for lead in (_TURN * j / cutter.teeth, _TURN * j / cutter.teeth - lag * ap):  # α at the tip and at the depth
            turned = (rho_s * math.cos(lead) - rho_c * math.sin(lead)) / cutter.radius
            ends.append(phi + lead + turned)
        total += (_evaluate(integral, ends[0], early) - _evaluate(integral, ends[1], early)) * ap / (ends[0] - ends[1])
    slopes = ca.jacobian(total, ca.vertcat(phi, rho_c, rho_s))
    return ChipIntegrals(ca.Function("chip_integrals", [phi, c, rho_c, rho_s], [total, slopes]))


def _build_arc(
    cutter: MillingCutter, arc: tuple[float, float], early: ca.SX, phi: ca.SX, runout: tuple[ca.SX, ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return where a tooth may cut, rad: from wall to wall, or to where its own radius leaves the material."""
    out = []
    for at, is_start in zip(arc, (True, False), strict=True):
        if abs(math.sin(at)) < STRAIGHT:
            out.append(at - early if is_start else at + early)
            continue
        own = runout[0] * ca.cos(at - phi) + runout[1] * ca.sin(at - phi)
        out.append(at + own / (cutter.radius * math.tan(at)))
    return out[0], out[1]


def _build_candidates(cutter: MillingCutter, phi: ca.SX, c: ca.SX, runout: tuple[ca.SX, ca.SX]) -> _Candidates:
    zero = ca.SX(0.0)
    A, B, E, F = [zero], [zero], [zero], [zero]
    own = _build_radius_terms(phi, runout)
    for m in range(1, cutter.teeth + 1):
        before = _build_radius_terms(phi - _TURN * m / cutter.teeth, runout) if m < cutter.teeth else own
        A.append(m * c + own[0] - before[0])
        B.append(own[1] - before[1])
        E.append(m**2 * c**2 / (2.0 * cutter.radius))
        F.append(-m * cutter.teeth * c**2 / (_TURN * cutter.radius))
    return _Candidates(A, B, E, F)


def _divide_arc(candidates: _Candidates, start: ca.SX, end: ca.SX, side: float) -> list[_Sinusoid]:
    """Return the chip over a part of the arc before or behind ψ = π/2 as intervals of one sinusoid each."""
    A, B = candidates.A, [b + side * e for b, e in zip(candidates.B, candidates.E, strict=True)]
    edges = [start, end]
    for i, j in itertools.combinations(range(len(A)), 2):
        meet = ca.atan2(B[i] - B[j], A[j] - A[i])
        meet = meet - math.pi * ca.floor(meet / math.pi + 0.5 * side)  # to −π/2 … π/2, or π/2 … 3π/2
        edges.append(ca.fmin(ca.fmax(meet, start), end))
    chips = []
    for low, high in itertools.pairwise(_sort(edges)):
        middle = 0.5 * (low + high)
        s, k = ca.sin(middle), ca.cos(middle)
        least, active = ca.SX(ca.inf), [ca.SX(0.0)] * 4
        for m in range(1, len(A)):
            h = A[m] * s + B[m] * k
            own = (A[m], B[m], candidates.E[m], candidates.F[m])
            active = [ca.if_else(h < least, new, old) for new, old in zip(own, active, strict=True)]
            least = ca.fmin(least, h)
        cuts = ca.if_else(least > 0.0, ca.SX(1.0), ca.SX(0.0))
        a, b, e, f = (cuts * value for value in active)
        chips.append(_Sinusoid(low=low, high=high, A=a, B=b, E=e, F=f, side=side, cuts=cuts))
    return chips


def _build_radius_terms(turned: ca.SX, runout: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the factors of sin ψ and cos ψ in ρ_c cos(ψ − turned) + ρ_s sin(ψ − turned)."""
    s, k = ca.sin(turned), ca.cos(turned)
    return runout[0] * s + runout[1] * k, runout[0] * k - runout[1] * s


def _sort(values: list[ca.SX]) -> list[ca.SX]:
    """Return the values in ascending order, by exchanges of neighbours."""
    out = list(values)
    for last in range(len(out) - 1, 0, -1):
        for n in range(last):
            out[n], out[n + 1] = ca.fmin(out[n], out[n + 1]), ca.fmax(out[n], out[n + 1])
    return out


def _build_running_integral(chips: list[_Sinusoid]) -> _RunningIntegral:
    """Return the integral from the start of the arc to ψ as pieces, each with its own constants."""
    pieces, offset = [], ca.SX.zeros(6, 1)
    for chip in chips:
        factors = ca.vertcat(chip.A, chip.B - chip.side * chip.E, chip.E, chip.F, chip.cuts)
        below = _integrate(factors, chip.low)
        pieces.append(ca.vertcat(factors, offset - below))
        offset = offset + _integrate(factors, chip.high) - below
    steps = [pieces[0]] + [new - old for old, new in itertools.pairwise(pieces)]
    return _RunningIntegral([chip.low for chip in chips], steps, chips[-1].high, offset)


def _evaluate(integral: _RunningIntegral, psi: ca.SX, early: ca.SX) -> ca.SX:
    """Return the integral from the start of the arc to ψ, whole turns included, (6,)."""
    turns = ca.floor((psi + early) / _TURN)
    at = ca.fmin(ca.fmax(psi - _TURN * turns, integral.low[0]), integral.end)
    piece = integral.steps[0]
    for low, step in zip(integral.low[1:], integral.steps[1:], strict=True):
        piece = piece + (at >= low) * step
    return _integrate(piece[:5], at) + piece[5:] + turns * integral.total


def _integrate(factors: ca.SX, psi: ca.SX) -> ca.SX:
    """Return an antiderivative of h sin ψ, h cos ψ, h, sin ψ, cos ψ, 1 by ψ, (6,).

    The factors of sin ψ, cos ψ, cos² ψ and sin ψ cos ψ make h; the fifth is 0 where nothing is cut.
    """
    A, B, E, F, cuts = ca.vertsplit(factors)
    s, k = ca.sin(psi), ca.cos(psi)
    sk, ss = 0.5 * s * s, 0.5 * (psi - s * k)  # ∫ sin cos, ∫ sin²
    kk, s3, k3 = psi - ss, s * s * s / 3.0, k * k * k / 3.0
    return ca.vertcat(
        A * ss + B * sk - E * k3 + F * s3,
        A * sk + B * kk + E * (s - s3) - F * k3,
        B * s - A * k + E * kk + F * sk,
        -cuts * k,
        cuts * s,
        cuts * psi,
    )

"""Mean force and torque of an end mill over a revolution, affine in the feed per tooth, with derivatives.

A slice of height dz with radius r and angle κ between the tool's axis and the normal of the cutting surface (90° on the
cylinder, 0 at the tip of a ball) has an edge db = dz / sin κ and a chip h = fz sin φ sin κ. The force on the tool is

    travel = −F_t cos φ − (F_r sin κ + s F_a cos κ) sin φ
    normal = +F_t sin φ − (F_r sin κ + s F_a cos κ) cos φ
    axial  = F_r cos κ − s F_a sin κ

with F_q = K_qc h db + K_qe db and s = +1 where helix and spindle have the same hand (right-hand helix, M3): such a cut
pulls the tool towards the work. The helix drops out of the mean.

Source: Altıntaş, Manufacturing Automation, 2nd ed. (2012), eqs. 2.89 to 2.96; general end mills: Engin & Altıntaş, Int.
J. Mach. Tools Manuf. 41 (2001) 2195.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.milling.engagement_angles import ContactArc, compute_contact_arc
from machopt.process.milling.milling_cut import (
    MillingCut,
    MillingCutter,
    check_cut_dimensions,
    check_cutter,
    check_feed_per_tooth,
)

TRAVEL, NORMAL, AXIAL, TORQUE = range(4)  # components of a load
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_T, _DT = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # on 0 … 1


@dataclass(frozen=True)
class MeanCuttingLoad:
    """Mean load on the tool at P points: travel, normal and axial force in N, torque about the axis in N·m.

    load = edge + slope · fz. The torque about the axis from tip to shank is positive for M3.
    """

    edge: Array  # (P, 4) part of the edge coefficients, N and N·m
    slope: Array  # (P, 4) change per m of feed per tooth, N/m and N
    edge_by_ae: Array  # (P, 4) derivative of ``edge`` by the radial depth of cut, N/m and N; 0 where nothing is cut
    slope_by_ae: Array  # (P, 4) derivative of ``slope`` by the radial depth of cut

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def compute_load(self, fz: Array | float) -> Array:
        """Return the load, (P, 4) N and N·m.

        Args:
            fz: (P,) or one value, m, feed per tooth.

        Raises:
            CuttingInputError: a feed per tooth that is not positive.
        """
        feed = np.asarray(fz, float)
        check_feed_per_tooth(np.atleast_1d(feed))
        return np.asarray(self.edge + self.slope * feed[..., None])

    def compute_load_by_ae(self, fz: Array | float) -> Array:
        """Return the derivative of the load by the radial depth of cut, (P, 4) N/m and N.

        Args:
            fz: (P,) or one value, m, feed per tooth.

        Raises:
            CuttingInputError: a feed per tooth that is not positive.
        """
        feed = np.asarray(fz, float)
        check_feed_per_tooth(np.atleast_1d(feed))
        return np.asarray(self.edge_by_ae + self.slope_by_ae * feed[..., None])


@dataclass(frozen=True)
class ArcMoments:
    """Integrals over φ of sin, cos, sin cos, sin², 1, or their derivatives by ae."""

    s: Array
    c: Array
    sc: Array
    ss: Array
    one: Array


def compute_mean_load(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    cut: MillingCut,
    ae: Array | float,
    ap: Array | float,
) -> MeanCuttingLoad:
    """Return the mean load of P points that share coefficients, cutter and direction of cut.

    Args:
        coefficients: milling coefficients; :func:`check_milling_coefficients` is the caller's.
        cutter: end mill.
        cut: direction of the cut.
        ae: (P,) or one value, m, radial depth of cut; 0 where nothing is cut.
        ap: (P,) or one value, m, axial depth of cut.

    Raises:
        CuttingInputError: an impossible cutter or depth of cut.
    """
    ae, ap = (np.atleast_1d(x) for x in np.broadcast_arrays(np.asarray(ae, float), np.asarray(ap, float)))
    check_cutter(cutter, coefficients)
    check_cut_dimensions(cutter, cut, ae, ap)
    ae = np.minimum(ae, cutter.diameter)
    arc = compute_contact_arc(cutter, cut, ae, cutter.radius)
    load = _sum_cylinder(coefficients, cutter, cut, arc, np.maximum(ap - cutter.corner_radius, 0.0))
    if cutter.corner_radius > 0.0:
        corner = _sum_corner(coefficients, cutter, cut, ae, ap)
        return MeanCuttingLoad(*(a + b for a, b in zip(load, corner, strict=True)))
    return MeanCuttingLoad(*load)


def compute_mean_load_of_arc(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, arc: ContactArc, ap: Array | float
) -> MeanCuttingLoad:
    """Return the mean load of a flat end mill whose angles of entry and exit are known, from a stock model, say.

    Args:
        coefficients: milling coefficients.
        cutter: end mill with a corner radius of 0.
        cut: its spindle direction counts; its side does not.
        arc: (P,) angles of contact.
        ap: (P,) or one value, m, axial depth of cut.

    Raises:
        CuttingInputError: an impossible cutter or axial depth of cut.
    """
    ap = np.broadcast_to(np.asarray(ap, float), np.shape(arc.start))
    check_cutter(cutter, coefficients)
    check_cut_dimensions(cutter, MillingCut("up", cut.spindle), np.zeros_like(ap), ap)
    return MeanCuttingLoad(*_sum_cylinder(coefficients, cutter, cut, arc, ap))


def get_axial_hand(cutter: MillingCutter, cut: MillingCut) -> float:
    """Return s: +1 where the helix pulls the tool towards the work, −1 where it pushes, 0 without helix.

    Args:
        cutter: end mill.
        cut: direction of the cut.
    """
    return float(np.sign(cutter.helix)) * cut.mirror


def _sum_cylinder(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, arc: ContactArc, height: Array
) -> tuple[Array, Array, Array, Array]:
    right = np.full_like(height, math.pi / 2)
    rows = (integrate_arc(arc), _differentiate_arc(arc))
    found = [compute_slice_load(coefficients, cutter, cut, m, right, cutter.radius) for m in rows]
    return tuple(height[:, None] * found[n][k] for n in (0, 1) for k in (0, 1))  # type: ignore[return-value]


def _sum_corner(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, ae: Array, ap: Array
) -> tuple[Array, Array, Array, Array]:
    """Sum over the rounded corner, in two panels of κ that meet where the arc of contact has its kink.

    The arc grows with the square root of the distance from the kink, so that κ is quadratic in the variable of the
    quadrature there.
    """
    rc, flat = cutter.corner_radius, cutter.radius - cutter.corner_radius
    last = np.arccos(np.clip(1.0 - ap / rc, 0.0, 1.0))
    kink_radius = 0.5 * ae if cut.boundary == "previous_pass" else np.abs(cutter.radius - ae)
    kink = np.minimum(np.arcsin(np.clip((kink_radius - flat) / rc, 0.0, 1.0)), last)
    total = [np.zeros((len(ae), 4)) for _ in range(4)]
    for far in (np.zeros_like(kink), last):
        kappa = kink[:, None] + (far - kink)[:, None] * _T**2
        weight = np.abs(far - kink)[:, None] * 2.0 * _T * _DT  # dκ
        radius = flat + rc * np.sin(kappa)
        arc = compute_contact_arc(cutter, cut, np.broadcast_to(ae[:, None], kappa.shape), radius)
        for n, moments in enumerate((integrate_arc(arc), _differentiate_arc(arc))):
            edge, slope = compute_slice_load(coefficients, cutter, cut, moments, kappa, radius)
            total[2 * n] += np.einsum("pk,pkc->pc", weight * rc, edge)  # db = rc dκ
            total[2 * n + 1] += np.einsum("pk,pkc->pc", weight * rc * np.sin(kappa), slope)  # dz = rc sin κ dκ
    return tuple(total)  # type: ignore[return-value]


def integrate_arc(arc: ContactArc) -> ArcMoments:
    """Return the integrals over arcs of contact.

    Args:
        arc: (...,) arcs.
    """
    a, b = arc.start, arc.end
    return ArcMoments(
        np.cos(a) - np.cos(b),
        np.sin(b) - np.sin(a),
        0.5 * (np.sin(b) ** 2 - np.sin(a) ** 2),
        0.5 * (b - a) - 0.25 * (np.sin(2 * b) - np.sin(2 * a)),
        b - a,
    )


def _differentiate_arc(arc: ContactArc) -> ArcMoments:
    a, b, da, db = arc.start, arc.end, arc.start_by_ae, arc.end_by_ae
    return ArcMoments(
        np.sin(b) * db - np.sin(a) * da,
        np.cos(b) * db - np.cos(a) * da,
        np.sin(b) * np.cos(b) * db - np.sin(a) * np.cos(a) * da,
        np.sin(b) ** 2 * db - np.sin(a) ** 2 * da,
        db - da,
    )


def compute_slice_load(
    coefficients: MillingCoefficients,
    cutter: MillingCutter,
    cut: MillingCut,
    moments: ArcMoments,
    kappa: Array,
    radius: Array | float,
) -> tuple[Array, Array]:
    """Return the edge load per m of edge, and the load per m of height and m of feed per tooth, (..., 4).

    Args:
        coefficients: milling coefficients.
        cutter: end mill.
        cut: direction of the cut; its spindle direction counts.
        moments: (...,) integrals over the arcs of contact.
        kappa: (...,) rad, angle between the tool's axis and the normal of the cutting surface.
        radius: (...,) m, radius of the slice.
    """
    K, hand = coefficients, get_axial_hand(cutter, cut)
    sine, cosine = np.sin(kappa), np.cos(kappa)
    per_tooth = cutter.teeth / (2.0 * math.pi)
    m = moments
    side = K.Kre_N_m * sine + hand * K.Kae_N_m * cosine
    along = K.Kre_N_m * cosine - hand * K.Kae_N_m * sine
    edge = [
        -K.Kte_N_m * m.c - side * m.s,
        cut.mirror * (K.Kte_N_m * m.s - side * m.c),
        along * m.one,
        cut.mirror * radius * K.Kte_N_m * m.one,
    ]
    side = K.Krc_Pa * sine + hand * K.Kac_Pa * cosine
    along = K.Krc_Pa * cosine - hand * K.Kac_Pa * sine
    slope = [
        -K.Ktc_Pa * m.sc - side * m.ss,
        cut.mirror * (K.Ktc_Pa * m.ss - side * m.sc),
        along * m.s,
        cut.mirror * radius * K.Ktc_Pa * m.s,
    ]
    return per_tooth * np.stack(edge, axis=-1), per_tooth * np.stack(slope, axis=-1)

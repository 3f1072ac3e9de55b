"""Load of a cutter whose contact with the stock is known, summed over its arcs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.milling.engagement_angles import ContactArc
from machopt.process.milling.mean_force import compute_slice_load, integrate_arc
from machopt.process.milling.milling_cut import MillingCut, MillingCutter, check_cutter
from machopt.process.stability.directional_matrix import compute_directional_matrix

LARGEST_SIGMA = 1.0  # of the logarithm of a force; more means that the contact is not resolved at all


@dataclass(frozen=True)
class SliceGeometry:
    """Slice of the cutter that each arc of contact belongs to."""

    radius: Array  # (M,) m
    kappa: Array  # (M,) rad, between the tool's axis and the normal of the cutting surface
    edge: Array  # (M,) m, length of the cutting edge


@dataclass(frozen=True, kw_only=True)
class ContactSummary:
    """Contact of N points in one row each; NaN where the cutter touches nothing."""

    ae: Array  # (N,) m, width of the contact across travel
    ap: Array  # (N,) m, height of the contact along the axis
    entry: Array  # (N,) rad, least angle
    exit: Array  # (N,) rad, largest angle
    side: NDArray[np.int8]  # (N,) 1 up, −1 down, 0 full width or no contact
    sigma: Array  # (N,) 1 sigma of the logarithm of the force from the place of the boundary

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


def compute_slice_geometry(cutter: MillingCutter, engagement: StockEngagement) -> SliceGeometry:
    """Return the slices of the arcs.

    Args:
        cutter: End mill.
        engagement: Contact; no slice reaches from the rounded corner into the cylinder.
    """
    low, high, rc = engagement.low, engagement.high, cutter.corner_radius
    if rc <= 0.0:
        return SliceGeometry(np.full_like(low, cutter.radius), np.full_like(low, 0.5 * np.pi), high - low)
    a, b = (np.arccos(np.clip(1.0 - h / rc, 0.0, 1.0)) for h in (low, high))
    is_corner = low < rc * (1.0 - 1e-9)
    kappa = np.where(is_corner, 0.5 * (a + b), 0.5 * np.pi)
    edge = np.where(is_corner, rc * (b - a), high - low)
    return SliceGeometry(cutter.radius - rc + rc * np.sin(kappa), kappa, edge)


def compute_contact_load(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, engagement: StockEngagement
) -> tuple[Array, Array]:
    """Return the mean load for a feed per tooth of zero, N and N·m, and its change per m of it, (N, 4) each.

    Args:
        coefficients: Milling coefficients.
        cutter: End mill.
        cut: Direction of the spindle; the side does not count.
        engagement: Contact of N points.

    Raises:
        CuttingInputError: an impossible cutter.
    """
    check_cutter(cutter, coefficients)
    shape = compute_slice_geometry(cutter, engagement)
    zero = np.zeros_like(engagement.start)
    moments = integrate_arc(ContactArc(engagement.start, engagement.end, zero, zero))
    per_edge, per_height = compute_slice_load(coefficients, cutter, cut, moments, shape.kappa, shape.radius)
    edge, slope = np.zeros((len(engagement.volume), 4)), np.zeros((len(engagement.volume), 4))
    np.add.at(edge, engagement.point, shape.edge[:, None] * per_edge)
    np.add.at(slope, engagement.point, (engagement.high - engagement.low)[:, None] * per_height)
    return edge, slope


def summarise_contact(cutter: MillingCutter, engagement: StockEngagement) -> ContactSummary:
    """Return the contact of each point in one row.

    The force of a straight pass grows with its width ae, so that a boundary with 1 sigma of s gives the force a
    relative 1 sigma of s / ae.

    Args:
        cutter: End mill.
        engagement: Contact of N points.
    """
    n, point = len(engagement.volume), engagement.point
    shape = compute_slice_geometry(cutter, engagement)
    left, right, low, entry = (np.full(n, np.inf) for _ in range(4))
    high, exit_angle = np.full(n, -np.inf), np.full(n, -np.inf)
    np.minimum.at(left, point, -shape.radius * np.cos(engagement.start))
    np.minimum.at(right, point, shape.radius * np.cos(engagement.end))
    np.minimum.at(low, point, engagement.low)
    np.maximum.at(high, point, engagement.high)
    np.minimum.at(entry, point, engagement.start)
    np.maximum.at(exit_angle, point, engagement.end)
    weight, moment = np.zeros(n), np.zeros(n)
    area = (engagement.high - engagement.low) * (engagement.end - engagement.start)
    np.add.at(weight, point, area)
    np.add.at(moment, point, area * 0.5 * (engagement.start + engagement.end))
    touches = weight > 0.0
    middle = np.where(touches, moment / np.where(touches, weight, 1.0), 0.5 * np.pi)
    ae = np.where(touches, -left - right, np.nan)
    is_full = ~(ae < cutter.diameter - 2.0 * engagement.edge_sigma)
    side = np.where(is_full, 0, np.where(middle < 0.5 * np.pi, 1, -1)).astype(np.int8)
    sigma = np.where(touches, np.minimum(engagement.edge_sigma / np.where(ae > 0, ae, np.inf), LARGEST_SIGMA), 0.0)
    return ContactSummary(
        ae=ae,
        ap=np.where(touches, high - low, np.nan),
        entry=np.where(touches, entry, np.nan),
        exit=np.where(touches, exit_angle, np.nan),
        side=side,
        sigma=np.where(is_full, 0.0, sigma),
    )


def compute_contact_matrix(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, engagement: StockEngagement, ap: Array
) -> Array:
    """Return (N, 3, 2) Pa, the directional matrix of stability: the mean over the height ap of that of each slice.

    Args:
        coefficients: Milling coefficients.
        cutter: End mill; flat.
        cut: Direction of the spindle; the side does not count.
        engagement: Contact of N points.
        ap: (N,) m, height of the contact; points with NaN have zeros.

    Raises:
        CuttingInputError: an impossible cutter.
    """
    zero = np.zeros_like(engagement.start)
    H = compute_directional_matrix(coefficients, cutter, cut, ContactArc(engagement.start, engagement.end, zero, zero))
    out = np.zeros((len(engagement.volume), 3, 2))
    share = (engagement.high - engagement.low) / ap[engagement.point]
    np.add.at(out, engagement.point, share[:, None, None] * H)
    return out

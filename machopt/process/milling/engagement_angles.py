"""Range of rotation angles in which a tooth cuts, its change with the radial depth of cut, and chip thickness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter


@dataclass(frozen=True)
class ContactArc:
    """Rotation angles of entry and exit, and their derivatives by the radial depth of cut."""

    start: Array  # (...,) rad, φ_st
    end: Array  # (...,) rad, φ_ex ≥ φ_st
    start_by_ae: Array  # (...,) rad/m
    end_by_ae: Array  # (...,) rad/m


def compute_contact_arc(cutter: MillingCutter, cut: MillingCut, ae: Array, radius: Array | float) -> ContactArc:
    """Return where a tooth of a slice of the cutter is in contact.

    The material fills the side of travel beyond the distance b from the tool's axis: b = r − ae after a pass of the
    same tool (``previous_pass``), b = R − ae for a plane wall. Then cos θ = b / r, clipped to −1 … 1.

    Args:
        cutter: end mill with radius R.
        cut: direction of the cut.
        ae: (...,) m, radial depth of cut at the radius R.
        radius: (...,) m, radius r of the slice, ≥ 0.
    """
    ae, radius = np.broadcast_arrays(np.asarray(ae, float), np.asarray(radius, float))
    some = np.where(radius > 0.0, radius, 1.0)
    edge = (radius if cut.boundary == "previous_pass" else cutter.radius) - ae
    cosine = np.where(radius > 0.0, np.clip(edge / some, -1.0, 1.0), 1.0)
    if cut.side == "slot":
        cosine = np.where((radius > 0.0) & (ae > 0.0), -1.0, 1.0)
    theta = np.arccos(cosine)
    sine = np.sin(theta)
    inside = (np.abs(cosine) < 1.0) & (sine > 0.0)
    change = np.where(inside, 1.0 / (some * np.where(inside, sine, 1.0)), 0.0)
    return build_contact_arc(cut.side, theta, change)


def build_contact_arc(side: CutSide, theta: Array, theta_by_ae: Array) -> ContactArc:
    """Return the arc of an immersion angle on the given side.

    Args:
        side: up: from 0; down: to π; slot: 0 … θ as for up.
        theta: (...,) rad, immersion angle.
        theta_by_ae: (...,) rad/m, its derivative by the radial depth of cut.
    """
    zero = np.zeros_like(theta)
    if side == "down":
        return ContactArc(np.pi - theta, np.full_like(theta, np.pi), -theta_by_ae, zero)
    return ContactArc(zero, theta, zero, theta_by_ae)


def compute_chip_thickness(fz: Array, arc: ContactArc) -> tuple[Array, Array]:
    """Return mean and largest chip thickness over an arc, h = fz sin φ; 0 where nothing is cut.

    Args:
        fz: (P,) m, feed per tooth.
        arc: (P,) arc of the cylindrical part.

    Returns:
        mean (P,) m and largest (P,) m.
    """
    length = arc.end - arc.start
    cutting = length > 0.0
    mean = np.where(cutting, fz * (np.cos(arc.start) - np.cos(arc.end)) / np.where(cutting, length, 1.0), 0.0)
    middle = (arc.start <= np.pi / 2) & (arc.end >= np.pi / 2)
    peak = np.where(middle, 1.0, np.maximum(np.sin(arc.start), np.sin(arc.end)))
    return mean, np.where(cutting, fz * peak, 0.0)

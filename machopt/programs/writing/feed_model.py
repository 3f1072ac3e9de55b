"""The feed that a program will hold by a stated model of its controller: not the planner's, and not the maker's.

Move k of length L_k is led along its line at no more than its programmed feed F_k, with the acceleration that the axes
allow there,

    a_k = min_i  q̈_i,max · L_k / |Δq_ik|,                                                                 (1)

Δq_k its change of joint i. At its end the controller passes the corner of turn θ at a speed v_k:

* an exact stop (FINE, fine, PL=0, no C_DIS):                                           v_k = 0;
* a zone that is left at d before the point and d behind it: an arc of radius d / tan(θ/2), driven with (1),

    v_k = min(F_k, F_k+1, √(a d / tan(θ/2)), c_k),   a = min(a_k, a_k+1);                                 (2)

* c_k is what the termination itself allows: FANUC's CNTn keeps n % of the speed, c_k = n/100 · F_k, elsewhere none.

What can be reached follows by one pass forward and one back, v_k² ≤ v_k−1² + 2 a_k L_k and the same from behind, and
the time of a move is that of a trapezoid: up to F_k or as far as L_k allows, and down again. The feed held is L over
time.

How makers give d: KRL $APO.CDIS, RAPID pzone_tcp, URScript r, VAL3 leave and reach are that distance; FANUC's CNTn
starts the next move when the speed has fallen to n %, from where it would still go d = (n/100 · F)² / (2 a); Yaskawa's
PL is a distance by parameter, taken as half the shorter line; SPL is a curve through the points, so d is half the line
too.

Source: own derivation of (1) and (2) from constant acceleration; the readings of d are general knowledge, not looked
up, but for FANUC's, where users' descriptions of CNT agree ("as near as it can at n % of the speed").
Invalid for: jerk, look-ahead shorter than a braking distance (KRL $ADVANCE 5, many points a second), dynamics and
payload. It is low rather than high on smooth paths and ignores settling times at exact stops.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import LIN, RobotProgram
from machopt.numerics.array_types import Array
from machopt.programs.writing.blend_zones import BlendZones

if TYPE_CHECKING:
    from machopt.data_types.documents.program_entries import FeedModelSection

HELD = 0.95  # of the programmed feed: what counts as held, as in the planner's own figure
STRAIGHT = 1e-6  # rad


@dataclass(frozen=True, kw_only=True)
class FeedModelResult:
    """Over the cutting moves of a program."""

    mean_share: float  # length over programmed feed, divided by the time taken
    full_feed_share: float  # of the cutting length, driven at 95 % of the feed on average over a move or faster
    lowest_share: float  # of the slowest move
    slowest: int  # its number, from 0
    cutting_time: float  # s
    deviation: float  # m, the farthest that a point is passed by at a rounded corner
    stops: int  # exact stops between cutting moves

    def to_document(self) -> FeedModelSection:
        """For result.json: percent, mm, s."""
        from machopt.data_types.documents.program_entries import (
            FeedModelSection,  # late: a plan does not wait for the result's models
        )

        return FeedModelSection(
            mean_percent=100.0 * self.mean_share,
            held_length_percent=100.0 * self.full_feed_share,
            lowest_percent=100.0 * self.lowest_share,
            lowest_at_move=self.slowest + 1,
            cutting_time_s=self.cutting_time,
            rounding_max_mm=1e3 * self.deviation,
            exact_stops=self.stops,
        )


def compute_line_acceleration(program: RobotProgram) -> Array | None:
    """Compute the acceleration along each line, equation (1).

    Args:
        program: Robot program: targets, poses and moves in SI units.

    Returns:
        Acceleration (M,) in m/s², None where the axis limits are unknown.
    """
    if program.axis_acceleration is None:
        return None
    way = np.linalg.norm(np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0), axis=1)
    turned = np.abs(np.diff(program.q, axis=0))
    share = np.max(turned / program.axis_acceleration, axis=1)
    out = np.full(len(program), np.nan)
    out[1:] = np.where(share > 0.0, way / np.where(share > 0.0, share, 1.0), np.inf)
    return out


def compute_program_feed(
    program: RobotProgram, zone: BlendZones, distance: Array, cap: Array, rounded: NDArray[np.bool_]
) -> FeedModelResult | None:
    """The model's figures, or None where the axes' accelerations or a cut are missing.

    Args:
        program: with feeds.
        zone: turns and tolerances of its corners.
        distance: (M,) m, d of this controller, 0 for an exact stop.
        cap: (M,) m/s, c_k; inf for none.
        rounded: (M,) True where the path leaves the point, False where a curve leads through it.
    """
    a = compute_line_acceleration(program)
    cut = np.flatnonzero(program.cutting & (program.kind == LIN))
    if a is None or not len(cut) or cut[0] == 0:
        return None
    length = np.zeros(len(program))
    length[1:] = np.linalg.norm(np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0), axis=1)
    corner = np.zeros(len(program))
    rows = np.flatnonzero((distance > 0.0) & np.isfinite(zone.turn))
    half = np.tan(np.maximum(zone.turn[rows], STRAIGHT) / 2.0)
    both = np.minimum(a[rows], a[rows + 1])
    corner[rows] = np.minimum.reduce(
        [program.feed[rows], program.feed[rows + 1], np.sqrt(both * distance[rows] / half), cap[rows]]
    )
    gain = np.zeros(len(program))  # m²/s², of v² along a line; a point that is there twice is no way to speed up on
    gain[1:] = 2.0 * np.where(length[1:] > 0.0, a[1:], 0.0) * length[1:]
    for k in cut:  # what can be reached from behind …
        corner[k] = min(corner[k], float(np.sqrt(corner[k - 1] ** 2 + gain[k])))
    for k in cut[::-1]:  # … and braked from
        corner[k - 1] = min(corner[k - 1], float(np.sqrt(corner[k] ** 2 + gain[k])))
    rows = cut[length[cut] > 0.0]
    if not len(rows):
        return None
    v0, v1, F, L, acc = corner[rows - 1], corner[rows], program.feed[rows], length[rows], a[rows]
    top = np.minimum(F, np.sqrt((v0**2 + v1**2) / 2.0 + acc * L))
    ramps = (2.0 * top**2 - v0**2 - v1**2) / (2.0 * acc)
    time = (2.0 * top - v0 - v1) / acc + np.maximum(L - ramps, 0.0) / top
    share = np.minimum(L / time / F, 1.0)
    worst = int(np.argmin(share))
    inside = np.isfinite(zone.turn)
    return FeedModelResult(
        mean_share=float((L / F).sum() / time.sum()),
        full_feed_share=float(L[share >= HELD].sum() / L.sum()),
        lowest_share=float(share[worst]),
        slowest=int(rows[worst]),
        cutting_time=float(time.sum()),
        deviation=float((np.where(rounded, distance, 0.0)[inside] * np.tan(zone.turn[inside] / 4.0)).max(initial=0.0)),
        stops=int((program.cutting[:-1] & program.cutting[1:] & ~(distance[:-1] > 0.0)).sum()),
    )

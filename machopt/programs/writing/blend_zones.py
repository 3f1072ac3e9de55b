"""How far ahead of a point a controller may leave its line, so that it stays within the user's tolerance of the point.

A controller that rounds a corner leaves the line at a distance d before the point and joins the next line at d behind
it. With the turn θ between the two lines, an arc that touches both there passes the point at

    e = d · tan(θ/4),                                                                                     (1)

and every smoother curve within the same triangle (parabola, quintic) passes nearer. So for a tolerance ε

    d = min(ε / tan(θ/4), 0.49 · L_before, 0.49 · L_behind),                                              (2)

the halves because no controller begins to round before the middle of a line, and blends must not overlap. d is then cut
down to a preferred number, so that a program needs few different zones. A d below 0.02 mm is a stop, and so is a turn
of more than 120°.

The end of a joint move is rounded where the plan has checked the corner to the next joint move; its largest distance is
given (:mod:`machopt.programs.writing.rapid_zones`) and cut down in the same way.

Source: geometry of tangent arcs, derived here; that makers' zones end at half a line is general knowledge.
Invalid for: orientation, which the zones lead over the same stretch of path; curves that the controller draws (SPL).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.robot_program import LIN, RobotProgram
from machopt.numerics.array_types import Array

LADDER_MM = np.array([a * 10.0**b for b in (-2, -1, 0, 1) for a in (1.0, 1.6, 2.5, 4.0, 6.3)])[1:]  # 0.016 … 63 mm
LEAST = 2e-5  # m; a shorter zone is a stop in all but name
SHORTEST = 1e-3 * float(LADDER_MM[1e-3 * LADDER_MM >= LEAST][0])  # m, the least zone that is one
HALF = 0.49  # of a line
STRAIGHT = 1e-9  # rad
SHARP = np.radians(120.0)  # a turn beyond, such as the bottom of a hole, is a stop: rounding it would buy no speed


@dataclass(frozen=True)
class BlendZones:
    """Of each move's end."""

    distance: Array  # (M,) m before and behind the point, 0 for an exact stop; a preferred number
    free: NDArray[np.bool_]  # (M,) even a zone of half the line keeps to the tolerance
    turn: Array  # (M,) rad between this line and the next, NaN where the robot has to stop
    room: Array  # (M,) m, half of the shorter of the two lines
    rapid: Array | None = None  # (M,) m, largest distance at the end of a joint move; None: all of them are stops

    @property
    def deviation(self) -> Array:
        """(M,) m by which an arc of that distance passes the point, equation (1)."""
        return np.where(self.distance > 0.0, self.distance * np.tan(np.nan_to_num(self.turn) / 4.0), 0.0)


def compute_blend_zones(program: RobotProgram, moves_per_part: int | None = None) -> BlendZones:
    """Zones of a program.

    A joint move that runs on into another one is rounded as the plan has checked it. A cutting LIN that runs on into
    another of the same operation without an event between is rounded. Every other end is an exact stop, also where a
    part of the program ends.

    Args:
        program: ``blend`` is the tolerance ε.
        moves_per_part: of the post.
    """
    n = len(program)
    out, free = np.zeros(n), np.zeros(n, bool)
    turn, room = np.full(n, np.nan), np.zeros(n)
    if n < 2:
        return BlendZones(out, free, turn, room)
    way = np.diff(program.T_workpiece_tcp[:, :3, 3], axis=0, prepend=np.full((1, 3), np.nan))  # (M, 3) to each end
    length = np.linalg.norm(way, axis=1)
    cut = program.cutting & (program.kind == LIN) & (length > LEAST)
    on = cut[:-1] & cut[1:] & (program.operation[:-1] == program.operation[1:])
    on[[e.index - 1 for e in program.events if 0 < e.index < n]] = False
    if moves_per_part is not None:
        on[moves_per_part - 1 :: moves_per_part] = False
    unit = way / np.where(length > 0.0, length, 1.0)[:, None]
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    sine = np.linalg.norm(np.cross(unit[:-1], unit[1:]), axis=1)
    turn[:-1] = np.where(on, np.arctan2(sine, cosine), np.nan)
    room[:-1] = np.where(on, HALF * np.minimum(length[:-1], length[1:]), 0.0)
    on &= ~(turn[:-1] > SHARP)
    turn[:-1] = np.where(on, turn[:-1], np.nan)
    room[:-1] = np.where(on, room[:-1], 0.0)
    if program.blend > 0.0:
        reach = program.blend / np.tan(np.maximum(np.nan_to_num(turn[:-1]), STRAIGHT) / 4.0)
        free[:-1] = on & (reach >= room[:-1])
        out[:-1] = np.where(on, _round_to_preferred_number(np.minimum(reach, room[:-1])), 0.0)
    rapid = _list_rapid_zones(program, moves_per_part)
    return BlendZones(np.where(rapid > 0.0, _round_to_preferred_number(rapid), out), free, turn, room, rapid)


def _list_rapid_zones(program: RobotProgram, moves_per_part: int | None) -> Array:
    """(M,) m, the largest zone of each joint move's end; 0 beside a line, an event or the end of a part."""
    out = np.zeros(len(program))
    if program.rapid_zone is None:
        return out
    joint = program.kind != LIN
    out[:-1] = np.where(joint[:-1] & joint[1:], program.rapid_zone[:-1], 0.0)
    out[[e.index - 1 for e in program.events if 0 < e.index < len(program)]] = 0.0
    if moves_per_part is not None:
        out[moves_per_part - 1 :: moves_per_part] = 0.0
    return np.where(out >= SHORTEST, out, 0.0)


def _round_to_preferred_number(distance: Array) -> Array:
    """The next preferred number below, 0 below the least."""
    ladder = np.append(0.0, LADDER_MM * 1e-3)
    ladder = ladder[(ladder == 0.0) | (ladder >= LEAST)]
    return np.asarray(ladder[np.searchsorted(ladder, distance * (1.0 + 1e-9), side="right") - 1])

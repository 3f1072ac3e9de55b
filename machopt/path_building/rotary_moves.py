"""Interpolation of moves under tool-centre-point control along the path of the rotary axes.

A control moves its rotary axes in proportion to the tip travel, from the angles before a block to the programmed ones,
also by more than half a turn. Robots rotate the tool axis at a constant rate in the plane of the start and end axes.
A block is therefore divided so finely that both agree, for G-code, Sinumerik (TRAORI) and Heidenhain (M128).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError, interpolate_axes
from machopt.path_building.point_collector import Vector
from machopt.path_building.rotary_axes import RotaryMachine

AXIS_TOLERANCE_DEG = 0.01  # between tool axis on the rotary path and on the great circle between two points
SMALL_TURN_DEG = 2.0  # at most 0.009° off: (sum of the swings)² / 8, the sagitta of an arc on the unit sphere
_MOST_STEPS = 20_000  # of one block: 100 turns
_STEP_DEG = 60.0  # longest first step, so that no step takes the other way round
_PROBES = (0.25, 0.5, 0.75)  # of each step, where the two paths are compared


@dataclass(frozen=True)
class RotaryTurn:
    """Rotary axes that move in proportion from one set of angles (deg) to another."""

    machine: RotaryMachine
    before: Mapping[str, float]
    after: Mapping[str, float]

    @property
    def swing_deg(self) -> float:
        """Sum of the angles that the axes turn by."""
        return sum(abs(self.after.get(c, 0.0) - self.before.get(c, 0.0)) for c in self.machine.letters)

    def axis(self, share: float) -> Vector:
        """Compute the unit vector from tip to shank at a share of the move.

        Args:
            share: Share of the move, 0 to 1.

        Returns:
            Unit vector.
        """
        return self.machine.tool_axis(
            {
                c: self.before.get(c, 0.0) + share * (self.after.get(c, 0.0) - self.before.get(c, 0.0))
                for c in self.machine.letters
            }
        )

    def axes(self, shares: Array) -> Array:
        """Compute the unit vectors from tip to shank at shares of the move.

        Args:
            shares: Shares of the move (N,), 0 to 1.

        Returns:
            Unit vectors (N, 3).
        """
        return np.array([self.axis(s) for s in shares.tolist()]).reshape(-1, 3)

    def steps(self) -> int:
        """Fewest equal steps (of those tried) within AXIS_TOLERANCE_DEG of the rotary path.

        Raises:
            ArcError: more than _MOST_STEPS.
        """
        swing = self.swing_deg
        if swing <= SMALL_TURN_DEG:
            return 1
        count = max(math.ceil(swing / _STEP_DEG), 1)
        while True:
            if count > _MOST_STEPS:
                raise ArcError(f"{count} steps for one block that turns rotary axes by {swing:g}°: too many")
            off = self._compute_deviation(count)
            if off <= math.radians(AXIS_TOLERANCE_DEG):
                return count
            wanted = math.sqrt(off / math.radians(AXIS_TOLERANCE_DEG))  # it falls with the square of the step
            count = max(math.ceil(count * min(wanted, 8.0)), count + 1)

    def _compute_deviation(self, count: int) -> float:
        """Largest angle (rad) between the rotary path and great circles between ``count`` steps."""
        ends = self.axes(np.arange(count + 1) / count)
        worst = 0.0
        for probe in _PROBES:
            on_path = self.axes((np.arange(count) + probe) / count)
            chord = interpolate_axes(ends[:-1], ends[1:], np.full(count, probe))
            worst = max(worst, float(np.linalg.norm(on_path - chord, axis=1).max()))
        return worst


def compute_start_angle(before: float, after: float, mode: str) -> float:
    """Compute the start angle of a rotary axis, whole turns from its position, by its direction of travel.

    ``DC``: the shortest way; ``ACP``, ``ACN``: in the positive or negative direction; else as programmed.

    Args:
        before: Angle before the move, degrees.
        after: Programmed angle, degrees.
        mode: ``DC``, ``ACP``, ``ACN`` or another text.

    Returns:
        Start angle, degrees.
    """
    if mode == "DC":
        return after - math.remainder(after - before, 360.0)
    if mode == "ACP":
        return after - (after - before) % 360.0
    if mode == "ACN":
        return after + (before - after) % 360.0
    return before

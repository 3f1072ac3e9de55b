"""How an arm is really built: each joint's frame where it sits in the link before it, the base, the tool.

A frame of the drawing is turned about its own origin by a small rotation vector and shifted, in axes of base_link with
all joints at zero; everything behind it goes along. Seen so, an arm is the same six lines elsewhere: with G_k the way
of frame k, Π_k G_k exp(ξ_k θ_k) G_t M = Π_k exp(Ad(G_0 … G_k) ξ_k θ_k) G_0 … G_t M.

Source: Hayati & Mirmirani 1985 (why angle, length, offset and twist of a joint are not enough where axes are parallel);
Okamura & Park 1996 (kinematic calibration with the product of exponentials).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.effects.protocol import JOINTS, Effect
from machopt.numerics.array_types import Array

MOST_MM, MOST_MRAD = 50.0, 50.0  # to either side: beyond it another robot is meant, or another unit
SHIFT, TURN = "xyz_mm", "turn_mrad"
BASE, TOOL = "base", "tool"

EFFECT = Effect(
    name="geometry",
    noun="geometry",
    sentence="A joint's axis sits in its link elsewhere, or otherwise turned, than the drawing says.",
    port="frame",
    places=(BASE, *JOINTS, TOOL),
    form_uncertainty=0.0,  # rigid: nothing of it is left to the form of a law
    plausible_sizes={"mm": 20.0},
    note="without load, the same at every angle of the joint",
)


@dataclass(frozen=True)
class FrameOffset:
    """One frame's way from the drawing."""

    shift: Array  # (3,) m, base_link axes with all joints at zero
    turn: Array  # (3,) rad, rotation vector about the frame's own origin, the same axes


def read_frame_offset(parameters: Mapping[str, Any]) -> FrameOffset:
    """What an entry of kinematics.yaml means; a part that is not stated is zero."""
    zero = (0.0, 0.0, 0.0)
    return FrameOffset(
        1e-3 * np.array(parameters.get(SHIFT, zero), float), 1e-3 * np.array(parameters.get(TURN, zero), float)
    )


def write_frame_offset(p: FrameOffset) -> dict[str, Any]:
    """The entry's parameters."""
    return {SHIFT: [float(v) for v in 1e3 * p.shift], TURN: [float(v) for v in 1e3 * p.turn]}


def add_frame_offsets(one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, Any]:
    """Two ways at one place as one; they add up as long as both are small (1 mm and 1 mrad leave 1 µm)."""
    a, b = read_frame_offset(one), read_frame_offset(two)
    return write_frame_offset(FrameOffset(a.shift + b.shift, a.turn + b.turn))

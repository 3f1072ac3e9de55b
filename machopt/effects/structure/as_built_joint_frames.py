"""As-built geometry: deviations of each joint frame in the preceding link, of the base and of the tool.

A frame is rotated about its own origin by a small rotation vector and translated, in base_link axes with all joints
at zero. All following frames move along. The corrected arm has the same form as a nominal one. With G_k the deviation
of frame k: Π_k G_k exp(ξ_k θ_k) G_t M = Π_k exp(Ad(G_0 … G_k) ξ_k θ_k) G_0 … G_t M. Source: Hayati & Mirmirani 1985
(Denavit–Hartenberg parameters are not sufficient for parallel axes); Okamura & Park 1996 (kinematic calibration with
the product of exponentials).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.effects.protocol import JOINTS, Effect
from machopt.numerics.array_types import Array

MOST_MM, MOST_MRAD = 50.0, 50.0  # largest absolute value; a larger one indicates another robot or a wrong unit
SHIFT, TURN = "xyz_mm", "turn_mrad"
BASE, TOOL = "base", "tool"

EFFECT = Effect(
    name="geometry",
    noun="geometry",
    sentence="A joint's axis sits in its link elsewhere, or otherwise turned, than the drawing says.",
    port="frame",
    places=(BASE, *JOINTS, TOOL),
    form_uncertainty=0.0,  # rigid transform: no uncertainty from the form of a law
    plausible_sizes={"mm": 20.0},
    note="without load, the same at every angle of the joint",
)


@dataclass(frozen=True)
class FrameOffset:
    """Deviation of one frame from its nominal position and orientation."""

    shift: Array  # (3,) m, base_link axes with all joints at zero
    turn: Array  # (3,) rad, rotation vector about the frame's own origin, the same axes


def read_frame_offset(parameters: Mapping[str, Any]) -> FrameOffset:
    """Read the frame deviation of an entry of kinematics.yaml.

    Args:
        parameters: Parameters of the entry; an unstated part is zero.

    Returns:
        The deviation in m and rad.
    """
    zero = (0.0, 0.0, 0.0)
    return FrameOffset(
        1e-3 * np.array(parameters.get(SHIFT, zero), float), 1e-3 * np.array(parameters.get(TURN, zero), float)
    )


def write_frame_offset(p: FrameOffset) -> dict[str, Any]:
    """Return the parameters of the entry for a frame deviation.

    Args:
        p: The deviation.

    Returns:
        ``xyz_mm`` and ``turn_mrad``.
    """
    return {SHIFT: [float(v) for v in 1e3 * p.shift], TURN: [float(v) for v in 1e3 * p.turn]}


def add_frame_offsets(one: Mapping[str, Any], two: Mapping[str, Any]) -> dict[str, Any]:
    """Add two deviations at one place. The sum is valid for small ones (1 mm and 1 mrad leave an error of 1 µm).

    Args:
        one: Parameters of the first entry.
        two: Parameters of the second entry.

    Returns:
        Parameters of the combined entry.
    """
    a, b = read_frame_offset(one), read_frame_offset(two)
    return write_frame_offset(FrameOffset(a.shift + b.shift, a.turn + b.turn))

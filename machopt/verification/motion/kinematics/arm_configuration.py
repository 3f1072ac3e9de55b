"""The arm at given configurations: the lines of its axes, its frames and its Jacobian."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class ArmConfiguration:
    """Arm at N configurations: lines of its six axes, frames and what they carry, in base_link."""

    q: Array  # (N, 6) rad, true angles
    external: Array  # (N, E) rad or m
    axis: Array  # (N, 6, 3) unit
    origin: Array  # (N, 6, 3) m, of each joint's frame
    tcp: Array  # (N, 4, 4)
    frames: Array  # (N, 7, 4, 4) base_link and the frame of each joint; what a link carries moves with it
    flange: Array  # (N, 4, 4)
    linked_joints: Array  # (N, 6, 6) what joints that follow another add to that one's column of the Jacobian

    @cached_property
    def J(self) -> Array:
        """(N, 6, 6) geometric Jacobian at the TCP: column i is (z_i × (p − o_i), z_i), plus m times that of each
        joint that mimics it as m q_i + o.
        """
        return build_twist_columns(self.axis, self.origin, self.tcp) + self.linked_joints

    def moved_to_flange(self) -> Array:
        """(N, 6, 6) :attr:`linked` at the flange's origin."""
        out = self.linked_joints.copy()
        lever = (self.flange[:, :3, 3] - self.tcp[:, :3, 3])[:, None]
        out[:, :3] += np.swapaxes(np.cross(np.swapaxes(self.linked_joints[:, 3:], 1, 2), lever), 1, 2)
        return out

    def select_rows(self, keep: NDArray[Any]) -> ArmConfiguration:
        """Return some of the configurations.

        Args:
            keep: Row numbers, or a mask (N,).
        """
        return ArmConfiguration(**{f.name: getattr(self, f.name)[keep] for f in fields(ArmConfiguration)})


def build_twist_columns(axis: Array, origin: Array, tcp: Array) -> Array:
    """Return the (N, 6, K) geometric Jacobian of rotations about K lines.

    Args:
        axis: (N, K, 3) unit directions of the lines.
        origin: (N, K, 3) a point on each line, m.
        tcp: (N, 4, 4) poses of the TCP.
    """
    lever = tcp[:, None, :3, 3] - origin
    return np.swapaxes(np.concatenate([np.cross(axis, lever), axis], axis=-1), 1, 2)

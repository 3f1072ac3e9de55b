"""The tool axis between two points of the toolpath, as docs/conventions.md defines it."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

PARALLEL_TOLERANCE = 1e-12  # sine of the angle below which the axes are one


def interpolate_axis(start: Array, end: Array, share: Array) -> Array:
    """Turn the axis evenly from ``start`` to ``end``, in the plane of both.

    Rodrigues' formula: ``start`` is rotated about ``start`` × ``end`` by a share of the angle between them.

    Args:
        start: (n, 3) unit.
        end: (n, 3) unit; not opposite to ``start``.
        share: (n,) of the angle, 0 to 1.

    Returns:
        (n, 3) unit.
    """
    normal = np.cross(start, end)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.asarray(share, float) * np.arctan2(sine, np.einsum("ij,ij->i", start, end))
    across = np.cross(normal / np.where(sine > PARALLEL_TOLERANCE, sine, 1.0)[:, None], start)
    out = np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * across
    return np.asarray(np.where((sine > PARALLEL_TOLERANCE)[:, None], out, start))

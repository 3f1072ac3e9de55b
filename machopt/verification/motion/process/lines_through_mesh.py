"""Heights at which lines along a tool axis meet the mesh of the stock."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def build_axis_frame(axis: Array) -> Array:
    """Return (3, 3) unit vectors as rows, a right-handed frame whose third axis is given.

    Args:
        axis: (3,) unit.
    """
    x = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis])


def find_mesh_heights(places: Array, triangles: Array) -> tuple[Array, Array]:
    """Return the lowest and highest height at which lines along the third axis meet a mesh, (n,) m each; none: 0, −inf.

    Args:
        places: (n, 2) m, where the lines lie.
        triangles: (F, 3, 3) m, corners of the mesh in the same frame.
    """
    bottom, top = np.zeros(len(places)), np.full(len(places), -np.inf)
    flat = triangles[:, :, :2]
    low, high = flat.min(axis=1), flat.max(axis=1)
    inside = (low <= places.max(axis=0)).all(axis=1) & (high >= places.min(axis=0)).all(axis=1)
    for t in triangles[inside]:
        a, b, c = t
        e, f = b[:2] - a[:2], c[:2] - a[:2]
        area = e[0] * f[1] - e[1] * f[0]
        if abs(area) < 1e-18:
            continue
        g = places - a[:2]
        s = (g[:, 0] * f[1] - g[:, 1] * f[0]) / area
        u = (e[0] * g[:, 1] - e[1] * g[:, 0]) / area
        hit = (s >= -1e-12) & (u >= -1e-12) & (s + u <= 1 + 1e-12)
        z = a[2] + s * (b[2] - a[2]) + u * (c[2] - a[2])
        bottom = np.where(hit & (np.isneginf(top) | (z < bottom)), z, bottom)
        top = np.where(hit, np.maximum(top, z), top)
    return bottom, top

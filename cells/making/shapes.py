"""Closed meshes of simple shapes. Lengths in m, angles in deg."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

Array = np.ndarray
Section = tuple[float, float, float, float, float]  # position, centre u, centre v, half-size u, half-size v


def loft(axis: str, sections: Sequence[Section], power: float = 2.0, n: int = 24) -> trimesh.Trimesh:
    """A closed body through superellipse sections (2: ellipse, 4 and more: box with rounded edges).

    ``u, v`` are the two axes that follow ``axis`` in the cycle x → y → z → x.
    """
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    c, s = np.cos(angle), np.sin(angle)
    u, v = np.sign(c) * np.abs(c) ** (2 / power), np.sign(s) * np.abs(s) ** (2 / power)
    rings, caps = [], []
    for position, cu, cv, hu, hv in sections:
        rings.append(np.column_stack([np.full(n, position), cu + hu * u, cv + hv * v]))
    for position, cu, cv, _, _ in (sections[0], sections[-1]):
        caps.append([position, cu, cv])
    vertices = np.vstack([*rings, caps])
    vertices = np.roll(vertices, {"x": 0, "y": 1, "z": 2}[axis], axis=1)
    faces = []
    k = len(sections)
    for r in range(k - 1):
        for i in range(n):
            j = (i + 1) % n
            a, b, c0, d = r * n + i, r * n + j, (r + 1) * n + i, (r + 1) * n + j
            faces += [[a, b, d], [a, d, c0]]
    for i in range(n):
        j = (i + 1) % n
        faces += [[k * n, j, i], [k * n + 1, (k - 1) * n + i, (k - 1) * n + j]]
    return trimesh.Trimesh(vertices, faces, process=False)


def cylinder(
    axis: str, low: float, high: float, radius: float, centre: tuple[float, float] = (0, 0), n: int = 24
) -> trimesh.Trimesh:
    return loft(axis, [(low, *centre, radius, radius), (high, *centre, radius, radius)], n=n)


def box(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(bounds=[low, high])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def moved(
    mesh: trimesh.Trimesh, xyz: Sequence[float] = (0, 0, 0), rpy_deg: Sequence[float] = (0, 0, 0)
) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices @ rpy(rpy_deg).T + np.asarray(xyz), mesh.faces, process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


def rpy(rpy_deg: Sequence[float]) -> Array:
    r, p, y = np.radians(rpy_deg)
    rx = np.array([[1, 0, 0], [0, np.cos(r), -np.sin(r)], [0, np.sin(r), np.cos(r)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    return rz @ ry @ rx

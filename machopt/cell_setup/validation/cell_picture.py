"""Picture of a cell at its home position from three sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machopt.collision.bodies import CollisionBody, build_cell_bodies, build_cutter_body, build_robot_bodies
from machopt.data_types.cell import Cell
from machopt.kinematics.machine import load_machine
from machopt.kinematics.machine_lines import LinkCarriers
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.report.svg.chart_elements import (
    build_bottom_ticks,
    build_frame,
    build_left_ticks,
    build_path,
    build_text,
    render_document,
)
from machopt.report.svg.shapes import SvgShape

if TYPE_CHECKING:
    from markupsafe import Markup

_SIDE = 300.0  # of a picture
_VIEWS = (("from the side", 0, 2, 1, -1.0), ("from the front", 1, 2, 0, 1.0), ("from above", 0, 1, 2, 1.0))
"""Words, the axes to the right and up, the axis of sight and its direction towards who looks."""
_FILL = {"link": "#f2a33a", "tool": "#5b7db1", "cutter": "#1b2430", "workpiece": "#2c8a57", "obstacle": "#9aa4b0"}


def render_cell_picture(cell: Cell) -> Markup:
    """Render arm, tool, workpiece and obstacles at home from three sides, with the axes of TCP and workpiece.

    Args:
        cell: The cell.

    Returns:
        SVG in world coordinates, mm.

    Raises:
        InputError: the bodies of the arm cannot be read.
    """
    robot, shapes = load_chain(cell)
    machine = load_machine(cell, robot)
    carriers = LinkCarriers(cell, machine)
    bodies = [*build_robot_bodies(carriers, shapes), *build_cell_bodies(cell, carriers)]
    bodies += [] if cell.tool.cutter is None else [build_cutter_body(cell, machine, cell.tool.cutter)]
    x = np.append(cell.home, cell.external_home)[None, :]
    R, p = machine.compute_links(x)
    T_world_part = machine.compute_T_world_workpiece(x[:, 6:])[0]
    T = T_world_part @ invert_transform(machine.T_base_workpiece_zero)
    seen = [(b, 1e3 * ((b.vertices @ R[0, b.link].T + p[0, b.link]) @ T[:3, :3].T + T[:3, 3])) for b in bodies]
    tcp = T_world_part @ machine.compute_fk(x, cell.tool.T_flange_tcp)[0]
    frames = (("TCP", tcp), ("workpiece", T_world_part))
    every = np.concatenate([v for _, v in seen] + [1e3 * f[None, :3, 3] for _, f in frames])
    middle, half = (every.min(axis=0) + every.max(axis=0)) / 2, 0.55 * float(np.ptp(every, axis=0).max())
    parts: list[SvgShape] = []
    for n, view in enumerate(_VIEWS):
        parts += _draw_view((66.0 + n * (_SIDE + 80), 44.0), view, seen, frames, middle, half)
    key = [(kind, f) for kind, f in _FILL.items() if any(b.kind == kind for b in bodies)]
    for n, (kind, fill) in enumerate(key):
        at = 66.0 + 100 * n
        parts += [
            build_path(f"M{at:.0f} {_SIDE + 96:.0f}h14v12h-14z", fill=fill),
            build_text(at + 20, _SIDE + 106, kind),
        ]
    parts.append(build_text(66.0 + 100 * len(key), _SIDE + 106, "z of TCP and workpiece: blue, x: red"))
    return render_document(3 * (_SIDE + 80) + 20, _SIDE + 120, f"{cell.name}, at home, in world", parts)


def _draw_view(
    corner: tuple[float, float],
    view: tuple[str, int, int, int, float],
    seen: list[tuple[CollisionBody, Array]],
    frames: tuple[tuple[str, Array], ...],
    middle: Array,
    half: float,
) -> list[SvgShape]:
    words, right, up, deep, sign = view
    x0, y0 = corner
    box = (x0, y0, _SIDE, _SIDE)
    scale = _SIDE / (2 * half)

    def at(points: Array) -> Array:
        """(n, 2) places on the page."""
        return np.stack(
            [
                x0 + _SIDE / 2 + (points[:, right] - middle[right]) * scale,
                y0 + _SIDE / 2 - (points[:, up] - middle[up]) * scale,
            ],
            axis=1,
        )

    out: list[SvgShape] = [build_frame(box), build_text(x0, y0 - 8, words)]
    for body, points in sorted(seen, key=lambda s: sign * float(s[1][:, deep].mean())):
        d = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in compute_convex_hull(at(points)).tolist()) + "z"
        out.append(build_path(d, fill=_FILL[body.kind], fill_opacity="0.75", stroke="#333d49", stroke_width="0.6"))
    for name, T in frames:
        origin = 1e3 * T[None, :3, 3]
        for axis, colour in ((0, "#c81e1e"), (2, "#1552b8")):
            a, b = at(np.concatenate([origin, origin + 0.16 * half * T[None, :3, axis]]))
            out.append(build_path(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}", stroke=colour, stroke_width="2"))
        a = at(origin)[0]
        out.append(build_text(float(a[0]) + 4, float(a[1]) - 4, name, kind="t"))
    ends = [(float(middle[k] - half), float(middle[k] + half)) for k in (right, up)]
    out += build_bottom_ticks(box, *ends[0], f"{'xyz'[right]} (mm)")
    return [*out, *build_left_ticks(box, *ends[1], f"{'xyz'[up]} (mm)")]


def compute_convex_hull(points: Array) -> Array:
    """Compute the convex hull of points in the plane (Andrew's monotone chain).

    Args:
        points: Points (n, 2).

    Returns:
        Corners (k, 2), counter-clockwise.
    """
    some = np.unique(np.round(points, 1), axis=0).tolist()

    def half(rows: list[list[float]]) -> list[list[float]]:
        out: list[list[float]] = []
        for c in rows:
            while len(out) > 1:
                a, b = out[-2:]
                if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0:
                    break
                out.pop()
            out.append(c)
        return out[:-1]

    return np.array(half(some) + half(some[::-1]) if len(some) > 2 else some)

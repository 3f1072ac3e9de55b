"""Spindles between flange and cutter, as meshes in the flange frame. Lengths in m."""

from __future__ import annotations

import trimesh

from making.shapes import cylinder, joined, loft


def square_spindle(
    reach: float, tip: float, cutter: float, *, radius: float, body: tuple[float, float]
) -> trimesh.Trimesh:
    """A spindle square to the flange: axis parallel to flange −x, ``reach`` in front of the flange face.

    The holder ends 1 mm above the cutter. Flange frame.
    """
    r = radius
    back, front = -body[1], -body[0]  # along the tool axis (= −x), front towards the tip
    nose = tip - cutter - 0.001
    holder = [(front, 0.6 * r), (0.5 * (front + nose), 0.42 * r), (nose, 0.20 * r)]  # position, radius
    along = joined(
        cylinder("x", back, front, r, (0, reach)),
        loft("x", [(p, 0, reach, rr, rr) for p, rr in holder]),
        cylinder("x", back - 0.06, back, 0.55 * r, (0, reach)),
        loft("z", [(0.0, 0, 0, 1.15 * r, 1.15 * r), (0.03, 0, 0, 1.15 * r, 1.15 * r)]),
        loft("z", [(0.03, 0, 0, 0.9 * r, 0.9 * r), (reach - 0.8 * r, 0, 0, 1.2 * r, 0.95 * r)], 5),
    )
    return trimesh.Trimesh(along.vertices * [-1, 1, 1], along.faces[:, ::-1], process=False)


def inline_spindle(offset: float, tip: float, cutter: float, *, radius: float) -> trimesh.Trimesh:
    """A drilling unit whose axis is parallel to axis 6, ``offset`` along flange +x. Flange frame, tip on +z."""
    r, nose = radius, tip - cutter - 0.001
    return joined(
        loft("z", [(0.0, 0, 0, 0.10, 0.10), (0.025, 0, 0, 0.10, 0.10)]),
        loft(
            "z",
            [(0.025, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r), (0.065, 0.5 * offset, 0, 0.5 * offset + r, 1.1 * r)],
            5,
        ),
        cylinder("z", 0.065, nose - 0.11, r, (offset, 0)),
        loft(
            "z",
            [
                (nose - 0.11, offset, 0, 0.62 * r, 0.62 * r),
                (nose - 0.05, offset, 0, 0.42 * r, 0.42 * r),
                (nose, offset, 0, 0.2 * r, 0.2 * r),
            ],
        ),
    )

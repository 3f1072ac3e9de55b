"""Contacts of the cutter outside of cuts: depth and place, and the cut level where there is no workpiece mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import VerificationCheck, VerificationInformation, build_skipped_check
from machopt.verification.motion.collision.bodies import CoalBody, invert_transforms, is_near
from machopt.verification.motion.collision.contact_search import ContactInterval
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.tables.exported_tables import ExportedMotion

MAX_CONTACT_SAMPLES, MAX_DEPTH_SAMPLES = 400, 48  # samples checked for contact, and for its depth
MAX_DEPTH_M = 1.0  # m
DEPTH_TOLERANCE_M = 1e-4  # m, of a depth
LEVEL_TOLERANCE_M = 2e-4  # m under the level of a cut; twice what the drawn-in cutter may graze
MIN_AXIS_COSINE = np.cos(np.radians(30.0))  # a tool more oblique than this to a cut's axis does not show its level


def check_contacts(
    found: list[ContactInterval], motion: ExportedMotion, arm: UrdfKinematics, bodies: list[CoalBody]
) -> VerificationCheck:
    """Return the check of contacts along the motion; contacts of cutter and workpiece have their greatest depth.

    Args:
        found: The contacts.
        motion: The exported motion (trajectory.csv), SI.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
    """
    texts = []
    for contact in found[:5]:
        text = f"{contact.pair} first at {motion.describe_row(contact.sample)}"
        parts = [b for b in bodies if b.kind == "workpiece" and contact.pair == f"{b.name} ~ cutter"]
        if parts:
            depth, at = find_deepest_contact(motion, arm, bodies, np.array(contact.stretches))
            if np.isfinite(depth):
                text += f", not on a feed move of the CAM file, {1e3 * depth:.1f} mm deep at {motion.describe_row(at)}"
        texts.append(text)
    return VerificationCheck(
        name="contacts",
        passed=not found,
        value=float(len(found)),
        limit=0.0,
        unit="pairs",
        where="; ".join(texts) or "none",
    )


def find_deepest_contact(
    motion: ExportedMotion, arm: UrdfKinematics, bodies: list[CoalBody], rows: NDArray[np.int64]
) -> tuple[float, int]:
    """Return the greatest retraction along the tool axis, m, that frees the cutter from the workpiece.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        rows: Rows of the motion to search.

    Returns:
        Depth and row; NaN and −1 where the cutter touches in none of them.
    """
    cutters, parts = ([b for b in bodies if b.kind == kind] for kind in ("grazing", "workpiece"))
    rows = _select_rows(np.unique(rows), MAX_CONTACT_SAMPLES)
    world = arm.compute_placements(motion.q[rows], motion.external[rows])
    met = [
        (n, cutter, part)
        for n in range(len(rows))
        for cutter in cutters
        for part in parts
        if is_near(part, cutter, invert_transforms(world[n, part.carrier]) @ world[n, cutter.carrier])
    ]
    best, at = float("nan"), -1
    for i in _select_rows(np.arange(len(met)), MAX_DEPTH_SAMPLES):
        n, cutter, part = met[i]
        d = _compute_depth(cutter, part, world[n], arm.cell.tool.T_flange_tcp[:3, 2])
        if not d <= best:
            best, at = d, int(rows[n])
    return best, at


def _select_rows(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of them, evenly."""
    return np.asarray(rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(int))])


def _compute_depth(cutter: CoalBody, part: CoalBody, places: Array, z_flange: Array) -> float:
    T = invert_transforms(places[part.carrier]) @ places[cutter.carrier]

    def touches(height: float) -> bool:
        back = T.copy()
        back[:3, 3] -= height * (T[:3, :3] @ z_flange)
        return is_near(part, cutter, back)

    free = 1e-3
    while touches(free) and free < MAX_DEPTH_M:
        free *= 2.0
    touching = 0.0 if free == 1e-3 else free / 2.0
    while free - touching > DEPTH_TOLERANCE_M and free < MAX_DEPTH_M:
        middle = (free + touching) / 2.0
        touching, free = (middle, free) if touches(middle) else (touching, middle)
    return min(free, MAX_DEPTH_M)


def measure_depth_outside_cuts(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations, arm: UrdfKinematics, bodies: list[CoalBody]
) -> list[VerificationInformation]:
    """Return how deep the CAM file itself moves the cutter into the workpiece in a move that is no cut.

    The motion follows the CAM file there, so this is information and no check.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        locations: Position of each motion sample relative to the toolpath.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
    """
    name = "cutter in the workpiece outside cuts"
    if arm.cell.tool.cutter is None or not arm.cell.workpiece.geometry:
        return []  # nothing to look at, which the verdict says of the cell
    rows = np.flatnonzero(
        (locations.on_feed_move & ~toolpath.cutting[locations.next_point]) | locations.on_retract_move
    )
    depth, at = find_deepest_contact(motion, arm, bodies, rows) if len(rows) else (float("nan"), -1)
    if not np.isfinite(depth):
        return [VerificationInformation(name=name, value=0.0, unit="mm", where="nowhere")]
    why = (
        "the CAM file moves at a feed there"
        if locations.on_feed_move[at]
        else "the CAM file begins or ends a move there"
    )
    return [VerificationInformation(name=name, value=1e3 * depth, unit="mm", where=f"{motion.describe_row(at)}: {why}")]


LEVEL_CHECK = "level of the cuts"


def check_cut_level(
    motion: ExportedMotion,
    toolpath: Toolpath,
    locations: SampleLocations,
    cell: Cell,
    commanded: tuple[Array, Array] | None = None,
) -> list[VerificationCheck]:
    """Check without a workpiece mesh that a free tool tip is not below the cuts above it; report the nearest level.

    A compensated path is cut at the commanded level: a free move begins where the shifted cut ends. Moves from and to
    home are checked too, unless the tip is below a cut at home; then this is reported.

    A cut is above the tip if it lies within the cutter's radius of it, seen along the cut's axis. Without a cutter
    only the tip counts.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        locations: Position of each motion sample relative to the toolpath.
        cell: The robot cell.
        commanded: Index (P,) and position (P, 3) m of the commanded path in the workpiece frame; None without
            compensation.
    """
    if cell.workpiece.geometry:
        return []
    rows, known = np.flatnonzero(locations.is_free), np.isfinite(motion.point)
    cuts = 1 + np.flatnonzero(toolpath.cutting[1:])
    if not len(rows) or not len(cuts):
        return [
            VerificationCheck(
                name=LEVEL_CHECK,
                passed=True,
                value=0.0,
                limit=1e3 * LEVEL_TOLERANCE_M,
                unit="mm",
                where="no free move near a cut",
            )
        ]
    under, beside = _measure_levels(toolpath, locations, cell, commanded, rows, known, cuts)
    every = np.zeros(len(known))
    every[rows] = under
    resting = [(n, move) for n, move in _find_rest_rows(known) if every[n] > LEVEL_TOLERANCE_M]
    for _, move in resting:
        every[move] = 0.0
    return _list_level_checks(motion, rows, every[rows], beside, [row for row, _ in resting])


def _list_level_checks(
    motion: ExportedMotion, rows: NDArray[np.intp], under: Array, beside: Array, resting: list[int]
) -> list[VerificationCheck]:
    """Return the checks of the depths (n,) m under and beside the cuts at rows (n,) of the motion.

    Args:
        motion: The exported motion.
        rows: Samples of free moves.
        under: Depth under the cuts above, without the moves from and to ``resting``.
        beside: Depth under the nearest cuts.
        resting: Samples at rest that are under a cut.
    """
    k, m = int(np.argmax(under)), int(np.argmax(beside))
    out = [
        VerificationCheck(
            name=LEVEL_CHECK,
            passed=bool(under[k] <= LEVEL_TOLERANCE_M),
            value=1e3 * float(under[k]),
            limit=1e3 * LEVEL_TOLERANCE_M,
            unit="mm",
            where=motion.describe_row(rows[k]),
        )
    ]
    if beside[m] > LEVEL_TOLERANCE_M:
        out.append(
            build_skipped_check(
                "level beside the cuts",
                f"the tip goes {1e3 * beside[m]:.1f} mm under the nearest cuts at {motion.describe_row(rows[m])}; "
                "without workpiece geometry it is not known whether there is material",
                "mm",
            )
        )
    for row in resting[:1]:
        why = f"the tip rests under a cut at {motion.describe_row(row)}, so that no move from or to there stays over it"
        out.append(build_skipped_check("level of moves from and to rest", why, "mm"))
    return out


def _measure_levels(
    toolpath: Toolpath,
    locations: SampleLocations,
    cell: Cell,
    commanded: tuple[Array, Array] | None,
    rows: NDArray[np.intp],
    known: Bools,
    cuts: NDArray[np.intp],
) -> tuple[Array, Array]:
    """Return (n,) m by which the tip in the rows is under cuts above it, and under the nearest cuts beside it."""
    radius = cell.tool.cutter.diameter / 2.0 if cell.tool.cutter is not None else 1e-3
    line = commanded or (np.arange(len(toolpath), dtype=float), toolpath.position)
    place, axis = _sample_cuts(toolpath, line, cuts, max(radius, 1e-3))
    under, beside = np.zeros(len(rows)), np.zeros(len(rows))
    for i, n in enumerate(rows):
        x, shank = locations.tcp[n, :3, 3], -locations.tcp[n, :3, 2]
        up = x - place
        height = np.einsum("ij,ij->i", up, axis)
        aside = np.linalg.norm(up - height[:, None] * axis, axis=1)
        side = axis @ shank > MIN_AXIS_COSINE
        close = side & (aside <= radius)
        if close.any():
            under[i] = max(0.0, -float(height[close].max()))
        elif side.any() and known[n]:
            nearest = int(np.argmin(np.where(side, aside, np.inf)))
            wide = side & (aside <= 2.0 * aside[nearest])
            beside[i] = max(0.0, -float(height[wide].max()))
    return under, beside


def _find_rest_rows(known: NDArray[np.bool_]) -> list[tuple[int, slice]]:
    """Of the moves from and to rest, the row where the arm rests, and all rows; ``known`` (S,) is on the toolpath."""
    on = np.flatnonzero(known)
    first, last = (int(on[0]), int(on[-1])) if len(on) else (len(known), -1)
    return [(0, slice(0, first))] * (first > 0) + [(len(known) - 1, slice(last + 1, None))] * (last < len(known) - 1)


def _sample_cuts(
    toolpath: Toolpath, line: tuple[Array, Array], cuts: NDArray[np.intp], step: float
) -> tuple[Array, Array]:
    """Places (M, 3) on ``line`` and axes (M, 3) along the cuts, at most ``step`` m apart (20 a cut)."""
    places, axes = [], []
    for k in cuts:
        a, b = toolpath.position[k - 1], toolpath.position[k]
        count = int(np.clip(np.ceil(np.linalg.norm(b - a) / step), 1, 20))
        f = np.linspace(0.0, 1.0, count + 1)
        places.append(np.column_stack([np.interp(k - 1 + f, line[0], line[1][:, c]) for c in range(3)]))
        before, after = (np.tile(toolpath.axis[n], (count + 1, 1)) for n in (k - 1, k))
        axes.append(interpolate_axis(before, after, f))
    return np.concatenate(places), np.concatenate(axes)

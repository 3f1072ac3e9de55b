"""One exported trajectory held against cell and toolpath, check by check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.verify.arm import Arm
from machopt.verify.asked import check_asked
from machopt.verify.bodies import Body, all_bodies, pairs
from machopt.verify.check import Check, Promise, Row, Verification, counted, not_run, of_file, worst
from machopt.verify.clearance import TOLERANCE, check_clearances, may_cut, telling
from machopt.verify.contact import Scene, contacts
from machopt.verify.encoder import outside, true_angles, unchecked
from machopt.verify.feed import check_feed
from machopt.verify.gouge import check_gouges
from machopt.verify.inventory import check_inventory
from machopt.verify.labels import check_labels
from machopt.verify.limits import check_limits
from machopt.verify.material import level, outside_cuts, told_contacts
from machopt.verify.path import check_path
from machopt.verify.points import ROWS, PointsCheck
from machopt.verify.rests import check_rests
from machopt.verify.ride import ride
from machopt.verify.shift import Found, compare_shift, corners
from machopt.verify.table import Motion, Points, Shift, read_motion, read_points, read_shift
from machopt.verify.touching_pairs import checked_pairs

OFF = "collision checks are switched off (collision: false)"


@dataclass(frozen=True)
class Tables:
    """trajectory.csv, points.csv and compensation.csv as they were read."""

    motion: Motion
    points: Points
    shift: Shift | None


def read_tables(cell: Cell, out: Path, motion: Motion | None = None) -> Tables | Verification:
    """The tables of an output folder; a table that cannot be read is a failed check like any other damage.

    Args:
        cell: the robot cell.
        out: the output folder.
        motion: trajectory.csv where it has been read already.
    """
    try:
        motion = motion or read_motion(out / "trajectory.csv", cell)
        points = read_points(out / "points.csv", cell)
        return Tables(motion, points, read_shift(out / "compensation.csv") if points.shift is not None else None)
    except InputError as error:
        name = Path(str(error.file)).name if error.file is not None else "tables"
        place = f"{error.where}: " if error.where else ""
        check = of_file(name, Promise.READABLE, False, np.nan, np.nan, "", f"{place}{error.reason}", of=" ")
        return Verification((check,), 0, 0.0)


def verify_output(
    cell: Cell,
    toolpath: Toolpath,
    out: Path,
    *,
    options: PlanOptions | None = None,
    motion: Motion | None = None,
    touching: Sequence[tuple[str, str]] | None = None,
) -> Verification:
    """Check ``out/trajectory.csv`` and ``out/points.csv``, and ``compensation.csv`` where points.csv tells a shift.

    Every column of both tables is recomputed; what the rows call their moves is checked against the CAM file and
    believed nowhere. Where points.csv holds a compensation, the commanded path is the toolpath shifted as
    compensation.csv says, and the shift is held against the deflection computed here. Joint columns are encoder
    angles, limits hold for them; where the arm stands follows with the cell's corrections.

    Args:
        cell: the robot cell.
        toolpath: what was to be followed.
        out: the output folder.
        options: those of the run; with ``allow_gaps`` points that points.csv gives up need not be visited; without
            ``collision`` contacts are not looked for, and that is told.
        motion: trajectory.csv where it has been read already.
        touching: names of the bodies that the folder's manifest says touch by construction; None: it lists none.
    """
    options = options or PlanOptions()
    tables = read_tables(cell, Path(out), motion)
    if isinstance(tables, Verification):
        return tables
    motion, home = tables.motion, cell.stands_at_home
    checks = [
        *check_limits(motion, cell, options, (home, home)),
        *with_one_tool(cell, toolpath, tables, options, touching),
    ]
    return Verification.of_rows(checks, len(motion.time), float(motion.time[-1] - motion.time[0]))


def with_one_tool(
    cell: Cell,
    toolpath: Toolpath,
    tables: Tables,
    options: PlanOptions,
    touching: Sequence[tuple[str, str]] | None = None,
) -> list[Row]:
    """Everything but time, joint limits and both ends of the motion; arguments as for :func:`verify_output`."""
    motion, points, shift = tables.motion, tables.points, tables.shift
    arm = Arm(cell)
    index, position = (
        (np.arange(len(toolpath), dtype=float), toolpath.position) if shift is None else (corners(toolpath, shift))
    )
    stands = replace(motion, q=true_angles(cell.kinematics, motion.q))
    stood = replace(points, q=true_angles(cell.kinematics, points.q))
    on = ride(motion, toolpath, index, position, arm.tcp_in_workpiece(stands.q, motion.external), options)
    checks: list[Row] = [
        *check_path(motion, toolpath, points, on, options.allow_gaps),
        *check_labels(motion, toolpath, points, on, options.allow_gaps),
        *check_feed(motion, toolpath, on, options),
        *check_rests(motion, toolpath, points, on, (index, position), cell),
    ]
    bodies = all_bodies(cell, arm)
    table = PointsCheck(cell, toolpath, points, arm, np.nan_to_num(stood.q), options)
    # pairs that a plan can be asked to keep apart by the clearance
    kept, unfounded = checked_pairs(cell, arm, bodies, options.clearance, touching)
    wanted = kept if touching is not None else pairs(cell, arm, bodies)
    of_points = [*table.all(motion, on), *_clearance(table, stood, bodies, kept, options)]
    checks += [replace(c, file="points.csv") for c in of_points]
    checks += check_asked(cell, toolpath, points, np.flatnonzero(table.live), options, motion)
    checks += [*outside(cell.kinematics, motion.q), *unchecked(cell.kinematics)]
    if shift is not None:
        checks += [_shift_check(f) for f in compare_shift(cell, toolpath, stands, stood, shift, arm, options)]
    if options.collision and touching is not None:
        checks.append(counted(Promise.TOUCHING, unfounded, "pairs"))
    checks += check_inventory(cell, arm, bodies, wanted)
    checks += check_gouges(stands, toolpath, on, arm, bodies, options, shift is not None)
    if options.collision:
        checks.append(told_contacts(contacts(arm, wanted, stands.q, stands.external, on.free), stands, arm, bodies))
        checks += [
            *outside_cuts(stands, toolpath, on, arm, bodies),
            *level(stands, toolpath, on, cell, (index, position)),
        ]
    else:
        checks.append(not_run(Promise.CONTACTS, OFF))
    return checks


def _clearance(
    table: PointsCheck, stood: Points, bodies: list[Body], wanted: list[tuple[Body, Body]], options: PlanOptions
) -> list[Check]:
    """clearance_mm and nearest_pair; empty where collisions are not checked."""
    name, rows = "points.csv clearance_mm", np.flatnonzero(table.live)
    told = table.points.numbers["clearance_mm"][rows]
    if not options.collision:
        extra = np.where(np.isnan(told), 0.0, np.inf)
        at = table.where(rows)
        told_off = [worst(name, "mm", extra, 0.0, lambda n: f"{at(n)} has one, but collisions are switched off")]
        return told_off if len(rows) else []
    if not len(rows):
        return []
    if np.isnan(told).any():
        lacking = table.where(rows[np.isnan(told)])(0)
        return [
            Check(
                name=name,
                passed=False,
                value=np.nan,
                limit=1e3 * TOLERANCE,
                unit="mm",
                where=f"{lacking} is ok and has none",
            )
        ]
    named = table.points.words.get("nearest_pair")
    if named is None:
        return [
            Check(
                name="points.csv nearest_pair",
                passed=False,
                value=np.nan,
                limit=0.0,
                unit="mm",
                where="the column is missing",
            )
        ]
    graze, at = may_cut(table.toolpath)[table.k[rows]], table.where(rows)
    wanted = telling(table.arm, wanted)
    short, beyond, pair = np.zeros(len(rows)), np.zeros(len(rows)), [""] * len(rows)
    for first in range(0, len(rows), ROWS):
        some = slice(first, first + ROWS)
        scene = Scene(table.arm, bodies, np.hstack([stood.q, stood.external])[rows[some]])
        found = check_clearances(scene, wanted, told[some] / 1e3, tuple(named[n] for n in rows[some]), graze[some])
        short[some], beyond[some], pair[some] = found.short, found.beyond, found.pair
    return [
        worst(name, "mm", 1e3 * short, 1e3 * TOLERANCE, lambda n: f"{at(n)}{f', {pair[n]}' if pair[n] else ''}"),
        worst("points.csv nearest_pair", "mm", 1e3 * beyond, 0.0, lambda n: f"{at(n)}, {named[rows[n]] or 'none'}"),
    ]


def _shift_check(found: Found) -> Check:
    if found.not_run:
        return not_run(found.name, found.not_run, found.unit)
    return replace(worst(found.name, found.unit, found.values, found.limit, found.where), file=found.file)

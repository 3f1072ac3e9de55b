"""Coverage of a verification: what was checked, what was not, and what cannot be recomputed.

Verdict, result, report and manifest take their wording from here. Whatever is switched off, widened or left out of
the cell is named in the verdict itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import degrees
from pathlib import Path

from machopt.data_types.cell import Cell
from machopt.data_types.documents.program_entries import RobotProgramEntry
from machopt.data_types.manifest import CheckCoverage
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.verification import VerificationCheck
from machopt.verification.check_results import CheckName
from machopt.verification.motion.path_geometry.sample_location import AXIS_DEG, PATH_MM

_MAX_NAMED = 3  # pairs that may touch are named in the verdict; all stand in the report
_ROUNDING = 1e-9  # of a limit: what the conversion from user units leaves


NOT_RECOMPUTED = (
    "index_scale",
    "chosen_from",
    "objective.cam_default",
    "objective.jiao2022",
    "objective.grid",
    "objective.chosen.tolerance",
    "objective.chosen.stability",
    "objective.search.sequence",
    "objective.search.lower_bound",
    "objective.search.external",
    "objective.gain.std_percent",
    "front",
    "compensation.removed",
    "compensation.operations",
    "tilt.bound",
    "process.stock",
    "process.advised_feed.needed",
    "process.advised_feed.file_feed_s",
    "infeasible_points.best_stability",
    "reentry.reason",
    "reentry.objective_without",
    "reentry.mean_percent",
    "reentry.worst_percent",
    "programs.feed_model",
    "programs.order",
    "worst_point.deflection_along_mm",
    "worst_point.deflection_across_mm",
    "breaks.help",
    "rapid_detours",
    "obstructions",
    "timings_s",
    "warnings.hints",
)
"""Keys of result.json whose values follow from the planner alone: verify recomputes sums, ratios and bounds made of
them and that they can be so at all, not the values themselves. ``objective.*`` are costs of choices that are not in the
folder, ``front`` is every plan of the trade-off but the first, which is the motion in the folder."""


def list_unchecked(cell: Cell, options: PlanOptions, toolpath: Toolpath | None = None) -> tuple[str, ...]:
    """Return what is switched off, wider than the defaults or not present, in the words of the verdict.

    It follows from cell, options and toolpath alone, so planner and verifier return the same words.

    Args:
        cell: The robot cell.
        options: The planning options in force.
        toolpath: The planned toolpath; None leaves it out.
    """
    out = []
    if not options.collision:
        out.append("collisions NOT checked")
    else:
        there = {
            "robot": _has_bodies(cell),
            "workpiece": cell.workpiece.geometry,
            "tool": all(tool.geometry for tool in cell.tools_on),
            "cutter": all(tool.cutter for tool in cell.tools_on),
            "obstacles": cell.obstacles,
        }
        missing = [name for name, bodies in there.items() if not bodies]
        if missing:
            out.append(f"collisions with {_join_names(missing)} NOT checked (not in the cell)")
        tools = [s for tool in cell.tools_on for s in tool.geometry]
        standing = {s.name for s in (*cell.workpiece.geometry, *cell.obstacles, *tools)} | {"cutter"}
        first = sorted(cell.may_touch, key=lambda p: not standing & {*p.first, *p.second})  # a link's own come last
        pairs = [f"{p.a} ~ {p.b}" for p in first if p.first and p.second]
        if pairs:
            more = [f"{len(pairs) - _MAX_NAMED} more"] if len(pairs) > _MAX_NAMED else []
            out.append(f"{_join_names([*pairs[:_MAX_NAMED], *more])} NOT checked (ignore_pairs)")
    for name, found, limit, unit in (
        ("path", 1e3 * options.path_tolerance, PATH_MM, "mm"),
        ("tool axis", degrees(options.axis_tolerance), AXIS_DEG, "deg"),
    ):
        if found > limit * (1 + _ROUNDING):
            out.append(f"{name} tolerance {found:.4g} {unit} instead of {limit:g} {unit}")
    if options.allow_gaps:
        out.append("gaps allowed")
    if toolpath is not None and toolpath.meta.get("incomplete"):
        out.append("content after the end of the CAM file NOT used (it seems cut off)")
    if toolpath is not None:
        unknown = sum(
            e.kind == "dwell" and not e.value >= 0.0 for e in toolpath.events
        )  # turns of a spindle, or nothing
        if unknown:
            out.append(f"{unknown} {'dwell' if unknown == 1 else 'dwells'} of unknown length NOT done")
    return tuple(out)


def list_checked(options: PlanOptions) -> tuple[CheckCoverage, ...]:
    """Return what was checked, and how finely.

    Args:
        options: The planning options in force.
    """
    out = [
        CheckCoverage("points.csv, trajectory.csv", "every column recomputed, to what its printed decimals explain"),
        CheckCoverage("moves", "every sample against the CAM file, whatever it calls itself"),
        CheckCoverage("path", f"every sample at a feed within {max(PATH_MM, 1e3 * options.path_tolerance):.4g} mm"),
        CheckCoverage(
            "tool axis", f"every sample at a feed within {max(AXIS_DEG, degrees(options.axis_tolerance)):.4g} deg"
        ),
        CheckCoverage("joint limits", "position, velocity, acceleration and jerk, by differences of all samples"),
        CheckCoverage("feed", "every sample against the CAM file"),
        CheckCoverage("dwells and stops", "at rest at the point for the time that the CAM file states"),
        CheckCoverage(
            "robot programs", "every target against motion and CAM file, every other word as the post writes it"
        ),
    ]
    if options.collision:
        out.append(CheckCoverage("contacts", "at and between all samples"))
    return tuple(out)


def format_completeness(not_cut: int, not_reached: int) -> str:
    """The verdict's word for how much of the toolpath is done.

    Args:
        not_cut: points that are to be cut to and are not.
        not_reached: other points of the toolpath that are left out.
    """
    if not_cut:
        return f"done with gaps: {not_cut} {'point' if not_cut == 1 else 'points'} not cut"
    if not_reached:
        return f"done with gaps: {not_reached} {'point' if not_reached == 1 else 'points'} not reached"
    return "done"


def list_checks_not_run(checks: Iterable[VerificationCheck]) -> tuple[str, ...]:
    """Return the names of checks that could not be made; what the options switch off comes from
    :func:`list_unchecked`.

    Args:
        checks: All checks of the verification.
    """
    return tuple(f"{c.name} NOT checked" for c in checks if c.passed is None and c.check_name != CheckName.CONTACTS)


def list_production_blockers(
    cell: Cell, unchecked: Sequence[str], programs: Sequence[RobotProgramEntry]
) -> tuple[str, ...]:
    """Return what has to be settled before production, the most serious first; verdict and report begin with it.

    It follows from the cell, the verdict's scope and the programs as read back, so ``verify`` finds the same words.

    Args:
        cell: of the job.
        unchecked: what the verdict does not cover.
        programs: of the job, as result.json has them.
    """
    out = list(unchecked)
    for p in programs:
        if not p.files:
            continue
        name = p.files[0]
        out += [f"{name}: {text}" for text in p.not_in_program]
        out += [f"{name} NOT checked: no reader knows its language"] if p.checked is None else []
        out += [f"{name}: assumed of the controller: {text}" for text in p.assumed]
    if cell.stiffness is not None and cell.stiffness.estimated:
        name = Path(cell.stiffness.file or "stiffness.yaml").name
        out.append(f"the stiffness is estimated ({name}), not measured on this arm: deflections and gains are guesses")
    return tuple(out)


def _has_bodies(cell: Cell) -> bool:
    """The robot's own file describes bodies that can touch anything."""
    return "<collision" in cell.urdf_text


def _join_names(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last

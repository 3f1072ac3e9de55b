"""Terminal output of ``optimize`` and ``verify``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.cli.objective_lines import format_bound_lines, format_choice_lines, format_gain_lines
from machopt.cli.result_values import convert_null_to_nan, format_or_dash, format_point, format_with_interval
from machopt.data_types.manifest import add_scope_to_verdict

if TYPE_CHECKING:
    from machopt.data_types.documents.optimize_document import (
        CompensationSection,
        MotionBreakEntry,
        OptimizeDocument,
        ParetoPlanEntry,
    )


STOPS = 6  # places that are named where the motion stops

UNKNOWN_OUTCOMES = re.compile(r"[0-9]+ outcomes? unknown: ")  # what is missing, of the limits of validity


def _format_worst_point(result: OptimizeDocument) -> list[str]:
    """Return deflection and stiffness at the worst point; empty without one."""
    soft = result.worst_point
    if not soft:
        return []
    lines = []
    if soft.deflection_mm is not None:
        parts = [
            f"{format_with_interval(value, interval)} {where}"
            for where, value, interval in (
                ("in all", soft.deflection_mm, soft.deflection_ci90_mm),
                ("along the tool axis", soft.deflection_along_mm, soft.deflection_along_ci90_mm),
                ("across it", soft.deflection_across_mm, soft.deflection_across_ci90_mm),
            )
        ]
        lines.append(f"  worst point {soft.point}: deflection {', '.join(parts)}")
    lines.append(
        f"  {'stiffness there' if soft.deflection_mm is not None else f'worst point {soft.point}'}: "
        f"{1e-3 * convert_null_to_nan(soft.k_axial_N_mm):.3f} N/µm along the tool axis, "
        f"{1e-3 * convert_null_to_nan(soft.k_normal_N_mm):.3f} N/µm across it"
    )
    return lines


def _format_front_table(plans: Sequence[ParetoPlanEntry]) -> list[str]:
    """Return tolerances and stability of the plans of a front, the fastest first; empty where there are none."""
    if all(p.in_tolerance is None and p.least_stability_ratio is None for p in plans):
        return []
    wide = max(len(p.plan) for p in plans)
    lines = [f"    {'plan':{wide}}  cycle s  in tolerance  marginal  fail  mean error mm  worst  stability"]
    for p in sorted(plans, key=lambda p: p.cycle_time_s):
        counts = [format_or_dash(value, "d") for value in (p.in_tolerance, p.marginal, p.fail)]
        errors = [format_or_dash(value, ".3f") for value in (p.mean_error_mm, p.worst_error_mm)]
        stability = format_or_dash(p.least_stability_ratio, ".2f")
        lines.append(
            f"    {p.plan:{wide}}  {p.cycle_time_s:7.1f}  {counts[0]:>12}  {counts[1]:>8}  {counts[2]:>4}  "
            f"{errors[0]:>13}  {errors[1]:>5}  {stability:>9}"
        )
    return lines


def format_optimize_summary(result: OptimizeDocument, report: Path) -> list[str]:
    """Return the summary of a result as lines.

    Args:
        result: The content of result.json.
        report: Path of the report.
    """
    path = result.toolpath
    lines = [] if result.process is None or not result.process.tolerances else [result.process.headline]
    if result.process is not None:
        lines += [f"  {text}" for text in result.process.validity if UNKNOWN_OUTCOMES.match(text)]
    lines += [f"before production: {text}" for text in result.production_blockers]
    lines += [
        f"{result.verdict}: {path.cutting_points} cutting points of {path.points}, "
        f"{len(path.operations)} operations, {path.format}"
    ]
    lines += format_choice_lines(result)
    lines += format_gain_lines(result)
    lines += format_bound_lines(result)
    if result.front:
        free = [p.plan for p in result.front if not p.dominated]
        lines.append(f"  front of {len(free)} plan{'s' * (len(free) > 1)} in front.csv: {', '.join(free)}")
        if any(p.dominated and p.plan == "requested" for p in result.front):
            lines.append("  another of these plans is at least as good in every criterion as the requested plan")
        lines += _format_front_table([p for p in result.front if not p.dominated])
    lines += _format_worst_point(result)
    if result.process is not None and result.process.stability is not None:
        lines.append(f"  {result.process.stability.describe()}")
    shift = result.compensation
    if shift:
        lines.append(
            f"  compensated by up to {shift.max_mm:.3f} mm (mean {shift.mean_mm:.3f}); predicted to leave "
            f"{shift.residual_mean_mm:.4f} mm on average, {shift.residual_max_mm:.4f} at worst"
        )
        lines += _format_removed_deflection(shift)
    lines += _format_tilt(result)
    lines += _format_joint_method(result)
    lines += _format_reentries(result)
    if result.cycle_time_s is not None and result.feed_held_share is not None:
        dips, ramps = len(result.feed_dips), len(result.feed_stops)
        rest = f", {dips} dips" if dips else ", the rest is braking at stops that the path requires" if ramps else ""
        lines.append(
            f"  {result.cycle_time_s:.1f} s cycle time, programmed feed reached for "
            f"{100 * result.feed_held_share:.1f} % of the cutting time{rest}"
        )
    for stop in result.obstructions[:STOPS]:
        lines.append(f"  stopped from {format_point(stop.before)} to {format_point(stop.after)}: {stop.reason}")
    if len(result.obstructions) > STOPS:
        lines.append(f"  stopped at {len(result.obstructions) - STOPS} more places, see the report")
    unknown = [w for w in path.ignored if not w.understood]
    if unknown:
        words = ", ".join(f"{w.word} ×{w.count} (line {w.first_line})" for w in unknown[:6])
        lines.append(f"  not understood in the CAM file: {words}{' …' if len(unknown) > 6 else ''}")
    lines += [f"  note: {w}" for w in result.warnings[:6]]
    lines += _format_program_lines(result)
    if result.verification is not None:
        passed = "passed" if result.verification.passed else "FAILED"
        lines.append("  " + add_scope_to_verdict(f"verification {passed}", result.unchecked))
    lines.append(f"report: {report}")
    return lines


def _format_removed_deflection(shift: CompensationSection) -> list[str]:
    """What the model's own error makes of it, where that is known."""
    r = shift.removed
    if r is None or r.removed_ci90_percent is None or r.residual_max_ci90_mm is None:
        return []
    low, high = r.removed_ci90_percent
    least, most = r.residual_max_ci90_mm
    text = f"    {low:.1f} to {high:.1f} % of the mean deflection removed".replace("-", "−")
    return [f"{text} (90 %), {least:.4f} to {most:.4f} mm remaining at most"]


def format_first_infeasibility(result: OptimizeDocument) -> str:
    """Return the first infeasible places and what would help there.

    Args:
        result: The content of result.json.
    """
    points = result.infeasible_points
    breaks = [
        b for b in result.breaks if not any(b.reason in p.reason for p in points)
    ]  # reported at the point already
    parts = []
    if points:
        number = f"{len(points)} points" if len(points) > 1 else "1 point"
        parts.append(f"{number}, the first is {points[0].point}: {points[0].reason}")
    if breaks:
        number = f"{len(breaks)} breaks" if len(breaks) > 1 else "1 break"
        parts.append(f"{number}, the first {format_break_ends(breaks[0])}: {breaks[0].reason}")
    first_entries = (points or breaks)[:1]
    return "; ".join(parts) + (f"; {first_entries[0].help}" if first_entries else "")


def format_break_ends(one: MotionBreakEntry) -> str:
    """Return the two ends of a break as text.

    Args:
        one: The break of the motion.
    """
    ends = ("home" if k is None else f"point {k:g}" for k in (one.from_point, one.to_point))
    return "from {} to {}".format(*ends)


def _format_program_lines(result: OptimizeDocument) -> list[str]:
    """One line a robot program: where it is and what came back when it was read."""
    lines = []
    if not result.programs and result.exit_code == 0:
        lines.append("  no robot program: the cell names no controller.post and no --post was given, e.g. --post krl")
    for p in result.programs:
        c = p.checked
        if p.withheld:
            lines.append(f"  program for {p.post} not written: {p.withheld}")
            continue
        if c is None:
            lines.append(f"  program {p.files[0]}: NOT CHECKED: no reader for this language exists")
        else:
            state = f"read back, largest difference {convert_null_to_nan(c.positions_max_mm):.1g} mm"
            if p.differences:
                state = "DIFFERS FROM THE PLAN WHEN READ BACK"
            if c.path_max_mm is not None:
                state += f", largest distance from the planned motion {c.path_max_mm:.3f} mm"
            added = f" ({p.moves_added} added for that)" if p.moves_added else ""
            lines.append(f"  program {p.files[0]}: {c.moves} moves{added}, {state}")
        feed = p.feed_model
        if feed is not None:
            lines.append(
                f"    feed by the model of the controller: {feed.mean_percent:.0f} % of the programmed one on average, "
                f"{feed.lowest_percent:.0f} % in the slowest move, {feed.exact_stops} exact stops; corners rounded by "
                f"{feed.rounding_max_mm:.3f} mm at most"
            )
    return lines


def _format_joint_method(result: OptimizeDocument) -> list[str]:
    out = []
    for entry in result.joint or ():
        if entry.accepted and entry.fixed_path_s is not None and entry.joint_s is not None:
            saved = 100.0 * (1.0 - entry.joint_s / entry.fixed_path_s)
            taken = sum(window.accepted for window in entry.windows)
            out.append(
                f"  rotation and feed together: {entry.joint_s:.1f} s instead of {entry.fixed_path_s:.1f} s with the "
                f"path of the plan at its advised feeds ({saved:.0f} % less), {taken} of {len(entry.windows)} windows"
            )
        else:
            out.append(f"  the path of the plan is driven at its advised feeds: {entry.reason}")
        refused = [window for window in entry.windows if not window.accepted]
        out += [f"    not accepted, {window.window}: {window.reason}" for window in refused[:3]]
    return out


def _format_reentries(result: OptimizeDocument) -> list[str]:
    out = []
    for entry in result.reentry or ():
        if entry.points:
            places = ", ".join(map(str, entry.points))
            changes = [
                f"{what} {value:+.1f} %"
                for what, value in (("mean", entry.mean_percent), ("worst", entry.worst_percent))
                if value is not None
            ]
            out.append(f"  re-entry at point {places}: {', '.join(changes)} against the plan without")
        if entry.reason:
            out.append(f"  {'no further' if entry.points else 'no'} re-entry: {entry.reason}")
    return out


def _format_tilt(result: OptimizeDocument) -> list[str]:
    tilt = result.tilt
    if tilt is None:
        return []
    lead, side = (f"{low:.1f}° to {high:.1f}°" for low, high in (tilt.lead_deg, tilt.side_deg))
    out = [f"  tool tilted: lead {lead}, side {side}"]
    if tilt.bound is not None:
        out.append(
            f"    lower bound over {tilt.bound.tilts} tilts and {tilt.bound.rotation_step_deg:g}° of rotation, point "
            f"by point: mean index {tilt.bound.mean:.4f}, worst {tilt.bound.worst:.4f} of the scale"
        )
    return out

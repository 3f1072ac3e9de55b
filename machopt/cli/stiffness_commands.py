"""The commands ``identify``, ``plan-poses`` and ``map`` for stiffness."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.argument_errors import OptionParser
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.map_command import add_map_options
from machopt.cli.option_values import parse_floats, parse_integers
from machopt.cli.plan_poses_command import add_plan_poses_options
from machopt.cli.progress_display import ProgressDisplay, print_result
from machopt.cli.recording_preview_output import print_recording_preview
from machopt.cli.shared_options import add_shared_option

if TYPE_CHECKING:
    from machopt.data_types.documents.frequency_response_document import FrequencyResponseDocument
    from machopt.data_types.documents.identification_document import IdentificationDocument
    from machopt.measurement.identification.request import IdentifyRequest

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the three commands to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    cell = OptionParser(add_help=False)
    add_shared_option(cell, "cell")
    add_shared_option(cell, "--out")
    add_shared_option(cell, "--force")
    add_shared_option(cell, "--allow-external")
    add_shared_option(cell, "--seed")
    add_shared_option(cell, "--jobs")
    add_shared_option(cell, "--tables")
    parents = [common, cell]
    _add_identify(
        commands.add_parser(
            "identify", parents=parents, help="identify joint stiffness from load tests or frequency responses"
        )
    )
    add_plan_poses_options(
        commands.add_parser("plan-poses", parents=parents, help="choose poses and loads for a measurement")
    )
    add_map_options(
        commands.add_parser("map", parents=parents, help="compute stiffness and dexterity over positions and postures")
    )


def _add_identify(p: argparse.ArgumentParser) -> None:
    p.add_argument("recording", type=Path, nargs="+", help="recording folders, one for each session of the same robot")
    p.add_argument(
        "--model",
        choices=("auto", "constant", "grid"),
        default="auto",
        help="one stiffness for each joint (constant), or one for each cell of a workspace grid (grid); auto (default) "
        "takes the grid only where it predicts held-out poses better",
    )
    p.add_argument("--grid-cell-mm", type=float, default=300.0, help="edge length of a grid cell (default: 300)")
    p.add_argument(
        "--grid-origin-mm",
        type=parse_floats,
        metavar="X,Y,Z",
        help="corner of the grid with the smallest coordinates, in base_link",
    )
    p.add_argument(
        "--grid-shape", type=parse_integers, metavar="NX,NY,NZ", help="number of grid cells along x, y and z"
    )
    p.add_argument(
        "--fit",
        action="append",
        default=[],
        metavar="EFFECT@LOCATION",
        help="also fit this effect, e.g. link_compliance@link:4; parameters in braces; may be repeated",
    )
    p.add_argument(
        "--geometric",
        action="store_true",
        help="fit at the loaded equilibrium with the weight of the robot (dumas2011 eqs. 6–10), and write K_C into "
        "stiffness.yaml (default: K_C of the load alone, where it matters)",
    )
    p.add_argument("--plain", action="store_true", help="use unweighted least squares (dumas2011 eq. 26)")
    p.add_argument("--keep-outliers", action="store_true", help="do not exclude outliers")
    p.add_argument(
        "--level", type=float, default=90.0, metavar="PERCENT", help="confidence level of the intervals (default: 90)"
    )
    p.add_argument(
        "--no-studies",
        action="store_true",
        help="skip the studies with subsets of the readings and with simulated measurement errors",
    )
    add_shared_option(p, "--accept")
    add_shared_option(p, "--effects")
    add_shared_option(p, "--dry-run")
    p.set_defaults(run=_run_identify)


def _run_identify(args: argparse.Namespace) -> int:
    from machopt.commands.identify.run import run_identify
    from machopt.measurement.identification.request import IdentifyRequest
    from machopt.measurement.recording.frequency_response_reader import is_frequency_response_recording

    if args.dry_run:
        return print_recording_preview(args)
    warn_of_effect_code(args)
    request = IdentifyRequest(
        cell=args.cell,
        recordings=tuple(args.recording),
        out=args.out,
        overwrite=args.overwrite,
        model=args.model,
        terms=tuple(args.fit),
        geometric=args.geometric,
        plain=args.plain,
        robust=not args.keep_outliers,
        grid_cell_mm=args.grid_cell_mm,
        grid_origin_mm=args.grid_origin_mm,
        grid_shape=args.grid_shape,
        level_percent=args.level,
        studies=not args.no_studies,
        accept=tuple(args.accept),
        seed=args.seed,
        allow_external=args.allow_external,
        effects=tuple(args.effects),
        tables=args.tables,
    )
    if is_frequency_response_recording(args.recording[0]):  # what is no recording is refused below
        return _run_frequency_responses(args, request)
    with ProgressDisplay(show=not (args.quiet or args.json)) as display:
        done = run_identify(request, display.show_stage)
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(_format_identify_summary(done.result)))
        print(f"report: {done.report}")
    return 0


def _run_frequency_responses(args: argparse.Namespace, request: IdentifyRequest) -> int:
    from machopt.commands.identify.frequency_responses import run_frequency_response_identification

    with ProgressDisplay(show=not (args.quiet or args.json)) as display:
        done = run_frequency_response_identification(request, display.show_stage)
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(_format_frequency_responses(done.result)))
        print(f"report: {done.report}")
    return 0


def _format_frequency_responses(result: FrequencyResponseDocument) -> list[str]:
    unit = "N·m·s/rad" if result.damping_law == "viscous" else "loss factor"
    lines = [
        f"{len(result.responses)} responses, {_format_count(result.poses, 'pose')}, {result.damping_law} damping: "
        f"{100 * min(r.explained_share for r in result.responses):.1f} % or more of each response explained"
    ]
    for joint in result.joints:
        low, high = joint.interval
        text = f"{_format_number(low)} … {_format_number(high)}" if joint.identified else joint.reason
        first, last = joint.damping_interval
        damping = f"{joint.damping:.4g} {unit}  {_format_number(first)} … {_format_number(last)}"
        damping = "damping not determined" if first is None else damping
        lines.append(f"  joint {joint.joint}  {joint.k_Nm_per_rad:10.4g} N·m/rad   {text}   {damping}")
    for mode in result.modes:
        if mode.determined:
            low, high = mode.frequency_Hz
            lines.append(f"  mode {mode.mode}  {low:.1f} … {high:.1f} Hz  damping {mode.damping_percent:.2f} %")
    return [*lines, *(f"  note: {text}" for text in result.warnings)]


def _format_identify_summary(result: IdentificationDocument) -> list[str]:
    from machopt.data_types.documents.identification_document import MISFIT_WARNING, describe_unidentified_joint

    heldout = result.heldout_rmse_mm
    unseen = "no held-out pose" if heldout is None else f"{heldout:.4f} mm on unseen poses"
    first = [w for w in result.warnings if w.startswith(MISFIT_WARNING)]
    lines = [
        *first,
        f"{result.readings} readings, {_format_count(result.poses, 'pose')}, {result.model} model: "
        f"{_convert_null_to_nan(result.rmse_mm):.4f} mm a coordinate, {unseen}, "
        f"{100 * _convert_null_to_nan(result.explained_share):.1f} % explained",
    ]
    for joint in result.joints:
        low, high = joint.interval
        if joint.identified:
            text = f"{_convert_null_to_nan(low):.4g} … {_format_number(high)}"
        else:
            text = f"not identified, the cell's value or a bound: {joint.reason}"
        lines.append(f"  joint {joint.joint}  {joint.k_Nm_per_rad:10.4g} N·m/rad   {text}")
    for term in result.terms:
        low, high = term.interval
        what = f"{term.effect} {term.location} {term.coefficient}"
        why = "" if term.identified else f": {term.reason}"
        lines.append(
            f"  {what}  {_convert_null_to_nan(term.value):.4g} {term.unit}   {_format_number(low)} … "
            f"{_format_number(high)}{why}"
        )
    lines += [f"  {text}" for text in result.known_combinations]
    described = {describe_unidentified_joint(j.joint, j.reason) for j in result.joints}  # beside its stiffness above
    for s in result.inseparable:
        lines.append(
            f"  joint {s.joint} and the torsion of the {s.body} are one compliance: together "
            f"{_format_number(s.sum_ci90_rad_per_Nm[0])} … {_format_number(s.sum_ci90_rad_per_Nm[1])} rad/(N·m); the "
            f"joint alone has at least {_format_number(s.joint_at_least_Nm_per_rad)} N·m/rad"
        )
    lines += [f"  note: {w}" for w in result.warnings if w not in described and w not in first]
    return lines


def _convert_null_to_nan(value: float | None) -> float:
    """Return a number of a result file; null is NaN."""
    return math.nan if value is None else value


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _format_number(value: float | None) -> str:
    return "∞" if value is None else f"{value:.4g}"

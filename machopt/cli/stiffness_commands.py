"""The commands ``identify``, ``plan-poses`` and ``map`` for stiffness."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.progress_display import ProgressDisplay, print_result
from machopt.cli.shared_options import add_shared_option, warn_of_unused_options

if TYPE_CHECKING:
    from machopt.data_types.documents.identification_document import IdentificationDocument

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the three commands to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    cell = argparse.ArgumentParser(add_help=False)
    add_shared_option(cell, "cell")
    add_shared_option(cell, "--out")
    add_shared_option(cell, "--force")
    add_shared_option(cell, "--allow-external")
    add_shared_option(cell, "--seed")
    add_shared_option(cell, "--jobs")
    add_shared_option(cell, "--tables")
    parents = [common, cell]
    _add_identify(
        commands.add_parser("identify", parents=parents, help="joint stiffness from load–deflection readings")
    )
    _add_poses(commands.add_parser("plan-poses", parents=parents, help="which poses and loads to measure"))
    _add_map(commands.add_parser("map", parents=parents, help="stiffness and dexterity over places and postures"))


def _add_identify(p: argparse.ArgumentParser) -> None:
    p.add_argument("recording", type=Path, nargs="+", help="recording folders (sessions of the same robot)")
    p.add_argument(
        "--model",
        choices=("auto", "constant", "grid"),
        default="auto",
        help="auto takes a stiffness per grid cell only where it predicts unseen poses clearly better",
    )
    p.add_argument("--grid-cell-mm", type=float, default=300.0, help="edge of a grid cell (300)")
    p.add_argument("--grid-origin-mm", type=_parse_floats, metavar="X,Y,Z", help="lowest corner in base_link")
    p.add_argument("--grid-shape", type=_parse_integers, metavar="NX,NY,NZ", help="cells along x, y, z")
    p.add_argument(
        "--fit",
        action="append",
        default=[],
        metavar="EFFECT@LOCATION",
        help="physics to fit beside the joints, e.g. link_compliance@link:4; parameters in braces",
    )
    p.add_argument(
        "--geometric",
        action="store_true",
        help="at the loaded equilibrium with the arm's weight (dumas2011 eqs. 6–10), and K_C in stiffness.yaml; "
        "without it, K_C of the load alone is counted where it matters",
    )
    p.add_argument("--plain", action="store_true", help="unweighted least squares of dumas2011 eq. 26")
    p.add_argument("--keep-outliers", action="store_true", help="no reading is put aside")
    p.add_argument("--level", type=float, default=90.0, metavar="PERCENT", help="of the intervals (90)")
    p.add_argument("--no-studies", action="store_true", help="leave out subsets and repeated measurement errors")
    add_shared_option(p, "--accept")
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_identify)


def _run_identify(args: argparse.Namespace) -> int:
    from machopt.commands.identify.run import run_identify
    from machopt.measurement.identification.request import IdentifyRequest

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
    with ProgressDisplay(show=_is_progress_shown(args)) as display:
        done = run_identify(request, display.show_stage)
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(_format_identify_summary(done.result)))
        print(f"report: {done.report}")
    return 0


def _format_identify_summary(result: IdentificationDocument) -> list[str]:
    from machopt.data_types.documents.identification_document import MISFIT_WARNING, describe_unidentified_joint

    heldout = result.heldout_rmse_mm
    unseen = "no pose left to judge by" if heldout is None else f"{heldout:.4f} mm on unseen poses"
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
    told = {describe_unidentified_joint(j.joint, j.reason) for j in result.joints}  # beside its stiffness above
    for s in result.inseparable:
        lines.append(
            f"  joint {s.joint} and the torsion of the {s.body} are one compliance: together "
            f"{_format_number(s.sum_ci90_rad_per_Nm[0])} … {_format_number(s.sum_ci90_rad_per_Nm[1])} rad/(N·m); the "
            f"joint alone has at least {_format_number(s.joint_at_least_Nm_per_rad)} N·m/rad"
        )
    lines += [f"  note: {w}" for w in result.warnings if w not in told and w not in first]
    return lines


def _convert_null_to_nan(value: float | None) -> float:
    """Return a number of a result file; null is NaN."""
    return math.nan if value is None else value


def _add_poses(p: argparse.ArgumentParser) -> None:
    n, real = int, float
    size = p.add_argument_group("how much to measure")
    size.add_argument("--poses", type=n, default=10, help="poses to measure (10)")
    size.add_argument("--loads", type=n, default=2, help="different loads at each pose (2)")
    size.add_argument("--cycles", type=n, default=2, help="rounds over all poses (2)")
    size.add_argument("--target-percent", type=real, default=5.0, help="say how many poses bring every joint there (5)")
    size.add_argument(
        "--external",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="where a rail or positioner stands, mm or deg (at home); may be repeated",
    )
    loads = p.add_argument_group("loads")
    loads.add_argument("--weights-kg", type=_parse_floats, metavar="A,B", help="masses that can be hung")
    loads.add_argument("--pull-N", type=_parse_floats, metavar="A,B", help="forces of ropes or horizontal pulls")
    loads.add_argument("--pull-directions", type=n, default=8, help="horizontal directions without anchors (8)")
    loads.add_argument(
        "--anchors",
        type=_parse_floats,
        action="append",
        default=[],
        metavar="X,Y,Z",
        help="where a rope can be tied, world, mm; may be repeated",
    )
    loads.add_argument(
        "--arms-mm",
        type=_parse_floats,
        default=(0.0, 200.0),
        metavar="A,B",
        help="lever arms across the tool; 0 is the TCP (0,200)",
    )
    loads.add_argument("--max-load-N", type=real, help="rated load")
    loads.add_argument("--max-torque-Nm", type=_parse_floats, metavar="T1,…,T6", help="joint torque of the load alone")
    loads.add_argument("--max-deflection-mm", type=real, default=5.0, help="largest expected deflection (5)")
    loads.add_argument("--min-signal", type=real, default=5.0, help="least deflection, in sigmas of a reading (5)")
    job = p.add_argument_group(
        "the job that the arm is measured for: two sizes of each load, and joints turned both ways"
    )
    job.add_argument("--toolpath", type=Path, metavar="FILE", help="CAM export or point table, with the plan's force_N")
    job.add_argument("--force-N", type=_parse_floats, metavar="LOW,HIGH", help="least and largest process force")
    add_shared_option(job, "--set", help="override a planning option, for the plan of --toolpath")
    gauge = p.add_argument_group("measuring")
    gauge.add_argument(
        "--sensor",
        choices=("tracker", "tracker3", "dial"),
        default="tracker",
        help="laser tracker with one target, with three (rotations too), or three dial gauges",
    )
    gauge.add_argument("--displacement-mm", type=real, help="1 sigma of one coordinate (0.012, dial 0.005)")
    gauge.add_argument("--targets-mm", type=real, default=200.0, help="targets' distance from the TCP, tracker3 (200)")
    gauge.add_argument("--cycle-mm", type=real, default=0.015, help="error shared by a load cycle (0.015)")
    gauge.add_argument("--pose-mm", type=real, default=0.03, help="error shared by a pose (0.03)")
    gauge.add_argument("--force-percent", type=real, default=0.75, help="error of the load (0.75)")
    gauge.add_argument("--tracker", type=_parse_floats, metavar="X,Y,Z", help="tracker position, world, mm")
    gauge.add_argument("--tracker-range-mm", type=real, default=15000.0, help="farthest target (15000)")
    gauge.add_argument("--tracker-angle-deg", type=real, default=45.0, help="least angle of sight to the flange (45)")
    posture = p.add_argument_group("postures")
    posture.add_argument("--min-kci", type=real, default=0.1, help="least dexterity (0.1; zhang2025: 0.45)")
    posture.add_argument("--max-nu-p", type=real, default=0.05, help="most K_C may change the translation (0.05)")
    posture.add_argument("--max-nu-r-deg", type=real, default=0.05, help="most K_C may change a rotation (0.05)")
    posture.add_argument("--clearance-mm", type=real, default=20.0, help="to everything (20)")
    posture.add_argument("--limit-margin-deg", type=real, default=5.0, help="to joint limits (5)")
    posture.add_argument("--floor-mm", type=real, default=300.0, help="least height of the TCP in world (300)")
    posture.add_argument("--ceiling-mm", type=real, default=2500.0, help="greatest height of the TCP in world (2500)")
    posture.add_argument(
        "--box-mm", type=_parse_floats, metavar="X0,Y0,Z0,X1,Y1,Z1", help="where the TCP may be, world"
    )
    posture.add_argument("--without-workpiece", action="store_true", help="the workpiece is not there")
    posture.add_argument("--no-collision", action="store_true", help="do not check collisions")
    search = p.add_argument_group("search")
    search.add_argument(
        "--fit", dest="terms", action="append", default=[], metavar="EFFECT@LOCATION", help="terms to identify too"
    )
    search.add_argument("--terms", action="append", help=argparse.SUPPRESS)  # its name in 0.1
    search.add_argument(
        "--discriminate",
        type=Path,
        metavar="OUT_OF_DIAGNOSE",
        help="tell apart what this diagnosis could not; as many poses and rounds as that takes, and as asked for",
    )
    search.add_argument("--prior", type=_parse_floats, metavar="K1,…,K6", help="rough stiffness, N·m/rad (the cell's)")
    search.add_argument("--prior-factor", type=real, default=1.0, help="the prior may be wrong by this factor (1)")
    search.add_argument("--candidates", type=n, default=2000, help="poses to choose from (2000)")
    search.add_argument("--starts", type=n, default=2, help="starts of the search (2)")
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_plan_poses)


def _run_plan_poses(args: argparse.Namespace) -> int:
    from machopt.commands.plan_poses.run import PosesRequest, run_plan_poses

    warn_of_effect_code(args)
    if args.toolpath is None:
        warn_of_unused_options(args.set, "nothing is planned without --toolpath", quiet=args.quiet)
    renamed = {"anchors": "anchors_mm", "tracker": "tracker_mm", "prior": "prior_Nm_per_rad", "set": "overrides"}
    return _run_service(args, PosesRequest, run_plan_poses, renamed)


def _add_map(p: argparse.ArgumentParser) -> None:
    where = p.add_argument_group("where")
    where.add_argument("--slice", choices=("xy", "xz", "yz"), help="a plane of the frame (default xz)")
    where.add_argument("--at", type=float, metavar="MM", help="where the slice lies on its normal (0)")
    where.add_argument("--volume", action="store_true", help="a box instead of a slice")
    where.add_argument("--joints", metavar="A[,B]", help="one or two joints varied, the others fixed")
    where.add_argument("--q", help="with --joints: six degrees, or a4=45,a5=45; the rest at home")
    where.add_argument("--line", metavar="X,Y,Z:X,Y,Z", help="straight path of the TCP, mm, the tool not turning")
    where.add_argument(
        "--range",
        action="append",
        default=[],
        dest="ranges",
        metavar="AXIS=LOW:HIGH",
        help="mm or degrees; default what the arm reaches, or the joint limits",
    )
    where.add_argument(
        "--step",
        action="append",
        default=[],
        dest="steps",
        metavar="[AXIS=]STEP",
        help="mm or degrees; default a step for a map of seconds",
    )
    where.add_argument("--frame", choices=("base", "world", "workpiece"), default="base", help="of places and axes")
    tool = p.add_argument_group("posture")
    tool.add_argument("--tool-axis", default="0,0,1", metavar="I,J,K", help="tip to shank (0,0,1: tool points down)")
    tool.add_argument("--gamma", type=float, default=0.0, metavar="DEG", help="given rotation about the tool axis (0)")
    tool.add_argument("--rotation-step", type=float, default=20.0, metavar="DEG", help="rotations tried (20)")
    tool.add_argument("--fixed-rotation", action="store_true", help="only the given rotation")
    tool.add_argument("--pick", default="best", help="branch: best, worst, home or a number (best)")
    tool.add_argument("--by", metavar="FIELD", help="what best means (deflection under a load, else k_min)")
    tool.add_argument("--collision", choices=("none", "self", "cell"), default="self", help="what may not touch (self)")
    load = p.add_argument_group("quantities")
    load.add_argument(
        "--load-N", dest="force", metavar="FX,FY,FZ", help="force on the tool in N, for deflection and K_C"
    )
    load.add_argument("--wrench", metavar="FX,…,MZ", help="load in N and N·m")
    load.add_argument("--load-axes", choices=("frame", "tool"), default="frame", help="of the load (frame)")
    load.add_argument("--length", type=float, metavar="MM", help="characteristic length (computed)")
    load.add_argument("--measured", type=Path, metavar="FILE", help="measured stiffness, shown beside the model")
    load.add_argument("--power", type=float, default=2.0, help="of inverse distance weighting (2)")
    load.add_argument("--neighbours", type=int, help="of inverse distance weighting (all)")
    add_shared_option(p, "--plan", dest="plan_file")
    add_shared_option(p, "--set", dest="overrides")
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_map)


def _run_map(args: argparse.Namespace) -> int:
    from machopt.commands.map.run import MapRequest, run_map

    warn_of_effect_code(args)
    return _run_service(args, MapRequest, run_map, {})


def _run_service(args: argparse.Namespace, request: Any, run: Any, renamed: dict[str, str]) -> int:
    """Commands whose request has a field for every option."""
    from dataclasses import fields

    known = {f.name for f in fields(request)}
    given = {renamed.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in vars(args).items()}
    with ProgressDisplay(show=_is_progress_shown(args)) as display:
        done = run(request(**{k: v for k, v in given.items() if k in known}), display.show_stage)
    if args.json:
        print_result(done.result)
    notes = [f"  note: {w}" for w in done.result.warnings if w != done.message]
    if done.exit_code != 0:
        print(f"machopt: {done.message} (report: {done.report})", file=sys.stderr)
        print("\n".join(notes), end="\n" if notes else "", file=sys.stderr)  # often the cause
    elif not (args.quiet or args.json):
        print("\n".join([done.message, *notes, f"report: {done.report}"]))
    return int(done.exit_code)


def _is_progress_shown(args: argparse.Namespace) -> bool:
    return not (args.quiet or args.json)


def _format_count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _format_number(value: float | None) -> str:
    return "∞" if value is None else f"{value:.4g}"


def _parse_floats(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(v) for v in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers like 1,2,3") from None


def _parse_integers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(v) for v in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of whole numbers like 1,2,3") from None

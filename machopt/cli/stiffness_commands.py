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
    _add_identify(commands.add_parser("identify", parents=parents, help="identify joint stiffness from load tests"))
    _add_poses(commands.add_parser("plan-poses", parents=parents, help="choose poses and loads for a measurement"))
    _add_map(
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
        type=_parse_floats,
        metavar="X,Y,Z",
        help="corner of the grid with the smallest coordinates, in base_link",
    )
    p.add_argument(
        "--grid-shape", type=_parse_integers, metavar="NX,NY,NZ", help="number of grid cells along x, y and z"
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
    from machopt.data_types.documents.identification_document import describe_unidentified_joint

    heldout = result.heldout_rmse_mm
    unseen = "no pose left to judge by" if heldout is None else f"{heldout:.4f} mm on unseen poses"
    lines = [
        f"{result.readings} readings, {_format_count(result.poses, 'pose')}, {result.model} model: "
        f"{_convert_null_to_nan(result.rmse_mm):.4f} mm a coordinate, {unseen}, "
        f"{100 * _convert_null_to_nan(result.explained_share):.1f} % explained"
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
    lines += [f"  note: {w}" for w in result.warnings if w not in told]
    return lines


def _convert_null_to_nan(value: float | None) -> float:
    """Return a number of a result file; null is NaN."""
    return math.nan if value is None else value


def _add_poses(p: argparse.ArgumentParser) -> None:
    n, real = int, float
    size = p.add_argument_group("how much to measure")
    size.add_argument("--poses", type=n, default=10, help="number of poses (default: 10)")
    size.add_argument("--loads", type=n, default=2, help="number of different loads at each pose (default: 2)")
    size.add_argument("--cycles", type=n, default=2, help="number of repetitions of all poses and loads (default: 2)")
    size.add_argument(
        "--target-percent",
        type=real,
        default=5.0,
        help="report how many poses give every joint stiffness this standard deviation, percent (default: 5)",
    )
    size.add_argument(
        "--external",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a rail or positioner joint, mm or deg (default: home); may be repeated",
    )
    loads = p.add_argument_group("loads")
    loads.add_argument("--weights-kg", type=_parse_floats, metavar="A,B", help="available weights, kg")
    loads.add_argument("--pull-N", type=_parse_floats, metavar="A,B", help="available pulling forces, N")
    loads.add_argument(
        "--pull-directions",
        type=n,
        default=8,
        help="number of horizontal pulling directions where no anchors are given (default: 8)",
    )
    loads.add_argument(
        "--anchors",
        type=_parse_floats,
        action="append",
        default=[],
        metavar="X,Y,Z",
        help="point to which a rope can be tied, in world, mm; may be repeated",
    )
    loads.add_argument(
        "--arms-mm",
        type=_parse_floats,
        default=(0.0, 200.0),
        metavar="A,B",
        help="lever arms of the load across the tool axis, mm; 0 is the TCP (default: 0,200)",
    )
    loads.add_argument("--max-load-N", type=real, help="largest load, N (default: no limit)")
    loads.add_argument(
        "--max-torque-Nm", type=_parse_floats, metavar="T1,…,T6", help="largest joint torques due to the load alone"
    )
    loads.add_argument("--max-deflection-mm", type=real, default=5.0, help="largest expected deflection (default: 5)")
    loads.add_argument(
        "--min-signal",
        type=real,
        default=5.0,
        help="smallest expected deflection, in standard deviations of a reading (default: 5)",
    )
    job = p.add_argument_group("the job that the robot is measured for")
    job.add_argument(
        "--toolpath", type=Path, metavar="FILE", help="toolpath of the job; its loads are those of force_N"
    )
    job.add_argument(
        "--force-N",
        type=_parse_floats,
        metavar="LOW,HIGH",
        help="smallest and largest process force, N; each load is then measured at two sizes",
    )
    add_shared_option(job, "--set", help="set a planning option for the plan of --toolpath; may be repeated")
    gauge = p.add_argument_group("instrument")
    gauge.add_argument(
        "--sensor",
        choices=("tracker", "tracker3", "dial"),
        default="tracker",
        help="laser tracker with one target (default) or with three targets (measures rotations too), or three dial "
        "gauges",
    )
    gauge.add_argument(
        "--displacement-mm", type=real, help="standard deviation of one coordinate (default: 0.012, dial gauge 0.005)"
    )
    gauge.add_argument(
        "--targets-mm", type=real, default=200.0, help="distance of the three targets from the TCP (default: 200)"
    )
    gauge.add_argument(
        "--cycle-mm",
        type=real,
        default=0.015,
        help="standard deviation of the error common to a load cycle (default: 0.015)",
    )
    gauge.add_argument(
        "--pose-mm", type=real, default=0.03, help="standard deviation of the error common to a pose (default: 0.03)"
    )
    gauge.add_argument(
        "--force-percent", type=real, default=0.75, help="standard deviation of the load (default: 0.75)"
    )
    gauge.add_argument("--tracker", type=_parse_floats, metavar="X,Y,Z", help="position of the tracker in world, mm")
    gauge.add_argument(
        "--tracker-range-mm",
        type=real,
        default=15000.0,
        help="largest distance of a target from the tracker (default: 15000)",
    )
    gauge.add_argument(
        "--tracker-angle-deg",
        type=real,
        default=45.0,
        help="smallest angle between line of sight and flange (default: 45)",
    )
    posture = p.add_argument_group("postures")
    posture.add_argument(
        "--min-kci", type=real, default=0.1, help="smallest dexterity index (default: 0.1; zhang2025 uses 0.45)"
    )
    posture.add_argument(
        "--max-nu-p",
        type=real,
        default=0.05,
        help="largest relative change of the translation due to K_C (default: 0.05)",
    )
    posture.add_argument(
        "--max-nu-r-deg", type=real, default=0.05, help="largest change of a rotation due to K_C (default: 0.05)"
    )
    posture.add_argument(
        "--clearance-mm", type=real, default=20.0, help="smallest clearance to all bodies (default: 20)"
    )
    posture.add_argument(
        "--limit-margin-deg", type=real, default=5.0, help="smallest distance from a joint limit (default: 5)"
    )
    posture.add_argument(
        "--floor-mm", type=real, default=300.0, help="smallest height of the TCP in world (default: 300)"
    )
    posture.add_argument(
        "--ceiling-mm", type=real, default=2500.0, help="largest height of the TCP in world (default: 2500)"
    )
    posture.add_argument(
        "--box-mm", type=_parse_floats, metavar="X0,Y0,Z0,X1,Y1,Z1", help="box in world that must contain the TCP"
    )
    posture.add_argument("--without-workpiece", action="store_true", help="plan without the workpiece")
    posture.add_argument("--no-collision", action="store_true", help="skip the collision check")
    search = p.add_argument_group("search")
    search.add_argument(
        "--fit",
        dest="terms",
        action="append",
        default=[],
        metavar="EFFECT@LOCATION",
        help="effect that the measurement shall also identify",
    )
    search.add_argument("--terms", action="append", help=argparse.SUPPRESS)  # its name in 0.1
    search.add_argument(
        "--discriminate",
        type=Path,
        metavar="OUT_OF_DIAGNOSE",
        help="output folder of diagnose: measure so that the explanations it left open can be separated",
    )
    search.add_argument(
        "--prior",
        type=_parse_floats,
        metavar="K1,…,K6",
        help="approximate joint stiffness, N·m/rad (default: that of the cell)",
    )
    search.add_argument(
        "--prior-factor",
        type=real,
        default=1.0,
        help="factor by which the approximate stiffness may be wrong (default: 1)",
    )
    search.add_argument("--candidates", type=n, default=2000, help="number of candidate poses (default: 2000)")
    search.add_argument("--starts", type=n, default=2, help="number of random starts of the search (default: 2)")
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
    where.add_argument("--slice", choices=("xy", "xz", "yz"), help="plane of the map (default: xz)")
    where.add_argument("--at", type=float, metavar="MM", help="position of the plane along its normal (default: 0)")
    where.add_argument("--volume", action="store_true", help="map a box instead of a plane")
    where.add_argument("--joints", metavar="A[,B]", help="vary one or two joints and keep the others fixed")
    where.add_argument(
        "--q", help="joint values of --joints in degrees: six numbers, or a4=45,a5=45 with the others at home"
    )
    where.add_argument(
        "--line", metavar="X,Y,Z:X,Y,Z", help="straight line of the TCP, mm, with a constant tool orientation"
    )
    where.add_argument(
        "--range",
        action="append",
        default=[],
        dest="ranges",
        metavar="AXIS=LOW:HIGH",
        help="range of an axis, mm or degrees (default: the reach, or the joint limits)",
    )
    where.add_argument(
        "--step",
        action="append",
        default=[],
        dest="steps",
        metavar="[AXIS=]STEP",
        help="grid step, mm or degrees (default: chosen for a computing time of seconds)",
    )
    where.add_argument(
        "--frame",
        choices=("base", "world", "workpiece"),
        default="base",
        help="frame of positions and axes (default: base)",
    )
    tool = p.add_argument_group("posture")
    tool.add_argument(
        "--tool-axis",
        default="0,0,1",
        metavar="I,J,K",
        help="direction from tool tip to shank (default: 0,0,1, the tool points down)",
    )
    tool.add_argument(
        "--gamma", type=float, default=0.0, metavar="DEG", help="redundancy angle about the tool axis (default: 0)"
    )
    tool.add_argument(
        "--rotation-step",
        type=float,
        default=20.0,
        metavar="DEG",
        help="step between the redundancy angles that are tried (default: 20)",
    )
    tool.add_argument("--fixed-rotation", action="store_true", help="use only the angle of --gamma")
    tool.add_argument(
        "--pick", default="best", help="branch of the inverse kinematics: best, worst, home or a number (default: best)"
    )
    tool.add_argument(
        "--by",
        metavar="FIELD",
        help="field of the map that defines the best branch (default: deflection with a load, else k_min)",
    )
    tool.add_argument(
        "--collision",
        choices=("none", "self", "cell"),
        default="self",
        help="collisions that are checked: none, self (robot and tool), cell (all bodies) (default: self)",
    )
    load = p.add_argument_group("quantities")
    load.add_argument("--load-N", dest="force", metavar="FX,FY,FZ", help="force on the tool, for deflection and K_C")
    load.add_argument("--wrench", metavar="FX,…,MZ", help="force and moment on the tool, N and N·m")
    load.add_argument(
        "--load-axes",
        choices=("frame", "tool"),
        default="frame",
        help="axes in which the load is given (default: frame)",
    )
    load.add_argument("--length", type=float, metavar="MM", help="characteristic length (default: computed)")
    load.add_argument(
        "--measured", type=Path, metavar="FILE", help="table of measured stiffness, compared with the model"
    )
    load.add_argument("--power", type=float, default=2.0, help="power of the inverse distance weighting (default: 2)")
    load.add_argument(
        "--neighbours", type=int, help="number of neighbours of the inverse distance weighting (default: all)"
    )
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

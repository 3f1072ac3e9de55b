"""The command ``place``: the best placement of workpiece or robot."""

from __future__ import annotations

import argparse
import sys
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.compilation_notice import announce_compilation
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.progress_display import ProgressDisplay, parse_positive_integer, print_result
from machopt.cli.reading_options import build_reading_parser, convert_reading_options
from machopt.cli.shared_options import add_shared_option

if TYPE_CHECKING:
    from machopt.data_types.documents.place_document import PlaceDocument

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    job = commands.add_parser(
        "place",
        parents=[common, build_reading_parser()],
        help="find the position of workpiece or robot with the smallest worst-case deflection over all toolpaths",
    )
    add_shared_option(job, "cell")
    job.add_argument(
        "toolpaths", nargs="+", type=Path, metavar="TOOLPATH", help="CAM files or point tables, one job each"
    )
    add_shared_option(job, "--out", help="output folder; the same command continues an interrupted search")
    add_shared_option(job, "--force")
    _add_range_options(job)
    _add_budget_options(job)
    _add_moved_body_options(job)
    add_shared_option(job, "--plan")
    add_shared_option(job, "--set")
    add_shared_option(job, "--process")
    add_shared_option(
        job, "--seed", type=int, default=None, help="seed of the random search around obstacles (default: 0)"
    )
    add_shared_option(job, "--tables")
    add_shared_option(
        job,
        "--post",
        help="robot program for the best positions (default: controller.post of the cell); may be repeated",
    )
    add_shared_option(job, "--effects")
    job.set_defaults(run=_run_place)


def _add_range_options(job: argparse.ArgumentParser) -> None:
    for name, reach, what in (
        ("x-mm", 300, "shift along x in world"),
        ("y-mm", 300, "shift along y in world"),
        ("z-mm", 0, "shift along z in world"),
        ("turn-deg", 0, "rotation about the vertical axis through the centre of the toolpaths, or through base_link"),
    ):
        text = f"{what}, smallest and largest (default: {-reach} {reach})"
        default, ends = [-reach, reach], ("FROM", "TO")
        job.add_argument(f"--{name}", type=float, nargs=2, default=default, metavar=ends, help=text)


def _add_budget_options(job: argparse.ArgumentParser) -> None:
    job.add_argument(
        "--places",
        type=parse_positive_integer,
        default=200,
        metavar="N",
        help="largest number of positions to evaluate (default: 200)",
    )
    job.add_argument(
        "--best",
        type=parse_positive_integer,
        default=3,
        metavar="N",
        help="number of positions to plan, verify and write (default: 3)",
    )
    job.add_argument(
        "--plans",
        type=parse_positive_integer,
        default=40,
        metavar="N",
        help="largest number of positions with a full plan (default: 40)",
    )
    job.add_argument(
        "--minutes",
        type=float,
        default=10.0,
        metavar="MIN",
        help="start no further position after this time (default: 10)",
    )
    job.add_argument(
        "--jobs",
        type=parse_positive_integer,
        metavar="N",
        help="number of worker processes (default: one for each core)",
    )
    job.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a running Dask scheduler, e.g. tcp://10.0.0.5:8786"
    )


def _add_moved_body_options(job: argparse.ArgumentParser) -> None:
    job.add_argument(
        "--move", choices=("workpiece", "base"), default="workpiece", help="what is moved (default: workpiece)"
    )
    job.add_argument(
        "--carry",
        action="append",
        metavar="OBSTACLE",
        help="obstacle that moves with the workpiece or robot (default: those that hold it); may be repeated",
    )
    job.add_argument(
        "--stay",
        action="append",
        default=[],
        metavar="OBSTACLE",
        help="obstacle that does not move although it holds the workpiece or robot; may be repeated",
    )


def _run_place(args: argparse.Namespace) -> int:
    from machopt.batch.placement_workers import open_placement_workers
    from machopt.commands.place.run import PlaceRequest, run_place
    from machopt.numerics.parallel_map import count_threads
    from machopt.placement.search_options import PlacementOptions

    warn_of_effect_code(args)
    x, y, z = ((a / 1e3, b / 1e3) for a, b in (args.x_mm, args.y_mm, args.z_mm))
    there = Path.absolute if args.scheduler else Path  # a worker of a cluster has another working directory
    request = PlaceRequest(
        cell=there(args.cell),
        toolpaths=tuple(there(f) for f in args.toolpaths),
        out=there(args.out),
        overwrite=args.overwrite,
        search=PlacementOptions(
            x=x,
            y=y,
            z=z,
            turn=(radians(args.turn_deg[0]), radians(args.turn_deg[1])),
            places=args.places,
            base=args.move == "base",
            carry=None if args.carry is None else tuple(args.carry),
            stay=tuple(args.stay),
            best=args.best,
            plans=args.plans,
            seconds=60 * args.minutes,
        ),
        plan_file=args.plan and there(args.plan),
        process=args.process and there(args.process),
        overrides=(*args.set, *(() if args.seed is None else (f"seed={args.seed}",))),
        readings=(convert_reading_options(args),) * len(args.toolpaths),
        posts=tuple(str(there(Path(p))) if Path(p).is_file() else p for p in args.post),
        effects=tuple(there(f) for f in args.effects),
        tables=args.tables,
    )
    jobs = args.jobs or count_threads()
    try:
        with (
            ProgressDisplay(show=not (args.quiet or args.json)) as display,
            announce_compilation(display),
            open_placement_workers(request, jobs=jobs, scheduler=args.scheduler) as hands,
        ):
            outcome = run_place(request, display.show_stage, hands)
    except KeyboardInterrupt:
        print("machopt: stopped; what was found is kept, the same command goes on", file=sys.stderr)
        return 130
    if args.json:
        print_result(outcome.result)
    elif not args.quiet:
        print("\n".join(_format_place_summary(outcome.result)))
        print(f"report: {outcome.report}")
    if outcome.exit_code:
        print(f"machopt: {outcome.result.verdict}", file=sys.stderr)
    return outcome.exit_code


def _format_place_summary(r: PlaceDocument) -> list[str]:
    lines = [r.verdict]
    if r.carried:
        lines.append(f"  {r.moved} moved with {', '.join(r.carried)}")
    for k, p in enumerate(r.best, 1):
        x, y, z = p.shift_mm
        gain = "" if p.gain_percent is None else f", {p.gain_percent:.1f} % less than at the present position"
        lines.append(
            f"  {k}: x {x:+.0f}, y {y:+.0f}, z {z:+.0f} mm, turn {p.turn_deg:+.1f}°: worst {p.worst:.4g} {r.unit}"
            f"{gain}; {p.folder}/"
        )
        if (t := p.tolerances) is not None:
            error = "" if t.worst_error_mm is None else f": {t.worst_error_mm:.3f} mm"
            lines.append(
                f"     {t.in_tolerance} in tolerance, {t.marginal} marginal, {t.fail} fail, {t.unknown} unknown; worst "
                f"point {t.worst_error_point} of {t.worst_error_toolpath}{error}"
            )
        lines.append(f"     {'robot' if r.moved == 'base_link' else 'workpiece'}.pose: {p.pose_text}")
    return [*lines, *(f"  note: {w}" for w in r.warnings[:6])]

"""The command ``place``: where to put the workpiece, or the robot."""

from __future__ import annotations

import argparse
import sys
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machopt.cli.compiling import compiling
from machopt.cli.display import Display, positive, print_result
from machopt.cli.effects import told_of_effects
from machopt.cli.readingoptions import reading, reading_parser
from machopt.cli.shared import share

if TYPE_CHECKING:
    from machopt.domain.results.place import PlaceResult

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    job = commands.add_parser(
        "place",
        parents=[common, reading_parser()],
        help="where to put the workpiece (or the robot) so that the worst index over all toolpaths is best",
    )
    share(job, "cell")
    job.add_argument(
        "toolpaths", nargs="+", type=Path, metavar="TOOLPATH", help="CAM exports or point tables, one job each"
    )
    share(job, "--out", help="output folder; the same command goes on where it was stopped")
    share(job, "--force")
    for name, reach, what in (
        ("x-mm", 300, "shift along x of world"),
        ("y-mm", 300, "shift along y of world"),
        ("z-mm", 0, "shift along z of world"),
        ("turn-deg", 0, "turn about the vertical through the middle of the toolpaths, or through base_link"),
    ):
        told = f"{what}, least and greatest ({-reach} {reach})"
        default, ends = [-reach, reach], ("FROM", "TO")
        job.add_argument(f"--{name}", type=float, nargs=2, default=default, metavar=ends, help=told)
    job.add_argument("--places", type=positive, default=200, metavar="N", help="places to look at, at most (200)")
    job.add_argument("--best", type=positive, default=3, metavar="N", help="places written as whole verified plans (3)")
    job.add_argument("--plans", type=positive, default=40, metavar="N", help="places to plan wholly, at most (40)")
    job.add_argument("--minutes", type=float, default=10.0, metavar="MIN", help="begin no place after that (10)")
    job.add_argument("--jobs", type=positive, metavar="N", help="places at a time on this machine (one a core)")
    job.add_argument(
        "--scheduler", metavar="ADDRESS", help="use the workers of a running Dask scheduler, e.g. tcp://10.0.0.5:8786"
    )
    job.add_argument("--move", choices=("workpiece", "base"), default="workpiece", help="what moves (workpiece)")
    job.add_argument(
        "--carry",
        action="append",
        metavar="OBSTACLE",
        help="obstacle that moves along; may be repeated (those that hold the workpiece, or the robot)",
    )
    job.add_argument(
        "--stay", action="append", default=[], metavar="OBSTACLE", help="obstacle that stays though it holds what moves"
    )
    share(job, "--plan")
    share(job, "--set")
    share(job, "--seed", type=int, default=None, help="of the random search around obstacles, at all places")
    share(job, "--tables")
    share(job, "--post", help="robot program for the best places; may be repeated (the cell's controller.post)")
    share(job, "--effects")
    job.set_defaults(run=_place)


def _place(args: argparse.Namespace) -> int:
    from machopt.batch.crew import crew
    from machopt.model.threads import cores
    from machopt.placement.asked import Search
    from machopt.services.place import PlaceRequest, place

    told_of_effects(args)
    x, y, z = ((a / 1e3, b / 1e3) for a, b in (args.x_mm, args.y_mm, args.z_mm))
    there = Path.absolute if args.scheduler else Path  # a worker of a cluster stands in a folder of its own
    request = PlaceRequest(
        cell=there(args.cell),
        toolpaths=tuple(there(f) for f in args.toolpaths),
        out=there(args.out),
        overwrite=args.overwrite,
        search=Search(
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
        overrides=(*args.set, *(() if args.seed is None else (f"seed={args.seed}",))),
        readings=(reading(args),) * len(args.toolpaths),
        posts=tuple(str(there(Path(p))) if Path(p).is_file() else p for p in args.post),
        effects=tuple(there(f) for f in args.effects),
        tables=args.tables,
    )
    jobs = args.jobs or cores()
    try:
        with (
            Display(show=not (args.quiet or args.json)) as display,
            compiling(display),
            crew(request, jobs=jobs, scheduler=args.scheduler) as hands,
        ):
            outcome = place(request, display.stage, hands)
    except KeyboardInterrupt:
        print("machopt: stopped; what was found is kept, the same command goes on", file=sys.stderr)
        return 130
    if args.json:
        print_result(outcome.result)
    elif not args.quiet:
        print("\n".join(_summary(outcome.result)))
        print(f"report: {outcome.report}")
    if outcome.exit_code:
        print(f"machopt: {outcome.result.verdict}", file=sys.stderr)
    return outcome.exit_code


def _summary(r: PlaceResult) -> list[str]:
    lines = [r.verdict]
    if r.carried:
        lines.append(f"  {r.moved} moved with {', '.join(r.carried)}")
    for k, p in enumerate(r.best, 1):
        x, y, z = p.shift_mm
        gain = "" if p.gain_percent is None else f", {p.gain_percent:.1f} % less than as it stands"
        lines.append(
            f"  {k}: x {x:+.0f}, y {y:+.0f}, z {z:+.0f} mm, turn {p.turn_deg:+.1f}°: worst {p.worst:.4g} {r.unit}"
            f"{gain}; {p.folder}/"
        )
        lines.append(f"     {'robot' if r.moved == 'base_link' else 'workpiece'}.pose: {p.pose_text}")
    return [*lines, *(f"  note: {w}" for w in r.warnings[:6])]

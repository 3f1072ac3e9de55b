"""The commands ``optimize``, ``inspect`` and ``verify`` for toolpaths."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from machopt.cli import garbage_collection
from machopt.cli.argument_errors import OptionParser
from machopt.cli.check_lines import format_check_line, format_failed_verification, format_information_line
from machopt.cli.compilation_notice import announce_compilation
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.optimize_summary import format_first_infeasibility, format_optimize_summary
from machopt.cli.progress_display import ProgressDisplay, format_as_tree, print_result
from machopt.cli.reading_options import build_reading_parser, convert_reading_options, refuse_reading_options
from machopt.cli.shared_options import add_shared_option
from machopt.errors import OptionError, VerificationError

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the commands to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    planning = OptionParser(add_help=False)
    add_shared_option(planning, "--plan")
    add_shared_option(planning, "--set")
    add_shared_option(planning, "--allow-external")

    _add_optimize(commands, common, planning)
    _add_inspect(commands, common)
    _add_verify(commands, common, planning)


def _add_optimize(commands: Commands, common: argparse.ArgumentParser, planning: argparse.ArgumentParser) -> None:
    job = commands.add_parser(
        "optimize",
        parents=[common, build_reading_parser(), planning],
        help="plan the robot motion of a toolpath with the smallest deflection",
    )
    add_shared_option(job, "cell")
    add_shared_option(job, "toolpath")
    add_shared_option(job, "--out")
    add_shared_option(job, "--force")
    job.add_argument(
        "--method",
        choices=("global", "joint", "jiao2022", "default"),
        help="global: shortest path over all configurations (default); joint: after it, rotation and feed together for "
        "the shortest time within the tolerances of process.yaml; jiao2022: greedy choice of that paper; default: "
        "the rotation of the CAM file",
    )
    job.add_argument(
        "--index",
        choices=("auto", "deflection", "stiffness", "jiao2022"),
        help="quantity to minimise: deflection under force_N, or compliance along the tool axis and across it "
        "(default: auto, deflection where force_N is given)",
    )
    job.add_argument(
        "--objective",
        choices=("index", "tolerance"),
        help="tolerance: fewest points out of the tolerances of process.yaml first, then the index (default: index)",
    )
    job.add_argument(
        "--allow-gaps", action="store_true", default=None, help="plan the remaining points where some are unreachable"
    )
    job.add_argument(
        "--max-reentries",
        type=int,
        metavar="N",
        help="lift the tool at most N times inside of closed contours, to enter again in another posture; each lift "
        "leaves a mark (default: 0)",
    )
    job.add_argument(
        "--compensate",
        action="store_true",
        default=None,
        help="shift the commanded path by the deflection predicted under force_N, in the opposite direction",
    )
    _add_result_options(job)
    add_shared_option(job, "--seed", default=None, help="seed of the random search around obstacles (default: 0)")
    add_shared_option(job, "--jobs")
    add_shared_option(job, "--effects")
    add_shared_option(job, "--process")
    job.set_defaults(run=_run_optimize)


def _add_result_options(job: argparse.ArgumentParser) -> None:
    add_shared_option(
        job,
        "--post",
        help="robot program to write: krl, rapid, fanuc, urscript, val3, jbi, csv, json, ros, … or a template file "
        "(default: controller.post of the cell, else none); may be repeated",
    )
    add_shared_option(job, "--program-tolerance-mm")
    job.add_argument(
        "--map-collisions",
        choices=("chosen", "full"),
        default="chosen",
        help="configurations whose collisions the map of the report shows: those that the search checked (chosen, "
        "default), or all of them (full, at most 30 s more)",
    )
    job.add_argument(
        "--front",
        action="store_true",
        help="also compute up to five plans with other weights and clearances, to compare stiffness with cycle time, "
        "joint travel and clearance (front.csv and a section of the report)",
    )
    add_shared_option(job, "--tables")
    job.add_argument("--sample-ms", type=float, help="time between the samples of trajectory.csv, ms (default: 12)")


def _add_inspect(commands: Commands, common: argparse.ArgumentParser) -> None:
    look = commands.add_parser(
        "inspect",
        parents=[common, build_reading_parser()],
        help="list the content of a CAM file (points, operations, feeds, unknown words) or of a cell or robot (joints, "
        "limits, mounting, ignored collision pairs)",
    )
    look.add_argument("file", type=Path, help="toolpath file, cell folder, URDF or xacro file")
    look.add_argument("--html", type=Path, metavar="OUT.html", help="write a page with pictures of the toolpath")
    add_shared_option(look, "--force")
    look.add_argument(
        "--cell",
        type=Path,
        help="cell whose robot the program was written for; needed for programs with joint positions",
    )
    add_shared_option(look, "--allow-external")
    add_shared_option(look, "--package")
    add_shared_option(look, "--xacro-arg")
    add_shared_option(look, "--effects")
    look.set_defaults(run=_run_inspect)


def _add_verify(commands: Commands, common: argparse.ArgumentParser, planning: argparse.ArgumentParser) -> None:
    check = commands.add_parser(
        "verify",
        parents=[common, build_reading_parser(), planning],
        help="check an output folder of optimize with independent code",
    )
    add_shared_option(check, "cell")
    add_shared_option(check, "toolpath")
    check.add_argument("out", type=Path, help="output folder of optimize")
    add_shared_option(check, "--effects")
    add_shared_option(check, "--process")
    check.set_defaults(run=_run_verify)


def _run_optimize(args: argparse.Namespace) -> int:
    from machopt.commands.optimize.request import OptimizeRequest
    from machopt.commands.optimize.run import run_optimize

    garbage_collection.freeze_loaded_objects()
    direct = {
        "method": args.method,
        "index": args.index,
        "objective": args.objective,
        "allow_gaps": args.allow_gaps,
        "max_reentries": args.max_reentries,
        "compensate": args.compensate,
        "sample_ms": args.sample_ms,
        "seed": args.seed,
    }
    request = OptimizeRequest(
        cell=args.cell,
        toolpath=args.toolpath,
        out=args.out,
        overwrite=args.overwrite,
        plan_file=args.plan,
        overrides=tuple(args.set),
        direct=direct,
        reading=convert_reading_options(args),
        allow_external=args.allow_external,
        posts=tuple(args.post),
        program_tolerance_mm=args.program_tolerance_mm,
        front=args.front,
        tables=args.tables,
        map_all=args.map_collisions == "full",
        effects=tuple(args.effects),
        process=args.process,
    )
    warn_of_effect_code(args)
    with ProgressDisplay(show=not (args.quiet or args.json)) as display, announce_compilation(display):
        outcome = run_optimize(request, display.show_stage)
    if args.json:
        print_result(outcome.result)
    elif not args.quiet:
        for line in format_optimize_summary(outcome.result, outcome.report):
            print(line)
    if outcome.exit_code == 3:
        reason = " ".join(filter(None, (outcome.conflict, format_first_infeasibility(outcome.result))))
        print(f"machopt: no feasible answer; {reason} ({outcome.report} lists every point)", file=sys.stderr)
        # often the cause: a frame in metres, a body that is missing
        warnings = [warning for warning in outcome.result.warnings if warning != outcome.conflict]
        for warning in warnings[:3]:
            print(f"  note: {warning}", file=sys.stderr)
    elif outcome.exit_code == VerificationError.exit_code:
        print(f"machopt: verification failed: {format_failed_verification(outcome.result)}", file=sys.stderr)
    return outcome.exit_code


def _run_inspect(args: argparse.Namespace) -> int:
    from machopt.toolpath.toolpath_reader import read_toolpath
    from machopt.toolpath.toolpath_summary import compute_summary_values, summarise_toolpath

    if args.overwrite and args.html is None:
        raise OptionError(
            "has no effect without --html: nothing is written. Expected a call without it", where="--force"
        )
    if _is_robot_file(args.file):
        refuse_reading_options(args, "a cell or robot, which has no toolpath")
        return _run_inspect_robot(args)
    warn_of_effect_code(args)
    if args.package or args.xacro_arg:
        raise OptionError(
            "found a toolpath; a robot's .urdf or .xacro file has packages and arguments",
            where="--package" if args.package else "--xacro-arg",
        )
    if args.effects and args.cell is None:
        raise OptionError(
            "found a toolpath and no cell whose files could hold effects; --cell CELL would work", where="--effects"
        )
    inputs: tuple[Path, ...] = (args.file, *args.effects)
    if args.html is not None:
        from machopt.output.single_file import refuse_overwriting

        refuse_overwriting(args.html, force=args.overwrite, inputs=inputs)
    if args.cell is None:
        toolpath = read_toolpath(args.file, **convert_reading_options(args))
    else:
        from machopt.cell.cell_reader import load_cell
        from machopt.cell.work_offsets import place_toolpath
        from machopt.commands.toolpath_reading_options import get_reading_options
        from machopt.effects.user_effects import activate_user_effects, load_effect_files
        from machopt.planning.job.request_checks import add_reach_warning, state_reach

        with activate_user_effects(load_effect_files(args.effects)):
            cell = load_cell(args.cell, allow_external=args.allow_external)
            inputs += cell.files
            toolpath = place_toolpath(
                read_toolpath(args.file, **get_reading_options(cell), **convert_reading_options(args)), cell
            )
            toolpath = state_reach(cell, add_reach_warning(cell, toolpath))
    if args.html is not None:
        from machopt.report.pages.toolpath_page import write_toolpath_page

        write_toolpath_page(args.html, toolpath, summarise_toolpath(toolpath), force=args.overwrite, inputs=inputs)
    if args.json:
        print_result(summarise_toolpath(toolpath))
    elif not args.quiet:
        print("\n".join(format_as_tree(compute_summary_values(toolpath))))
        if args.html is not None:
            print(f"pictures: {args.html}")
    return 0


def _is_robot_file(path: Path) -> bool:
    """A cell's folder, its cell.yaml, a URDF or a xacro file; everything else is read as a toolpath."""
    if path.is_dir():
        return (path / "cell.yaml").exists()
    return path.name == "cell.yaml" or path.suffix.lower() in (".urdf", ".xacro")


def _run_inspect_robot(args: argparse.Namespace) -> int:
    from machopt.commands.inspect_cell import inspect_cell

    if args.cell is not None:
        raise OptionError("found a cell or robot, which is inspected without another one", where="--cell")
    if args.effects and args.file.suffix.lower() in (".urdf", ".xacro"):
        raise OptionError("found a robot's file; only the files of a cell hold effects", where="--effects")
    warn_of_effect_code(args)
    if args.html is not None:
        raise OptionError(
            "found a cell, --html draws toolpaths; 'machopt view CELL' shows a cell in a browser, "
            "'machopt validate CELL --picture FILE.svg' draws it",
            where="--html",
        )
    found = inspect_cell(
        args.file,
        allow_external=args.allow_external,
        effects=tuple(args.effects),
        packages=dict(args.package),
        xacro_args=dict(args.xacro_arg),
    )
    if args.json:
        print_result(found)
    elif not args.quiet:
        print("\n".join(format_as_tree(found.to_json_types())))
    return 0


def _run_verify(args: argparse.Namespace) -> int:
    from machopt.cli.check_failures import format_failures, sort_causes_first
    from machopt.commands.verify import run_verify
    from machopt.verification.folder.options_in_force import VerifyRequest
    from machopt.verification.folder.verification_scope import NOT_RECOMPUTED

    warn_of_effect_code(args)
    done = run_verify(
        VerifyRequest(
            cell=args.cell,
            toolpath=args.toolpath,
            out=args.out,
            plan_file=args.plan,
            overrides=tuple(args.set),
            reading=convert_reading_options(args),
            allow_external=args.allow_external,
            effects=tuple(args.effects),
            process=args.process,
        )
    )
    found = done.verification
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(format_check_line(c) for c in sort_causes_first(found.checks)))
        print(
            "\n".join(
                [*map(format_information_line, found.information), f"info not recomputed: {', '.join(NOT_RECOMPUTED)}"]
            )
        )
        print("\n".join([*(f"note: {n}" for n in done.notes), *([done.line] if found.ok else [])]))
    if not found.ok:
        raise VerificationError(f"{done.line}: {format_failures(found.checks)}")
    return done.exit_code

"""The commands about toolpaths: ``optimize``, ``inspect``, ``verify``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from machopt.cli import circles
from machopt.cli.compiling import compiling
from machopt.cli.display import Display, print_result, tree
from machopt.cli.effects import told_of_effects
from machopt.cli.readingoptions import reading, reading_parser
from machopt.cli.shared import share
from machopt.cli.toolpath_words import check_line, failed, first_reason, information_line, summary
from machopt.errors import InputError, VerificationError

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the commands to the parser."""
    planning = argparse.ArgumentParser(add_help=False)
    share(planning, "--plan")
    share(planning, "--set")
    share(planning, "--allow-external")

    _add_optimize(commands, common, planning)
    _add_inspect(commands, common)
    _add_verify(commands, common, planning)


def _add_optimize(commands: Commands, common: argparse.ArgumentParser, planning: argparse.ArgumentParser) -> None:
    job = commands.add_parser(
        "optimize",
        parents=[common, reading_parser(), planning],
        help="the main job: the stiffest smooth trajectory for a toolpath",
    )
    share(job, "cell")
    share(job, "toolpath")
    share(job, "--out")
    share(job, "--force")
    job.add_argument("--method", choices=("global", "jiao2022", "default"))
    job.add_argument("--index", choices=("auto", "deflection", "stiffness", "jiao2022"))
    job.add_argument(
        "--allow-gaps", action="store_true", default=None, help="plan the rest where points are unreachable"
    )
    job.add_argument(
        "--compensate",
        action="store_true",
        default=None,
        help="shift the commanded path against the deflection predicted under force_N",
    )
    share(
        job,
        "--post",
        help="robot program to write: krl, rapid, fanuc, urscript, val3, jbi, csv, json, ros, … or a template file; "
        "may be repeated (the cell's controller.post; without either no robot program is written)",
    )
    share(job, "--program-tolerance-mm")
    job.add_argument(
        "--map-collisions",
        choices=("chosen", "full"),
        default="chosen",
        help="full: for the report's map, look for collisions of every configuration, for half a minute at most "
        "(chosen: only what the choice had to look at)",
    )
    job.add_argument(
        "--front",
        action="store_true",
        help="plan up to five times more, with other weights and clearance: stiffness against cycle time, joint "
        "travel and clearance: front.csv, and a section of the report",
    )
    share(job, "--tables")
    job.add_argument("--sample-ms", type=float, help="time between exported samples (12)")
    share(job, "--seed", default=None, help="of the random search around obstacles")
    share(job, "--jobs", help="accepted for scripts; one plan runs in one process")
    share(job, "--effects")
    job.set_defaults(run=_optimize)


def _add_inspect(commands: Commands, common: argparse.ArgumentParser) -> None:
    look = commands.add_parser(
        "inspect",
        parents=[common, reading_parser()],
        help="what a CAM file holds: points, operations, feeds, words not understood; or a cell or robot: joints, "
        "limits and who sets them, mounting, pairs that may touch",
    )
    look.add_argument("file", type=Path)
    look.add_argument("--html", type=Path, metavar="OUT.html", help="write a page with pictures of the path")
    share(look, "--force")
    look.add_argument("--cell", type=Path, help="cell whose robot a program with joint positions was written for")
    share(look, "--allow-external")
    share(look, "--package")
    share(look, "--xacro-arg")
    share(look, "--effects")
    look.set_defaults(run=_inspect)


def _add_verify(commands: Commands, common: argparse.ArgumentParser, planning: argparse.ArgumentParser) -> None:
    check = commands.add_parser(
        "verify",
        parents=[common, reading_parser(), planning],
        help="re-check an exported trajectory with independent code",
    )
    share(check, "cell", help=None)
    share(check, "toolpath", help=None)
    check.add_argument("out", type=Path, help="output folder of optimize")
    share(check, "--effects")
    check.set_defaults(run=_verify)


def _optimize(args: argparse.Namespace) -> int:
    from machopt.services.load import OptimizeRequest
    from machopt.services.run import optimize

    circles.loaded()
    direct = {
        "method": args.method,
        "index": args.index,
        "allow_gaps": args.allow_gaps,
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
        reading=reading(args),
        allow_external=args.allow_external,
        posts=tuple(args.post),
        program_tolerance_mm=args.program_tolerance_mm,
        front=args.front,
        tables=args.tables,
        map_all=args.map_collisions == "full",
        effects=tuple(args.effects),
    )
    told_of_effects(args)
    with Display(show=not (args.quiet or args.json)) as display, compiling(display):
        outcome = optimize(request, display.stage)
    if args.json:
        print_result(outcome.result)
    elif not args.quiet:
        for line in summary(outcome.result, outcome.report):
            print(line)
    if outcome.exit_code == 3:
        reason = " ".join(filter(None, (outcome.conflict, first_reason(outcome.result))))
        print(f"machopt: no feasible answer; {reason} ({outcome.report} lists every point)", file=sys.stderr)
        # often the cause: a frame in metres, a body that is missing
        told = [warning for warning in outcome.result.warnings if warning != outcome.conflict]
        for warning in told[:3]:
            print(f"  note: {warning}", file=sys.stderr)
    elif outcome.exit_code == VerificationError.exit_code:
        print(f"machopt: verification failed: {failed(outcome.result)}", file=sys.stderr)
    return outcome.exit_code


def _inspect(args: argparse.Namespace) -> int:
    from machopt.formats.inspect import summarise, summary_values
    from machopt.formats.toolpath import read_toolpath

    told_of_effects(args)
    if _is_robot(args.file):
        return _inspect_robot(args)
    if args.package or args.xacro_arg:
        raise InputError(
            "found a toolpath; a robot's .urdf or .xacro file has packages and arguments",
            where="--package" if args.package else "--xacro-arg",
        )
    if args.effects and args.cell is None:
        raise InputError(
            "found a toolpath and no cell whose files could hold effects; --cell CELL would work", where="--effects"
        )
    inputs: tuple[Path, ...] = (args.file, *args.effects)
    if args.html is not None:
        from machopt.output.single_file import refuse_overwriting

        refuse_overwriting(args.html, force=args.overwrite, inputs=inputs)
    if args.cell is None:
        toolpath = read_toolpath(args.file, **reading(args))
    else:
        from machopt.effects.own import in_use, with_effects
        from machopt.formats.cell import load_cell
        from machopt.formats.setups import placed
        from machopt.plan.job.drive import with_reach_warning
        from machopt.services.knownrobot import reading_of

        with in_use(with_effects(args.effects)):
            cell = load_cell(args.cell, allow_external=args.allow_external)
            inputs += cell.files
            toolpath = placed(read_toolpath(args.file, **reading_of(cell), **reading(args)), cell)
            toolpath = with_reach_warning(cell, toolpath)
    if args.html is not None:
        from machopt.report.toolpath_page import write_toolpath_page

        write_toolpath_page(args.html, toolpath, summarise(toolpath), force=args.overwrite, inputs=inputs)
    if args.json:
        print_result(summarise(toolpath))
    elif not args.quiet:
        print("\n".join(tree(summary_values(toolpath))))
        if args.html is not None:
            print(f"pictures: {args.html}")
    return 0


def _is_robot(path: Path) -> bool:
    """A cell's folder, its cell.yaml, a URDF or a xacro file; everything else is read as a toolpath."""
    if path.is_dir():
        return (path / "cell.yaml").exists()
    return path.name == "cell.yaml" or path.suffix.lower() in (".urdf", ".xacro")


def _inspect_robot(args: argparse.Namespace) -> int:
    from machopt.services.look import look

    if args.html is not None:
        raise InputError(
            "found a cell, --html draws toolpaths; 'machopt view CELL' shows a cell in a browser, "
            "'machopt validate CELL --picture FILE.svg' draws it",
            where="--html",
        )
    found = look(
        args.file,
        allow_external=args.allow_external,
        effects=tuple(args.effects),
        packages=dict(args.package),
        xacro_args=dict(args.xacro_arg),
    )
    if args.json:
        print_result(found)
    elif not args.quiet:
        print("\n".join(tree(found.plain())))
    return 0


def _verify(args: argparse.Namespace) -> int:
    from machopt.cli.failures import causes_first, failures
    from machopt.recheck.inforce import VerifyRequest
    from machopt.recheck.scope import NOT_RECOMPUTED
    from machopt.services.verify import verify

    told_of_effects(args)
    done = verify(
        VerifyRequest(
            cell=args.cell,
            toolpath=args.toolpath,
            out=args.out,
            plan_file=args.plan,
            overrides=tuple(args.set),
            reading=reading(args),
            allow_external=args.allow_external,
            effects=tuple(args.effects),
        )
    )
    found = done.verification
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print("\n".join(check_line(c) for c in causes_first(found.checks)))
        print(
            "\n".join([*map(information_line, found.information), f"info not recomputed: {', '.join(NOT_RECOMPUTED)}"])
        )
        print("\n".join([*(f"note: {n}" for n in done.notes), *([done.line] if found.ok else [])]))
    if not found.ok:
        raise VerificationError(f"{done.line}: {failures(found.checks)}")
    return done.exit_code

"""The commands ``init`` and ``validate`` for cells."""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from pathlib import Path
from typing import Any

from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.option_values import parse_floats
from machopt.cli.progress_display import print_result
from machopt.cli.reading_options import build_reading_parser, convert_reading_options
from machopt.cli.shared_options import add_shared_option

Commands = Any  # argparse keeps its subparsers' type private

_COLLECTED = ("reading", "packages", "xacro_args")  # of the request, from several options each
_QUESTIONS = (
    ("tool_length_mm", "flange to TCP, mm"),
    ("tool_mass_kg", "mass of spindle, holder and cutter, kg"),
    ("cutter_diameter_mm", "cutter diameter, mm"),
    ("cutter_length_mm", "cutter length, mm"),
    ("post", "robot program to write (krl, rapid, fanuc, urscript … or nothing)"),
)
"""What ``--ask`` asks: option, words."""


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the commands to the parser.

    Args:
        commands: The sub-parsers of the main parser.
        common: Parent parser with the options of every command.
    """
    _add_init(commands, common)
    _add_validate(commands, common)


def _add_init(commands: Commands, common: argparse.ArgumentParser) -> None:
    p = commands.add_parser(
        "init", parents=[common, build_reading_parser()], help="write a new cell from the URDF or xacro file of a robot"
    )
    p.add_argument("robot", type=Path, help="URDF or xacro file of the robot")
    add_shared_option(p, "--out", metavar="CELL", help="folder of the new cell")
    p.add_argument("--ask", action="store_true", help="ask for the data of the tool on the terminal")
    p.add_argument("--name", help="name of the cell (default: that of the robot file)")
    p.add_argument(
        "--base-link",
        metavar="LINK",
        help="first link of the robot (default: base_link, or the parent of the first joint)",
    )
    add_shared_option(p, "--package")
    add_shared_option(p, "--xacro-arg")
    add_shared_option(
        p, "--allow-external", help="allow a xacro file to read files outside its package and the packages it names"
    )
    p.add_argument(
        "--for-diagnosis",
        action="store_true",
        help="accept an arm of more than six joints: identify and diagnose take such a cell, a plan does not",
    )
    p.add_argument(
        "--flange-link",
        metavar="LINK",
        help="link to which the tool is mounted (default: tool0, flange, or the last link)",
    )
    _add_tool_options(p)
    _add_workpiece_options(p)
    _add_arm_options(p)
    p.set_defaults(run=_run_init)


def _add_tool_options(p: argparse.ArgumentParser) -> None:
    from machopt.cell_setup.template.init_request import UNITS, InitRequest

    tool = p.add_argument_group("tool")
    tool.add_argument(
        "--tool-length-mm",
        type=float,
        help="distance from flange to TCP along the flange axis (default: a tenth of the reach, 80 to 200)",
    )
    tool.add_argument(
        "--tool-angle-deg",
        type=float,
        choices=(0.0, 45.0, 90.0),
        metavar="0|45|90",
        help="angle between spindle and flange axis (default: 45 if no other option states where the tool is, else 0)",
    )
    tool.add_argument(
        "--tcp-mm",
        type=parse_floats,
        metavar="X,Y,Z",
        help="position of the TCP in the flange link, instead of a length",
    )
    tool.add_argument(
        "--tcp-rpy-deg",
        type=parse_floats,
        metavar="R,P,Y",
        help="orientation of the tool in the flange link (default: z along the flange axis)",
    )
    _add_number_option(tool, "--tool-mass-kg", InitRequest.tool_mass_kg, "mass of spindle, holder and cutter")
    tool.add_argument(
        "--tool-mesh", type=Path, metavar="FILE", help="mesh of the tool in the flange link (default: a cylinder)"
    )
    _add_number_option(tool, "--cutter-diameter-mm", InitRequest.cutter_diameter_mm, "diameter of the cutter")
    _add_number_option(tool, "--cutter-length-mm", InitRequest.cutter_length_mm, "length of the cutter")
    p.add_argument(
        "--mesh-unit",
        choices=tuple(UNITS),
        help="unit of --tool-mesh and --workpiece-mesh (default: m, or mm where m would be too large)",
    )


def _add_workpiece_options(p: argparse.ArgumentParser) -> None:
    part = p.add_argument_group("workpiece")
    part.add_argument(
        "--toolpath", type=Path, metavar="FILE", help="place the workpiece where the robot reaches this whole toolpath"
    )
    part.add_argument(
        "--workpiece-mm",
        type=parse_floats,
        metavar="X,Y,Z",
        help="position of the CAM frame in world (default: within reach)",
    )
    part.add_argument(
        "--workpiece-rpy-deg",
        type=parse_floats,
        metavar="R,P,Y",
        help="orientation of the CAM frame in world (default: 0, or as the reach demands)",
    )
    part.add_argument("--workpiece-mesh", type=Path, metavar="FILE", help="mesh of the workpiece in CAM coordinates")


def _add_arm_options(p: argparse.ArgumentParser) -> None:
    from machopt.cell_setup.template.init_request import InitRequest

    arm = p.add_argument_group("arm")
    arm.add_argument(
        "--stiffness",
        type=Path,
        metavar="FILE",
        help="stiffness.yaml to use (default: an estimate from the size of the robot)",
    )
    arm.add_argument(
        "--velocity-deg-s",
        type=parse_floats,
        metavar="V1,…,V6",
        help="largest joint velocities (default: those of the URDF)",
    )
    arm.add_argument(
        "--post", default=InitRequest.post, help="robot program that optimize writes: krl, rapid, fanuc, …"
    )


def _add_validate(commands: Commands, common: argparse.ArgumentParser) -> None:
    look = commands.add_parser("validate", parents=[common], help="list errors and warnings of a cell, and draw it")
    add_shared_option(look, "cell")
    add_shared_option(look, "--allow-external")
    look.add_argument(
        "--picture", type=Path, metavar="FILE.svg", help="draw the cell in its home position in three views"
    )
    add_shared_option(look, "--force")
    add_shared_option(look, "--effects")
    look.set_defaults(run=_run_validate)


def _add_number_option(group: Any, option: str, default: float, what: str) -> None:
    group.add_argument(option, type=float, default=default, help=f"{what} (default: {default:g})")


def _run_init(args: argparse.Namespace) -> int:
    from dataclasses import fields

    from machopt.cell_setup.template.init_request import InitRequest
    from machopt.commands.init import run_init

    if args.ask:
        _prompt_for_missing(args)
    given = {f.name: getattr(args, f.name) for f in fields(InitRequest) if f.name not in _COLLECTED}
    packages, arguments = dict(args.package), dict(args.xacro_arg)
    done = run_init(
        InitRequest(**given, packages=packages, xacro_args=arguments, reading=convert_reading_options(args))
    )
    cell = done.cell
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        print(f"{done.folder / 'cell.yaml'}: {cell.base_link} to {cell.flange_link} by {', '.join(cell.arm_joints)}")
        print("\n".join(f"  put in your own: {g}" for g in done.guesses))
        print("\n".join([*(f"  note: {n}" for n in done.notes), *(f"  warning: {w}" for w in cell.warnings)]))
        print(f"next: machopt validate {shlex.quote(str(done.folder))}")
    return 0


def _run_validate(args: argparse.Namespace) -> int:
    from machopt.commands.validate import run_validate

    warn_of_effect_code(args)
    done = run_validate(
        args.cell,
        allow_external=args.allow_external,
        picture_file=args.picture,
        effects=tuple(args.effects),
        overwrite=args.overwrite,
    )
    if args.json:
        print_result(done.result)
    elif not args.quiet:
        for f in done.findings:
            if f.level == "warning":
                print(f"warning: {f.where}: {f.text}" if f.where else f"warning: {f.text}")
        if not done.errors:
            warnings = done.result.warnings
            print(f"{args.cell}: valid, {warnings} warning{'' if warnings == 1 else 's'}")
        if done.picture is not None:
            print(f"picture: {done.picture}")
    for f in done.errors if not args.json else ():
        print(f"machopt: {f.text}", file=sys.stderr)
    return done.exit_code


def _prompt_for_missing(args: argparse.Namespace) -> None:
    """Prompt for missing values until they are valid; Return keeps the value in brackets."""
    for name, words in _QUESTIONS:
        default_text = "by the arm's size" if name == "tool_length_mm" else "nothing"
        while True:
            try:
                answer = input(f"{words} [{getattr(args, name) or default_text}]: ").strip()
            except EOFError:
                return
            wrong = _store_answer(args, name, answer) if answer else ""
            if not wrong:
                break
            print(f"  {wrong}")


def _store_answer(args: argparse.Namespace, name: str, answer: str) -> str:
    """Take an answer, or say what would work."""
    from machopt.errors import suggest_nearest_word
    from machopt.programs.program_writer import list_post_names

    if name == "post":
        if answer not in (*list_post_names(), "nothing", "none"):
            return suggest_nearest_word(answer, [*list_post_names(), "nothing"])
        args.post = "" if answer in ("nothing", "none") else answer
        return ""
    try:
        value = float(answer)
    except ValueError:
        value = float("nan")
    least = "0 or more" if name == "tool_mass_kg" else "above 0"
    if not (math.isfinite(value) and (value >= 0 if name == "tool_mass_kg" else value > 0)):
        return f"a number {least} would work"
    long = args.tool_length_mm
    if name == "cutter_length_mm" and args.tcp_mm is None and long is not None and value >= long:
        return f"less than the {args.tool_length_mm:g} mm from flange to TCP would work"
    setattr(args, name, value)
    return ""

"""The command ``map``."""

from __future__ import annotations

import argparse
from pathlib import Path

from machopt.cli.command_runner import run_request_command
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.shared_options import add_shared_option


def add_map_options(p: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser.

    Args:
        p: The parser.
    """
    _add_place_options(p)
    _add_posture_options(p)
    _add_quantity_options(p)
    add_shared_option(p, "--plan", dest="plan_file")
    add_shared_option(p, "--set", dest="overrides")
    add_shared_option(p, "--process")
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_map)


def _add_place_options(p: argparse.ArgumentParser) -> None:
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


def _add_posture_options(p: argparse.ArgumentParser) -> None:
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


def _add_quantity_options(p: argparse.ArgumentParser) -> None:
    load = p.add_argument_group("quantities")
    load.add_argument("--load-N", dest="force", metavar="FX,FY,FZ", help="force on the tool, for deflection and K_C")
    load.add_argument("--wrench", metavar="FX,…,MZ", help="force and moment on the tool, N and N·m")
    load.add_argument(
        "--load-axes",
        choices=("frame", "tool"),
        default="frame",
        help="axes in which the load is given (default: frame)",
    )
    load.add_argument(
        "--toolpath",
        type=Path,
        metavar="FILE",
        help="job with a process: error, probability and stability of each operation under its own force",
    )
    load.add_argument("--length", type=float, metavar="MM", help="characteristic length (default: computed)")
    load.add_argument(
        "--measured", type=Path, metavar="FILE", help="table of measured stiffness, compared with the model"
    )
    load.add_argument("--power", type=float, default=2.0, help="power of the inverse distance weighting (default: 2)")
    load.add_argument(
        "--neighbours", type=int, help="number of neighbours of the inverse distance weighting (default: all)"
    )


def _run_map(args: argparse.Namespace) -> int:
    from machopt.commands.map.run import MapRequest, run_map

    warn_of_effect_code(args)
    return run_request_command(args, MapRequest, run_map, {})

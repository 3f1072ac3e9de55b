"""The command ``plan-poses``."""

from __future__ import annotations

import argparse
from pathlib import Path

from machopt.cli.command_runner import run_request_command
from machopt.cli.effects_notice import warn_of_effect_code
from machopt.cli.option_values import parse_floats
from machopt.cli.shared_options import add_shared_option, warn_of_unused_options


def add_plan_poses_options(p: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser.

    Args:
        p: The parser.
    """
    _add_size_options(p)
    _add_load_options(p)
    _add_job_options(p)
    _add_instrument_options(p)
    _add_posture_options(p)
    _add_search_options(p)
    add_shared_option(p, "--effects")
    p.set_defaults(run=_run_plan_poses)


def _add_size_options(p: argparse.ArgumentParser) -> None:
    size = p.add_argument_group("how much to measure")
    size.add_argument("--poses", type=int, default=10, help="number of poses (default: 10)")
    size.add_argument("--loads", type=int, default=2, help="number of different loads at each pose (default: 2)")
    size.add_argument("--cycles", type=int, default=2, help="number of repetitions of all poses and loads (default: 2)")
    size.add_argument(
        "--target-percent",
        type=float,
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


def _add_load_options(p: argparse.ArgumentParser) -> None:
    loads = p.add_argument_group("loads")
    loads.add_argument("--weights-kg", type=parse_floats, metavar="A,B", help="available weights, kg")
    loads.add_argument("--pull-N", type=parse_floats, metavar="A,B", help="available pulling forces, N")
    loads.add_argument(
        "--pull-directions",
        type=int,
        default=8,
        help="number of horizontal pulling directions where no anchors are given (default: 8)",
    )
    loads.add_argument(
        "--anchors",
        type=parse_floats,
        action="append",
        default=[],
        metavar="X,Y,Z",
        help="point to which a rope can be tied, in world, mm; may be repeated",
    )
    loads.add_argument(
        "--arms-mm",
        type=parse_floats,
        default=(0.0, 200.0),
        metavar="A,B",
        help="lever arms of the load across the tool axis, mm; 0 is the TCP (default: 0,200)",
    )
    loads.add_argument("--max-load-N", type=float, help="largest load, N (default: no limit)")
    loads.add_argument(
        "--max-torque-Nm", type=parse_floats, metavar="T1,…,T6", help="largest joint torques due to the load alone"
    )
    loads.add_argument("--max-deflection-mm", type=float, default=5.0, help="largest expected deflection (default: 5)")
    loads.add_argument(
        "--min-signal",
        type=float,
        default=5.0,
        help="smallest expected deflection, in standard deviations of a reading (default: 5)",
    )


def _add_job_options(p: argparse.ArgumentParser) -> None:
    job = p.add_argument_group("the job that the robot is measured for")
    job.add_argument(
        "--toolpath", type=Path, metavar="FILE", help="toolpath of the job; its loads are those of force_N"
    )
    job.add_argument(
        "--force-N",
        type=parse_floats,
        metavar="LOW,HIGH",
        help="smallest and largest process force, N; each load is then measured at two sizes",
    )
    add_shared_option(job, "--set", help="set a planning option for the plan of --toolpath; may be repeated")


def _add_instrument_options(p: argparse.ArgumentParser) -> None:
    gauge = p.add_argument_group("instrument")
    gauge.add_argument(
        "--sensor",
        choices=("tracker", "tracker3", "dial"),
        default="tracker",
        help="laser tracker with one target (default) or with three targets (measures rotations too), or three dial "
        "gauges",
    )
    gauge.add_argument(
        "--displacement-mm", type=float, help="standard deviation of one coordinate (default: 0.012, dial gauge 0.005)"
    )
    gauge.add_argument(
        "--targets-mm", type=float, default=200.0, help="distance of the three targets from the TCP (default: 200)"
    )
    gauge.add_argument(
        "--cycle-mm",
        type=float,
        default=0.015,
        help="standard deviation of the error common to a load cycle (default: 0.015)",
    )
    gauge.add_argument(
        "--pose-mm", type=float, default=0.03, help="standard deviation of the error common to a pose (default: 0.03)"
    )
    gauge.add_argument(
        "--force-percent", type=float, default=0.75, help="standard deviation of the load (default: 0.75)"
    )
    gauge.add_argument("--tracker", type=parse_floats, metavar="X,Y,Z", help="position of the tracker in world, mm")
    gauge.add_argument(
        "--tracker-range-mm",
        type=float,
        default=15000.0,
        help="largest distance of a target from the tracker (default: 15000)",
    )
    gauge.add_argument(
        "--tracker-angle-deg",
        type=float,
        default=45.0,
        help="smallest angle between line of sight and flange (default: 45)",
    )


def _add_posture_options(p: argparse.ArgumentParser) -> None:
    posture = p.add_argument_group("postures")
    posture.add_argument(
        "--min-kci", type=float, default=0.1, help="smallest dexterity index (default: 0.1; zhang2025 uses 0.45)"
    )
    posture.add_argument(
        "--max-nu-p",
        type=float,
        default=0.05,
        help="largest relative change of the translation due to K_C (default: 0.05)",
    )
    posture.add_argument(
        "--max-nu-r-deg", type=float, default=0.05, help="largest change of a rotation due to K_C (default: 0.05)"
    )
    posture.add_argument(
        "--clearance-mm", type=float, default=20.0, help="smallest clearance to all bodies (default: 20)"
    )
    posture.add_argument(
        "--limit-margin-deg", type=float, default=5.0, help="smallest distance from a joint limit (default: 5)"
    )
    posture.add_argument(
        "--floor-mm", type=float, default=300.0, help="smallest height of the TCP in world (default: 300)"
    )
    posture.add_argument(
        "--ceiling-mm", type=float, default=2500.0, help="largest height of the TCP in world (default: 2500)"
    )
    posture.add_argument(
        "--box-mm", type=parse_floats, metavar="X0,Y0,Z0,X1,Y1,Z1", help="box in world that must contain the TCP"
    )
    posture.add_argument("--without-workpiece", action="store_true", help="plan without the workpiece")
    posture.add_argument("--no-collision", action="store_true", help="skip the collision check")


def _add_search_options(p: argparse.ArgumentParser) -> None:
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
        type=parse_floats,
        metavar="K1,…,K6",
        help="approximate joint stiffness, N·m/rad (default: that of the cell)",
    )
    search.add_argument(
        "--prior-factor",
        type=float,
        default=1.0,
        help="factor by which the approximate stiffness may be wrong (default: 1)",
    )
    search.add_argument("--candidates", type=int, default=2000, help="number of candidate poses (default: 2000)")
    search.add_argument("--starts", type=int, default=2, help="number of random starts of the search (default: 2)")


def _run_plan_poses(args: argparse.Namespace) -> int:
    from machopt.commands.plan_poses.run import PosesRequest, run_plan_poses

    warn_of_effect_code(args)
    if args.toolpath is None:
        warn_of_unused_options(args.set, "nothing is planned without --toolpath", quiet=args.quiet)
    renamed = {"anchors": "anchors_mm", "tracker": "tracker_mm", "prior": "prior_Nm_per_rad", "set": "overrides"}
    return run_request_command(args, PosesRequest, run_plan_poses, renamed)

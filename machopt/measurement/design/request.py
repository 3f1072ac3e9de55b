"""Request of ``machopt plan-poses`` in the user's units, and its conversion to SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Literal

import numpy as np

from machopt.data_types.cell import Cell, Workpiece
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError, OptionError
from machopt.kinematics.robot import Robot
from machopt.measurement.design.load_cases import LoadCriteria
from machopt.measurement.design.load_methods import GRAVITY, LoadMethod, build_load_method_combinations
from machopt.measurement.design.measurement_plan import MeasurementPlanSize
from machopt.measurement.design.pose_candidates import PoseCriteria
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.stiffness.terms import LinearTerm, build_fitted_term

Sensor = Literal["tracker", "tracker3", "dial"]
SENSORS: dict[Sensor, float] = {"tracker": 0.012, "tracker3": 0.012, "dial": 0.005}
"""Standard uncertainty per coordinate in mm: laser tracker with one or three targets, three dial gauges."""
MOST_CASES = 1_500_000  # pose × load pairs that fit in memory with their responses (about 2 GB)
MOST_POSES, MOST_LOADS, MOST_CYCLES, MOST_STARTS = 100, 12, 50, 50  # limits against excessive computing time


@dataclass(frozen=True, kw_only=True)
class PosesRequest:
    """Options of one run; lengths in mm, angles in degrees, as entered."""

    cell: Path
    out: Path
    poses: int = 10
    loads: int = 2
    cycles: int = 2
    target_percent: float | None = 5.0
    weights_kg: tuple[float, ...] | None = None
    pull_N: tuple[float, ...] | None = None  # N, as the option's name
    pull_directions: int = 8
    anchors_mm: tuple[tuple[float, ...], ...] = ()
    arms_mm: tuple[float, ...] = (0.0, 200.0)
    sensor: Sensor = "tracker"
    displacement_mm: float | None = None
    targets_mm: float = 200.0
    cycle_mm: float = 0.015
    pose_mm: float = 0.03
    force_percent: float = 0.75
    min_kci: float = 0.1
    max_nu_p: float = 0.05
    max_nu_r_deg: float = 0.05
    max_deflection_mm: float = 5.0
    max_load_N: float | None = None
    max_torque_Nm: tuple[float, ...] | None = None
    min_signal: float = 5.0
    clearance_mm: float = 20.0
    limit_margin_deg: float = 5.0
    floor_mm: float = 300.0
    ceiling_mm: float = 2500.0
    box_mm: tuple[float, ...] | None = None
    tracker_mm: tuple[float, ...] | None = None
    tracker_range_mm: float = 15_000.0
    tracker_angle_deg: float = 45.0
    without_workpiece: bool = False
    no_collision: bool = False
    terms: tuple[str, ...] = ()
    prior_Nm_per_rad: tuple[float, ...] | None = None
    prior_factor: float = 1.0
    toolpath: Path | None = None  # toolpath of the job
    force_N: tuple[float, ...] | None = None  # least and largest of the job's process force
    overrides: tuple[str, ...] = ()  # planning options key=value, of the job
    discriminate: Path | None = None  # folder of a diagnosis whose rivals are to be separated
    candidates: int = 2000
    starts: int = 2
    seed: int = 0
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added
    external: tuple[str, ...] = ()  # name=value of external joints that are not at home, mm or degrees
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with user-defined effects, which --fit may name


def check_poses_request(request: PosesRequest) -> None:
    """Check a request.

    Args:
        request: Validated user request.

    Raises:
        InputError: Names the option, the value found and what would be accepted.
    """
    _check_counts(request)
    _check_sizes(request)
    if request.sensor not in SENSORS:
        raise OptionError(f"found {request.sensor!r}; valid: {', '.join(SENSORS)}", where="--sensor")
    _check_loads(request)
    _check_job(request)
    _check_arrays(request)
    if request.anchors_mm and request.pull_N is None:
        raise OptionError("ropes to anchors need forces; --pull-N 200,500 for instance", where="--anchors")


def _check_counts(r: PosesRequest) -> None:
    """Check counts: at least one of everything, and no excessive computing time."""
    for option, value, least in (
        ("--poses", r.poses, 1),
        ("--loads", r.loads, 1),
        ("--cycles", r.cycles, 1),
        ("--candidates", r.candidates, 1),
        ("--starts", r.starts, 1),
        ("--seed", r.seed, 0),
        ("--pull-directions", r.pull_directions, 1),
    ):
        if value < least:
            raise InputError(f"found {value}; expected at least {least}", where=option)
    for option, value, most in (
        ("--poses", r.poses, MOST_POSES),
        ("--loads", r.loads, MOST_LOADS),
        ("--cycles", r.cycles, MOST_CYCLES),
        ("--starts", r.starts, MOST_STARTS),
    ):
        if value > most:
            raise InputError(f"found {value}; expected at most {most}", where=option)
    if r.candidates < r.poses:
        raise OptionError(
            f"found {r.candidates}; fewer candidates than the {r.poses} poses wanted", where="--candidates"
        )


def _check_sizes(r: PosesRequest) -> None:
    """Check single numbers."""
    for option, number, strict in (
        ("--displacement-mm", r.displacement_mm, True),
        ("--targets-mm", r.targets_mm, True),
        ("--cycle-mm", r.cycle_mm, False),
        ("--pose-mm", r.pose_mm, False),
        ("--force-percent", r.force_percent, False),
        ("--target-percent", r.target_percent, True),
        ("--max-deflection-mm", r.max_deflection_mm, True),
        ("--max-load-N", r.max_load_N, True),
        ("--max-nu-p", r.max_nu_p, True),
        ("--max-nu-r-deg", r.max_nu_r_deg, True),
        ("--min-signal", r.min_signal, False),
        ("--clearance-mm", r.clearance_mm, False),
        ("--limit-margin-deg", r.limit_margin_deg, False),
        ("--tracker-range-mm", r.tracker_range_mm, True),
        ("--tracker-angle-deg", r.tracker_angle_deg, False),
        ("--min-kci", r.min_kci, False),
    ):
        if number is not None and not (isfinite(number) and (number > 0 if strict else number >= 0)):
            raise InputError(f"found {number:g}; expected {'more than' if strict else 'at least'} zero", where=option)
    if r.tracker_angle_deg >= 180:
        raise OptionError(f"found {r.tracker_angle_deg:g}; expected less than 180", where="--tracker-angle-deg")
    if r.min_kci >= 1:
        raise OptionError(f"found {r.min_kci:g}; a KCI lies between 0 and 1", where="--min-kci")
    if not r.floor_mm < r.ceiling_mm:
        raise OptionError(
            f"found {r.floor_mm:g}; expected less than --ceiling-mm, {r.ceiling_mm:g}", where="--floor-mm"
        )
    if not (isfinite(r.prior_factor) and r.prior_factor >= 1):
        raise OptionError(
            f"found {r.prior_factor:g}; expected 1 (the prior is trusted) or more", where="--prior-factor"
        )


def _check_loads(r: PosesRequest) -> None:
    """Check weights, pulls and lever arms."""
    for option, row in (("--weights-kg", r.weights_kg), ("--pull-N", r.pull_N)):
        for v in row or ():
            if not (isfinite(v) and v > 0):
                raise InputError(f"found {v:g}; expected more than zero", where=option)
    for v in r.arms_mm:
        if not (isfinite(v) and v >= 0):
            raise OptionError(f"found {v:g}; expected 0 (at the TCP) or the arm's length", where="--arms-mm")
    if not r.arms_mm:
        raise OptionError("is empty; 0 loads the TCP itself", where="--arms-mm")


def _check_job(r: PosesRequest) -> None:
    """Check the options of the job."""
    if r.force_N is not None and not (
        1 <= len(r.force_N) <= 2 and all(isfinite(v) and v >= 0 for v in r.force_N) and max(r.force_N) > 0
    ):
        found = ",".join(f"{v:g}" for v in r.force_N)
        raise OptionError(
            f"found {found}; expected the least and the largest process force, e.g. 200,800", where="--force-N"
        )
    if r.discriminate is not None and (r.toolpath is not None or r.force_N is not None):
        raise OptionError(
            "the diagnosis says which loads are needed; without --toolpath and --force-N it would work",
            where="--discriminate",
        )


def _check_arrays(r: PosesRequest) -> None:
    """Check positions, boxes and joint values: number of entries and plausible values."""
    for option, row, n in (
        ("--box-mm", r.box_mm, 6),
        ("--tracker", r.tracker_mm, 3),
        ("--max-torque-Nm", r.max_torque_Nm, 6),
        ("--prior", r.prior_Nm_per_rad, 6),
        *(("--anchors", a, 3) for a in r.anchors_mm),
    ):
        if row is not None and (len(row) != n or not all(isfinite(v) for v in row)):
            found = f"{len(row)} values" if len(row) != n else ",".join(f"{v:g}" for v in row)
            raise InputError(f"found {found}; expected {n} finite numbers", where=option)
    if r.box_mm is not None and not all(a < b for a, b in zip(r.box_mm[:3], r.box_mm[3:], strict=True)):
        raise OptionError(
            "the highest corner is not above the lowest; expected xmin,ymin,zmin,xmax,ymax,zmax", where="--box-mm"
        )
    for option, row in (("--prior", r.prior_Nm_per_rad), ("--max-torque-Nm", r.max_torque_Nm)):
        if row is not None and min(row) <= 0:
            raise InputError(f"found {min(row):g}; expected more than zero", where=option)


def convert_to_reading_noise(request: PosesRequest) -> ReadingNoise:
    """Convert the measurement uncertainties of a request to SI.

    Args:
        request: Validated user request.

    Returns:
        The noise of a reading.
    """
    r = request
    sigma = SENSORS[r.sensor] if r.displacement_mm is None else r.displacement_mm
    targets = r.targets_mm / 1e3 if r.sensor == "tracker3" else None
    return ReadingNoise(
        displacement=sigma / 1e3,
        cycle=r.cycle_mm / 1e3,
        pose=r.pose_mm / 1e3,
        force=r.force_percent / 100,
        targets=targets,
        cycles=r.cycles,
    )


def convert_to_pose_criteria(request: PosesRequest) -> PoseCriteria:
    """Convert the pose criteria of a request to SI.

    Args:
        request: Validated user request.

    Returns:
        The criteria.
    """
    r = request
    box = None if r.box_mm is None else np.array(r.box_mm).reshape(2, 3) / 1e3
    tracker = None if r.tracker_mm is None else np.array(r.tracker_mm) / 1e3
    return PoseCriteria(
        kci=r.min_kci,
        limit_margin=np.radians(r.limit_margin_deg),
        floor=r.floor_mm / 1e3,
        ceiling=r.ceiling_mm / 1e3,
        box=box,
        tracker=tracker,
        tracker_range=r.tracker_range_mm / 1e3,
        tracker_angle=np.radians(r.tracker_angle_deg),
    )


def convert_to_load_criteria(request: PosesRequest, noise: ReadingNoise) -> LoadCriteria:
    """Convert the load criteria of a request to SI; with an uncertain prior for the softest and the stiffest arm.

    Args:
        request: Validated user request.
        noise: Noise of a reading.

    Returns:
        The criteria.
    """
    r = request
    return LoadCriteria(
        min_deflection=r.min_signal * noise.reading * r.prior_factor,
        max_deflection=r.max_deflection_mm / 1e3 / r.prior_factor,
        max_load=np.inf if r.max_load_N is None else r.max_load_N,
        max_torque=None if r.max_torque_Nm is None else np.array(r.max_torque_Nm),
        nu_p=r.max_nu_p,
        nu_r=np.radians(r.max_nu_r_deg),
    )


def convert_to_plan_size(request: PosesRequest) -> MeasurementPlanSize:
    """Convert the size of the plan.

    Args:
        request: Validated user request.

    Returns:
        The size.
    """
    r = request
    target = None if r.target_percent is None else r.target_percent / 100
    return MeasurementPlanSize(
        poses=r.poses,
        loads=r.loads,
        candidates=r.candidates,
        target=target,
        belief=r.prior_factor,
        starts=r.starts,
        seed=r.seed,
    )


def build_load_methods(request: PosesRequest, cell: Cell) -> tuple[tuple[LoadMethod, ...], tuple[str, ...]]:
    """Build the load methods of a request.

    Args:
        request: Validated user request.
        cell: Robot cell.

    Returns:
        The methods, and warnings.

    Raises:
        InputError: No loads are given and the tool's mass suggests none.
    """
    r = request
    weights, pulls, warnings = r.weights_kg, r.pull_N, []
    if weights is None and pulls is None:
        if not cell.tool.mass > 0:
            raise OptionError(
                "no loads were given; --weights-kg 20,50 or --pull-N 200,500 would work, within the robot's rated load",
                where="--weights-kg",
            )
        weights, pulls = (cell.tool.mass,), (float(round(cell.tool.mass * GRAVITY)),)
        warnings.append(
            f"no loads were given, so the tool's own weight is taken once more: {weights[0]:g} kg hanging, "
            f"{pulls[0]:g} N pulling; the robot's rated load may allow more, which would need fewer readings"
        )
    T_base_world = invert_transform(cell.T_world_base)
    anchors = np.array(r.anchors_mm, float).reshape(-1, 3) / 1e3 @ T_base_world[:3, :3].T + T_base_world[:3, 3]
    ways = build_load_method_combinations(
        weights or (), pulls or (), r.pull_directions, anchors, [a / 1e3 for a in r.arms_mm], T_base_world[:3, :3]
    )
    if not ways:
        raise OptionError("no loads are left; --weights-kg and --pull-N are both empty", where="--weights-kg")
    if r.candidates * len(ways) > MOST_CASES:
        raise OptionError(
            f"{r.candidates} candidates × {len(ways)} ways of loading are more than {MOST_CASES}; fewer of "
            "--candidates, --anchors, --pull-directions or --arms-mm would work",
            where="--candidates",
        )
    return ways, tuple(warnings)


def build_prior_stiffness(request: PosesRequest, cell: Cell) -> ArmStiffness:
    """Build the prior stiffness.

    Args:
        request: Validated user request.
        cell: Robot cell.

    Returns:
        The stiffness of the request, otherwise of the cell.

    Raises:
        InputError: Neither the cell nor the request has one.
    """
    if request.prior_Nm_per_rad is not None:
        joints = np.array(request.prior_Nm_per_rad)
        return (
            ArmStiffness(joints=joints) if cell.stiffness is None else replace(cell.stiffness, joints=joints, grid=None)
        )
    if cell.stiffness is None:
        raise OptionError(
            "the cell has no stiffness, and loads cannot be judged without a rough one; --prior with six values in "
            "N·m/rad would work (a robot of the same payload is near enough)",
            file=cell.folder / "cell.yaml",
            where="--prior",
        )
    return cell.stiffness


def build_linear_terms(request: PosesRequest, robot: Robot, T_flange_tcp: Array) -> tuple[LinearTerm, ...]:
    """Build the terms to identify together with the joints.

    Args:
        request: Validated user request.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The terms.

    Raises:
        InputError: An unknown effect or place, or an effect without coefficients.
    """
    out: list[LinearTerm] = []
    for text in request.terms:
        effect, at, location = text.partition("@")
        if not at:
            raise OptionError(f"found {text!r}; expected EFFECT@LOCATION, e.g. link_compliance@link:4", where="--fit")
        if effect == "geometric_stiffness":
            raise OptionError(
                "geometric_stiffness follows from load and kinematics; it has nothing to identify", where="--fit"
            )
        if request.terms.count(text) > 1:
            raise OptionError(f"{text} is given twice; keep one", where="--fit")
        try:
            out.append(build_fitted_term(effect, location, robot, T_flange_tcp))
        except InputError as error:
            raise OptionError(f"found {text!r}: {error.reason}", where="--fit") from None
    return tuple(out)


def check_number_of_readings(request: PosesRequest, dimensions: int, unknowns: int) -> None:
    """Check that there are at least as many measured numbers as unknowns.

    Args:
        request: Validated user request.
        dimensions: Coordinates per reading.
        unknowns: Number of unknowns.

    Raises:
        InputError: States the required number of poses.
    """
    numbers = request.poses * request.loads * dimensions
    if numbers < unknowns:
        least = -(-unknowns // (request.loads * dimensions))
        raise OptionError(
            f"{request.poses} poses with {request.loads} loads give {numbers} numbers for {unknowns} unknowns; "
            f"{least} poses at least, better twice as many",
            where="--poses",
        )


def list_unchecked_conditions(request: PosesRequest) -> tuple[str, ...]:
    """List conditions that the poses are not checked for, in the words of the verdict.

    Args:
        request: Validated user request.

    Returns:
        The conditions.
    """
    if request.no_collision:
        return ("collisions NOT checked",)
    return ("collisions with workpiece NOT checked (left out)",) if request.without_workpiece else ()


def remove_workpiece(cell: Cell) -> Cell:
    """Remove the workpiece for the measurement; the body that carries it stays.

    Args:
        cell: Robot cell.

    Returns:
        The cell without workpiece geometry.
    """
    if cell.workpiece.link != "world":
        return replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    return replace(cell, workpiece=Workpiece("world", np.eye(4)))


def list_request_options(request: PosesRequest) -> list[tuple[str, str]]:
    """List the options as they would be entered, for report and plan.json.

    Args:
        request: Validated user request.

    Returns:
        Pairs of name and value.
    """
    skip = ("cell", "out", "allow_external")
    return [(name, _format_value(value)) for name, value in vars(request).items() if name not in skip]


def _format_value(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        nested = any(isinstance(v, tuple) for v in value)
        return (";" if nested else ",").join(_format_value(v) for v in value) if value else "none"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)

"""Request of ``machopt plan-poses`` in the user's units, and its conversion to SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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

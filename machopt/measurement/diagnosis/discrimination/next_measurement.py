"""Poses and loads of the next measurement: to identify all stiffnesses, or to resolve an open diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from machopt.collision.collision_model import CollisionModel
from machopt.collision.collision_model_cache import load_collision_model
from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness
from machopt.kinematics.robot import LinkShape, Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.measurement.design.external_axis_position_option import update_base_frame
from machopt.measurement.design.load_cases import LoadCases, build_load_cases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.measurement_plan import MeasurementPlan, MeasurementTask, build_measurement_plan
from machopt.measurement.design.pose_candidates import PosePool, PoseScreen, sample_poses
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.design.request import (
    PosesRequest,
    build_linear_terms,
    build_load_methods,
    build_prior_stiffness,
    check_number_of_readings,
    convert_to_load_criteria,
    convert_to_plan_size,
    convert_to_pose_criteria,
    convert_to_reading_noise,
    remove_workpiece,
)
from machopt.measurement.design.static_pose_cases import build_static_pose_cases, select_weight_loads
from machopt.measurement.design.torque_reversal_loads import ProcessLoads, describe_joint_loads
from machopt.measurement.diagnosis.discrimination.discrimination_plan import build_discrimination_plan
from machopt.measurement.diagnosis.discrimination.open_hypotheses import OpenDiagnosis
from machopt.measurement.diagnosis.discrimination.planning_noise import (
    DiscriminationOptions,
    compute_planning_noise,
    select_planning_compliance,
)
from machopt.measurement.diagnosis.discrimination.predicted_signals import DiagnosedArm
from machopt.measurement.diagnosis.discrimination.rival_pairs import DiscriminationPlan
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.kinetostatic_indices import compute_characteristic_length
from machopt.stiffness.terms.term_interface import LinearTerm


@dataclass(frozen=True, kw_only=True)
class NextMeasurement:
    """Next measurement with the candidates that it was selected from."""

    robot: Robot
    collision: CollisionModel | None  # None: not checked
    length: float  # m, characteristic
    load_methods: tuple[LoadMethod, ...]
    pool: PosePool
    cases: LoadCases
    plan: MeasurementPlan | None  # None: no admissible load test
    discrimination: DiscriminationPlan | None  # None: no diagnosis given
    noise: ReadingNoise
    warnings: tuple[str, ...]


def plan_next_measurement(
    request: PosesRequest,
    cell: Cell,
    open_diagnosis: OpenDiagnosis | None,
    progress: Callable[[str], None],
    job: ProcessLoads | None = None,
) -> NextMeasurement:
    """Select poses and loads.

    Args:
        request: Validated user request.
        cell: Robot cell.
        open_diagnosis: Diagnosis with competing explanations; None to identify the stiffness.
        progress: Called with a text for each step.
        job: Process loads for which the stiffness is needed.

    Returns:
        The measurement with its candidates.

    Raises:
        InputError: Loads, prior or terms do not allow a plan.
    """
    options = DiscriminationOptions(
        convert_to_reading_noise(request), request.displacement_mm is not None, request.targets_mm / 1e3
    )
    noise = options.noise if open_diagnosis is None else compute_planning_noise(options, open_diagnosis, 1)
    size = convert_to_plan_size(request)
    models = _build_models(request, cell, open_diagnosis, noise)
    progress("building kinematics and collision model")
    screen = _build_screen(request, cell, models)
    progress("looking for poses that can be measured")
    pool = sample_poses(screen, cell.arm_limits, cell.home, size.candidates, size.seed)
    task = _build_task(request, models, screen, pool, noise, open_diagnosis)
    warnings = models.warnings
    plan: MeasurementPlan | None = None
    apart: DiscriminationPlan | None = None
    if len(task.cases) and open_diagnosis is not None:
        arm = DiagnosedArm(
            found=open_diagnosis,
            cell=cell,
            robot=models.robot,
            masses=models.masses if models.masses.mass.sum() > 0 else None,
            compliance=select_planning_compliance(open_diagnosis, models.prior.stiffness.joints),
        )
        apart = build_discrimination_plan(options, arm, pool, task.cases, models.prior, size, progress)
        plan, noise = apart.plan, apart.noise
        warnings = (*warnings, *apart.notes)
    elif len(task.cases):
        plan = build_measurement_plan(task, size, progress, job)
        if job is not None:
            warnings = (*warnings, *describe_joint_loads(job, plan.joints, float(task.cases.magnitude.max())))
    return NextMeasurement(
        robot=models.robot,
        collision=screen.collision,
        length=screen.length,
        load_methods=task.ways,
        pool=pool,
        cases=task.cases,
        plan=plan,
        discrimination=apart,
        noise=noise,
        warnings=warnings,
    )


@dataclass(frozen=True, kw_only=True)
class _MeasurementModels:
    """Models of a cell for a measurement."""

    cell: Cell
    placed_cell: Cell  # base_link during the measurement
    robot: Robot
    shapes: tuple[LinkShape, ...]
    masses: RobotMasses
    prior: ArmElasticity
    terms: tuple[LinearTerm, ...]
    ways: tuple[LoadMethod, ...]
    warnings: tuple[str, ...]


def _build_models(
    request: PosesRequest, cell: Cell, open_diagnosis: OpenDiagnosis | None, noise: ReadingNoise
) -> _MeasurementModels:
    """Return kinematics, prior stiffness and load methods; the prior is the result of a diagnosis, if one is given."""
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    terms = build_linear_terms(request, robot, T)
    check_number_of_readings(request, noise.dimensions, 6 + sum(len(t.coefficients) for t in terms))
    placed_cell = update_base_frame(cell, robot)
    ways, warnings = build_load_methods(request, placed_cell)
    masses = load_masses(placed_cell)
    believed = build_prior_stiffness(request, cell)
    if open_diagnosis is not None:
        believed = ArmStiffness(joints=1.0 / select_planning_compliance(open_diagnosis, believed.joints))
    return _MeasurementModels(
        cell=cell,
        placed_cell=placed_cell,
        robot=robot,
        shapes=shapes,
        masses=masses,
        prior=ArmElasticity(robot, T, believed, cell.arm_limits, masses),
        terms=terms,
        ways=ways,
        warnings=warnings,
    )


def _build_screen(request: PosesRequest, cell: Cell, models: _MeasurementModels) -> PoseScreen:
    """Return the screening of poses, with the collision model of the cell."""
    robot, T = models.robot, cell.tool.T_flange_tcp
    bare = remove_workpiece(cell) if request.without_workpiece else cell
    clearance = request.clearance_mm / 1e3
    return PoseScreen(
        robot=robot,
        T_flange_tcp=T,
        T_world_base=models.placed_cell.T_world_base,
        length=compute_characteristic_length(robot, T).length,
        criteria=convert_to_pose_criteria(request),
        collision=None
        if request.no_collision
        else load_collision_model(bare, robot, models.shapes, clearance, still=True),
    )


def _build_task(
    request: PosesRequest,
    models: _MeasurementModels,
    screen: PoseScreen,
    pool: PosePool,
    noise: ReadingNoise,
    open_diagnosis: OpenDiagnosis | None,
) -> MeasurementTask:
    """Return the load cases at the poses of the pool; for an open diagnosis of measured poses, weights at rest."""
    cell, prior, ways = models.cell, models.prior, models.ways
    criteria = convert_to_load_criteria(request, noise)
    if open_diagnosis is not None and open_diagnosis.channel == "position":
        ways = select_weight_loads(request.weights_kg is not None, ways)
        cases = build_static_pose_cases(pool, ways, prior, criteria, noise, models.masses)
    else:
        cases = build_load_cases(pool, ways, prior, models.terms, criteria, noise)
    return MeasurementTask(
        pool=pool,
        cases=cases,
        screen=screen,
        limits=cell.arm_limits,
        home=cell.home,
        velocity=cell.limits.velocity[:6],
        prior=prior,
        terms=models.terms,
        ways=ways,
        criteria=criteria,
        noise=noise,
    )

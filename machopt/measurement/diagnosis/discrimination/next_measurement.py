"""Poses and loads of the next measurement: to identify all stiffnesses, or to resolve an open diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness
from machopt.kinematics.robot import Robot, load_chain, load_masses
from machopt.measurement.design.external_axis_positions import update_base_frame
from machopt.measurement.design.job_like_loads import ProcessLoads, describe_joint_loads
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
from machopt.measurement.diagnosis.discrimination.discrimination_plan import (
    DiscriminationOptions,
    DiscriminationPlan,
    build_discrimination_plan,
    compute_planning_noise,
    select_planning_compliance,
)
from machopt.measurement.diagnosis.discrimination.open_hypotheses import OpenDiagnosis
from machopt.measurement.diagnosis.discrimination.predicted_signals import DiagnosedArm
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.kinetostatic_indices import compute_characteristic_length


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
    found: OpenDiagnosis | None,
    progress: Callable[[str], None],
    job: ProcessLoads | None = None,
) -> NextMeasurement:
    """Select poses and loads.

    Args:
        request: Validated user request.
        cell: Robot cell.
        found: Diagnosis with competing explanations; None to identify the stiffness.
        progress: Called with a text for each step.
        job: Process loads for which the stiffness is needed.

    Returns:
        The measurement with its candidates.

    Raises:
        InputError: Loads, prior or terms do not allow a plan.
    """
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    asked = DiscriminationOptions(
        convert_to_reading_noise(request), request.displacement_mm is not None, request.targets_mm / 1e3
    )
    noise = asked.noise if found is None else compute_planning_noise(asked, found, 1)
    size = convert_to_plan_size(request)
    terms = build_linear_terms(request, robot, T)
    check_number_of_readings(request, noise.dimensions, 6 + sum(len(t.coefficients) for t in terms))
    stood = update_base_frame(cell, robot)
    ways, warnings = build_load_methods(request, stood)
    limits = cell.arm_limits
    masses = load_masses(stood)
    believed = build_prior_stiffness(request, cell)
    if found is not None:  # use the result of the diagnosis
        believed = ArmStiffness(joints=1.0 / select_planning_compliance(found, believed.joints))
    prior = ArmElasticity(robot, T, believed, limits, masses)
    progress("building kinematics and collision model")
    bare = remove_workpiece(cell) if request.without_workpiece else cell
    clearance = request.clearance_mm / 1e3
    collision = None if request.no_collision else CollisionModel(bare, robot, shapes, clearance, still=True)
    length = compute_characteristic_length(robot, T).length
    screen = PoseScreen(
        robot=robot,
        T_flange_tcp=T,
        T_world_base=stood.T_world_base,
        length=length,
        criteria=convert_to_pose_criteria(request),
        collision=collision,
    )
    progress("looking for poses that can be measured")
    pool = sample_poses(screen, limits, cell.home, size.candidates, size.seed)
    criteria = convert_to_load_criteria(request, noise)
    if found is not None and found.channel == "position":
        ways = select_weight_loads(request.weights_kg is not None, ways)
        cases = build_static_pose_cases(pool, ways, prior, criteria, noise, masses)
    else:
        cases = build_load_cases(pool, ways, prior, terms, criteria, noise)
    plan: MeasurementPlan | None = None
    apart: DiscriminationPlan | None = None
    if len(cases) and found is not None:
        weight = masses if masses.mass.sum() > 0 else None
        compliance = select_planning_compliance(found, prior.stiffness.joints)
        arm = DiagnosedArm(found=found, cell=cell, robot=robot, masses=weight, compliance=compliance)
        apart = build_discrimination_plan(asked, arm, pool, cases, prior, size, progress)
        plan, noise = apart.plan, apart.noise
        warnings = (*warnings, *apart.notes)
    elif len(cases):
        task = MeasurementTask(
            pool=pool,
            cases=cases,
            screen=screen,
            limits=limits,
            home=cell.home,
            velocity=cell.limits.velocity[:6],
            prior=prior,
            terms=terms,
            ways=ways,
            criteria=criteria,
            noise=noise,
        )
        plan = build_measurement_plan(task, size, progress, job)
        if job is not None:
            warnings = (*warnings, *describe_joint_loads(job, plan.joints, float(cases.magnitude.max())))
    return NextMeasurement(
        robot=robot,
        collision=collision,
        length=length,
        load_methods=ways,
        pool=pool,
        cases=cases,
        plan=plan,
        discrimination=apart,
        noise=noise,
        warnings=warnings,
    )

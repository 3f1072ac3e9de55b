"""The poses and loads to measure next: for every stiffness, or for what a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from machopt.design.asked import (
    PosesRequest,
    enough_numbers,
    load_criteria,
    noise_of,
    plan_size,
    pose_criteria,
    prior_of,
    terms_of,
    ways_of,
    without_workpiece,
)
from machopt.design.atrest import cases_at_rest, weights_of
from machopt.design.candidates import PosePool, PoseScreen, sample_poses
from machopt.design.held import based
from machopt.design.joblike import JobLoads, said_of
from machopt.design.loadcases import LoadCases, load_cases
from machopt.design.loads import LoadWay
from machopt.design.measurement import ReadingNoise
from machopt.design.poseplan import PosePlan, plan_poses
from machopt.diagnose.apart.disputes import Diagnosed
from machopt.diagnose.apart.separate import Asked, Discriminating, compliance_for, discriminating, noise_for
from machopt.domain.cell import Cell
from machopt.domain.stiffness import Stiffness
from machopt.model.collision import CollisionModel
from machopt.model.elastic import ArmElasticity
from machopt.model.kinetostatic import characteristic_length
from machopt.model.robot import Robot, load_chain, load_masses


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What to measure, and what it was chosen from."""

    robot: Robot
    collision: CollisionModel | None  # None: not looked for
    length: float  # m, characteristic
    ways: tuple[LoadWay, ...]
    pool: PosePool
    cases: LoadCases
    plan: PosePlan | None  # None: no admissible load test
    apart: Discriminating | None  # of a diagnosis
    noise: ReadingNoise
    warnings: tuple[str, ...]


def measurement(
    request: PosesRequest,
    cell: Cell,
    found: Diagnosed | None,
    progress: Callable[[str], None],
    job: JobLoads | None = None,
) -> Measurement:
    """Choose poses and loads.

    Args:
        request: what was asked, checked.
        cell: the robot cell.
        found: a diagnosis whose explanations are to be told apart; None: the stiffness is to be known.
        progress: told what is being done, in words.
        job: what is to be predicted with it.

    Raises:
        InputError: loads, prior or terms that lead nowhere.
    """
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    asked = Asked(noise_of(request), request.displacement_mm is not None, request.targets_mm / 1e3)
    noise = asked.noise if found is None else noise_for(asked, found, 1)
    size = plan_size(request)
    terms = terms_of(request, robot, T)
    enough_numbers(request, noise.dimensions, 6 + sum(len(t.coefficients) for t in terms))
    stood = based(cell, robot)
    ways, warnings = ways_of(request, stood)
    limits = cell.arm_limits
    masses = load_masses(stood)
    believed = prior_of(request, cell)
    if found is not None:  # as the diagnosis has it
        believed = Stiffness(joints=1.0 / compliance_for(found, believed.joints))
    prior = ArmElasticity(robot, T, believed, limits, masses)
    progress("building kinematics and collision model")
    bare = without_workpiece(cell) if request.without_workpiece else cell
    clearance = request.clearance_mm / 1e3
    collision = None if request.no_collision else CollisionModel(bare, robot, shapes, clearance, still=True)
    length = characteristic_length(robot, T).length
    screen = PoseScreen(
        robot=robot,
        T_flange_tcp=T,
        T_world_base=stood.T_world_base,
        length=length,
        criteria=pose_criteria(request),
        collision=collision,
    )
    progress("looking for poses that can be measured")
    pool = sample_poses(screen, limits, cell.home, size.candidates, size.seed)
    criteria = load_criteria(request, noise)
    if found is not None and found.channel == "position":
        ways = weights_of(request.weights_kg is not None, ways)
        cases = cases_at_rest(pool, ways, prior, criteria, noise, masses)
    else:
        cases = load_cases(pool, ways, prior, terms, criteria, noise)
    plan: PosePlan | None = None
    apart: Discriminating | None = None
    if len(cases) and found is not None:
        weight = masses if masses.mass.sum() > 0 else None
        apart = discriminating(asked, found, cell, robot, weight, pool, cases, ways, prior, size, progress)
        plan, noise = apart.plan, apart.noise
        warnings = (*warnings, *apart.notes)
    elif len(cases):
        plan = plan_poses(
            pool,
            cases,
            screen,
            limits,
            cell.home,
            cell.limits.velocity[:6],
            prior,
            terms,
            ways,
            criteria,
            noise,
            size,
            progress,
            job,
        )
        if job is not None:
            warnings = (*warnings, *said_of(job, plan.joints, float(cases.magnitude.max())))
    return Measurement(
        robot=robot,
        collision=collision,
        length=length,
        ways=ways,
        pool=pool,
        cases=cases,
        plan=plan,
        apart=apart,
        noise=noise,
        warnings=warnings,
    )

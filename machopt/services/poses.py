"""``machopt plan-poses``: which poses and loads to measure so that the stiffness is known as well as wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.design.atrest import cases_at_rest, weights_of
from machopt.design.candidates import PoseScreen, sample_poses
from machopt.design.loadcases import load_cases
from machopt.design.poseplan import PosePlan, plan_poses
from machopt.diagnose.apart.separate import Asked, Discriminating, compliance_for, discriminating, noise_for
from machopt.domain.manifest import ManifestFile, with_scope
from machopt.domain.results.poses import PosesResult
from machopt.domain.stiffness import Stiffness
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.poses import write_poses_csv, write_recording_template
from machopt.model.collision import CollisionModel
from machopt.model.elastic import ArmElasticity
from machopt.model.kinetostatic import characteristic_length
from machopt.model.linkage import refuse_linked
from machopt.model.robot import load_chain, load_masses
from machopt.output import output_folder, write_result
from machopt.report.poses_page import sentence, write_poses_page
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.manifest import write_command_manifest
from machopt.services.poses_diagnosed import diagnosed
from machopt.services.poses_request import (
    Request,
    check,
    load_criteria,
    noise_of,
    plan_size,
    pose_criteria,
    prior_of,
    terms_of,
    unchecked_poses,
    ways_of,
    without_workpiece,
)
from machopt.services.poses_result import cautions, page_of, poses_table, result_of, stepped, template_of

__all__ = ["Outcome", "Request", "run_plan_poses"]


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` is 0, or 3 where no pose can be measured."""

    exit_code: int
    result: PosesResult
    report: Path
    message: str  # one sentence for the user


def run_plan_poses(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Plan load tests and write them out.

    Args:
        request: cell, output folder and options.
        progress: told what is being done, in words.

    Returns:
        The result; ``poses.csv``, ``recording_template/``, ``plan.json`` and ``report.html`` are in the folder. Without
        a single admissible load test only the last two are, and say why.

    Raises:
        InputError: bad cell, option or output folder.
    """
    with in_use(with_effects(request.effects)):
        return _plan_poses(request, progress)


def _plan_poses(request: Request, progress: Callable[[str], None]) -> Outcome:
    check(request)
    progress("reading the cell")
    cell = load_cell(request.cell, allow_external=request.allow_external)
    if cell.external_joints:
        raise InputError("has external joints; poses are planned for arms that stand still", file=request.cell)
    refuse_linked(cell, "plan-poses")
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    found = None if request.discriminate is None else diagnosed(request.discriminate)
    if found is not None and not found.disputes:
        raise InputError(
            "this diagnosis leaves nothing that poses and loads could tell apart",
            file=request.discriminate,
            where="--discriminate",
        )
    asked = Asked(noise_of(request), request.displacement_mm is not None, request.targets_mm / 1e3)
    noise = asked.noise if found is None else noise_for(asked, found, 1)
    size = plan_size(request)
    terms = terms_of(request, robot, T)
    _enough_numbers(request, noise.dimensions, 6 + sum(len(t.coefficients) for t in terms))
    ways, warnings = ways_of(request, cell)
    limits = cell.limits.lower[:6], cell.limits.upper[:6]
    masses = load_masses(cell)
    believed = prior_of(request, cell)
    if found is not None:  # as the diagnosis has it
        believed = Stiffness(1.0 / compliance_for(found, believed.joints))
    prior = ArmElasticity(robot, T, believed, limits, masses)
    progress("building kinematics and collision model")
    bare = without_workpiece(cell) if request.without_workpiece else cell
    collision = None if request.no_collision else CollisionModel(bare, robot, shapes, request.clearance_mm / 1e3)
    length = characteristic_length(robot, T).length
    screen = PoseScreen(robot, T, cell.T_world_base, length, pose_criteria(request), collision)
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
        )
    unchecked = unchecked_poses(request)
    warnings = (*unchecked, *cell.warnings, *warnings, *cautions(request, pool, cases, plan, noise, ways))
    with output_folder(request.out) as folder:
        progress("order of work, clearances, tables")
        hashes = input_hashes(cell)
        result = result_of(request, cell, pool, cases, plan, noise, warnings, hashes, length, ways, apart)
        if plan is not None:
            table = poses_table(plan, pool, ways, collision, cell.home, noise)
            if apart is not None:
                table = stepped(table, apart.steps)
            write_poses_csv(folder / "poses.csv", table)
            if found is None or found.channel == "deflection":
                template = template_of(table, plan, noise, request, () if apart is None else apart.steps)
                write_recording_template(folder / "recording_template", template)
        else:
            table = None
        progress("report")
        page = page_of(request, cell, robot, pool, cases, plan, table, hashes, warnings, apart)
        said = page.reason or sentence(page)
        write_poses_page(folder / "report.html", page)
        write_result(folder / "plan.json", result)
        write_command_manifest(
            folder,
            "plan-poses",
            request,
            cell,
            verdict=said,
            exit_code=0 if plan is not None else 3,
            inputs=_read(request),
            unchecked=unchecked,
        )
    return Outcome(0 if plan is not None else 3, result, request.out / "report.html", with_scope(said, unchecked))


def _read(request: Request) -> tuple[ManifestFile, ...]:
    """What a plan was made from beside its cell."""
    found = () if request.discriminate is None else recording_inputs([request.discriminate], "diagnosis")
    return (*found, *(single(f, "effects") for f in request.effects))


def _enough_numbers(request: Request, dimensions: int, unknowns: int) -> None:
    numbers = request.poses * request.loads * dimensions
    if numbers < unknowns:
        least = -(-unknowns // (request.loads * dimensions))
        raise InputError(
            f"{request.poses} poses with {request.loads} loads give {numbers} numbers for {unknowns} unknowns; "
            f"{least} poses at least, better twice as many",
            where="--poses",
        )

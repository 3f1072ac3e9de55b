"""``machopt plan-poses``: which poses and loads to measure so that the stiffness is known as well as wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.design.candidates import PoseScreen, sample_poses
from machopt.design.loadcases import load_cases
from machopt.design.poseplan import PosePlan, plan_poses
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.outfolder import output_folder, write_json
from machopt.formats.poses import write_poses_csv, write_recording_template
from machopt.job.poses_request import (
    Request,
    check,
    load_criteria,
    noise_of,
    plan_size,
    pose_criteria,
    prior_of,
    terms_of,
    ways_of,
    without_workpiece,
)
from machopt.job.poses_result import cautions, input_hashes, page_of, poses_table, result_of, template_of
from machopt.model.collision import CollisionModel
from machopt.model.elastic import ArmElasticity
from machopt.model.kinetostatic import characteristic_length
from machopt.model.robot import load_chain, load_masses
from machopt.report.poses_page import sentence, write_poses_page

__all__ = ["Outcome", "Request", "run_plan_poses"]


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` is 0, or 3 where no pose can be measured."""

    exit_code: int
    result: dict[str, object]  # plan.json
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
    check(request)
    progress("reading the cell")
    cell = load_cell(request.cell, allow_external=request.allow_external)
    if cell.external_joints:
        raise InputError("has external joints; poses are planned for arms that stand still", file=request.cell)
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    noise, size = noise_of(request), plan_size(request)
    terms = terms_of(request, robot, T)
    _enough_numbers(request, noise.dimensions, 6 + sum(len(t.coefficients) for t in terms))
    ways, warnings = ways_of(request, cell)
    limits = cell.limits.lower[:6], cell.limits.upper[:6]
    prior = ArmElasticity(robot, T, prior_of(request, cell), limits, load_masses(cell))
    progress("building kinematics and collision model")
    bare = without_workpiece(cell) if request.without_workpiece else cell
    collision = None if request.no_collision else CollisionModel(bare, robot, shapes, request.clearance_mm / 1e3)
    length = characteristic_length(robot, T).length
    screen = PoseScreen(robot, T, cell.T_world_base, length, pose_criteria(request), collision)
    progress("looking for poses that can be measured")
    pool = sample_poses(screen, limits, cell.home, size.candidates, size.seed)
    criteria = load_criteria(request, noise)
    cases = load_cases(pool, ways, prior, terms, criteria, noise)
    plan: PosePlan | None = None
    if len(cases):
        plan = plan_poses(
            pool, cases, screen, limits, cell.home, cell.limits.velocity[:6], prior, terms, ways, criteria, noise,
            size, progress,
        )  # fmt: skip
    warnings = (*cell.warnings, *warnings, *cautions(request, pool, cases, plan, noise, ways))
    with output_folder(request.out) as folder:
        progress("order of work, clearances, tables")
        hashes = input_hashes(cell)
        result = result_of(request, cell, pool, cases, plan, noise, warnings, hashes, length, ways)
        if plan is not None:
            table = poses_table(plan, pool, ways, collision, cell.home, noise)
            write_poses_csv(folder / "poses.csv", table)
            write_recording_template(folder / "recording_template", template_of(table, plan, noise, request))
        else:
            table = None
        progress("report")
        page = page_of(request, cell, robot, pool, cases, plan, table, hashes, warnings)
        write_poses_page(folder / "report.html", page)
        write_json(folder / "plan.json", result)
    return Outcome(0 if plan is not None else 3, result, request.out / "report.html", page.reason or sentence(page))


def _enough_numbers(request: Request, dimensions: int, unknowns: int) -> None:
    numbers = request.poses * request.loads * dimensions
    if numbers < unknowns:
        least = -(-unknowns // (request.loads * dimensions))
        raise InputError(
            f"{request.poses} poses with {request.loads} loads give {numbers} numbers for {unknowns} unknowns; "
            f"{least} poses at least, better twice as many",
            where="--poses",
        )

"""``machopt plan-poses``: which poses and loads to measure so that the stiffness is known as well as wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.design.asked import (
    Request,
    check,
    unchecked_poses,
)
from machopt.design.cautions import cautions
from machopt.design.told import result_of
from machopt.design.work import poses_table, stepped, template_of
from machopt.diagnose.apart.measure import measurement
from machopt.diagnose.apart.told import apart_told
from machopt.domain.manifest import ManifestFile, with_scope
from machopt.domain.results.poses import PosesResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.poses import write_poses_csv, write_recording_template
from machopt.model.linkage import refuse_linked
from machopt.output import output_folder, write_result
from machopt.report.gather.poses import page_of
from machopt.report.poses_page import sentence, write_poses_page
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.manifest import write_command_manifest
from machopt.services.poses_diagnosed import diagnosed

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
    found = None if request.discriminate is None else diagnosed(request.discriminate)
    if found is not None and not found.disputes:
        raise InputError(
            "this diagnosis leaves nothing that poses and loads could tell apart",
            file=request.discriminate,
            where="--discriminate",
        )
    m = measurement(request, cell, found, progress)
    unchecked, code = unchecked_poses(request), 0 if m.plan is not None else 3
    said = cautions(request, m.pool, m.cases, m.plan, m.noise, m.ways)
    warnings = (*unchecked, *cell.warnings, *m.warnings, *said)
    with output_folder(request.out) as folder:
        progress("order of work, clearances, tables")
        hashes = input_hashes(cell)
        told = None if m.apart is None else apart_told(m.apart)
        result = result_of(request, cell, m.pool, m.cases, m.plan, m.noise, warnings, hashes, m.length, m.ways, told)
        table = None
        if m.plan is not None:
            table = poses_table(m.plan, m.pool, m.ways, m.collision, cell.home, m.noise)
            steps = () if m.apart is None else m.apart.steps
            table = table if m.apart is None else stepped(table, steps)
            write_poses_csv(folder / "poses.csv", table)
            if found is None or found.channel == "deflection":
                template = template_of(table, m.plan, m.noise, request, steps)
                write_recording_template(folder / "recording_template", template)
        progress("report")
        page = page_of(request, cell, m.robot, m.pool, m.cases, m.plan, table, hashes, warnings, m.apart)
        verdict = page.reason or sentence(page)
        write_poses_page(folder / "report.html", page)
        write_result(folder / "plan.json", result)
        write_command_manifest(
            folder,
            "plan-poses",
            request,
            cell,
            verdict=verdict,
            exit_code=code,
            inputs=_read(request),
            unchecked=unchecked,
        )
    return Outcome(code, result, request.out / "report.html", with_scope(verdict, unchecked))


def _read(request: Request) -> tuple[ManifestFile, ...]:
    """What a plan was made from beside its cell."""
    found = () if request.discriminate is None else recording_inputs([request.discriminate], "diagnosis")
    return (*found, *(single(f, "effects") for f in request.effects))

"""Load tests in memory: everything that ``machopt plan-poses`` computes before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from machopt.design.asked import (
    PosesRequest,
    check,
    unchecked_poses,
)
from machopt.design.cautions import cautions
from machopt.design.held import held_at, standing_of
from machopt.design.told import result_of
from machopt.design.work import poses_table, stepped, template_of
from machopt.diagnose.apart.measure import measurement
from machopt.diagnose.apart.told import apart_told
from machopt.domain.cell import Cell
from machopt.domain.manifest import with_scope
from machopt.domain.poses import PosesTable
from machopt.domain.recording import Recording
from machopt.domain.results.poses import PosesResult
from machopt.domain.stiffness import held_over
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.model.linkage import refuse_linked
from machopt.report.gather.poses import page_of
from machopt.report.gather.scene import scene_of
from machopt.report.poses_data import PosesPage
from machopt.report.poses_page import sentence
from machopt.services.inputs import input_hashes
from machopt.services.poses_diagnosed import diagnosed
from machopt.services.poses_job import job_of


@dataclass(frozen=True, kw_only=True)
class Planned:
    """Load tests in memory: nothing of them is written yet."""

    request: PosesRequest
    cell: Cell
    table: PosesTable | None  # None where no pose can be measured
    template: Recording | None
    page: PosesPage
    result: PosesResult
    verdict: str

    @property
    def exit_code(self) -> int:
        return 0 if self.table is not None else 3

    @property
    def message(self) -> str:
        """One sentence, with what was not checked."""
        return with_scope(self.verdict, unchecked_poses(self.request))


def planned(request: PosesRequest, progress: Callable[[str], None], cell: Cell | None = None) -> Planned:
    """The load tests.

    Args:
        request: what was asked; its ``out`` is not looked at.
        cell: where it has been read already.
    """
    check(request)
    progress("reading the cell")
    cell = load_cell(request.cell, allow_external=request.allow_external) if cell is None else cell
    cell = held_at(cell, request.external)
    refuse_linked(cell, "plan-poses")
    found = None if request.discriminate is None else diagnosed(request.discriminate)
    if found is not None and not found.disputes:
        raise InputError(
            "this diagnosis leaves nothing that poses and loads could tell apart",
            file=request.discriminate,
            where="--discriminate",
        )
    job = job_of(request, cell)
    m = measurement(request, cell, found, progress, job)
    said = cautions(request, m.pool, m.cases, m.plan, m.noise, m.ways)
    stands = standing_of(cell)
    rigid = () if cell.stiffness is None else held_over(cell.stiffness.external)
    warnings = (*unchecked_poses(request), *([stands] if stands else []), *rigid, *cell.warnings, *m.warnings, *said)
    progress("order of work, clearances, tables")
    hashes = input_hashes(cell)
    told = None if m.apart is None else apart_told(m.apart)
    steps = (1.0,) if m.plan is None else m.plan.steps if m.apart is None else m.apart.steps
    result = result_of(request, cell, m.pool, m.cases, m.plan, m.noise, warnings, hashes, m.length, m.ways, told, job)
    table = template = None
    if m.plan is not None:
        table = poses_table(m.plan, m.pool, m.ways, m.collision, cell.home, m.noise)
        table = stepped(table, steps)
        if found is None or found.channel == "deflection":
            template = template_of(table, m.plan, m.noise, request, steps)
            template = replace(template, notes=f"{template.notes} Note: {stands}." if stands else template.notes)
    scene = None if m.collision is None else scene_of(cell, m.robot, m.collision.bodies)
    page = page_of(request, cell, m.robot, m.pool, m.cases, m.plan, table, hashes, warnings, m.apart, scene, job)
    verdict = page.reason or sentence(page)
    return Planned(
        request=request, cell=cell, table=table, template=template, page=page, result=result, verdict=verdict
    )

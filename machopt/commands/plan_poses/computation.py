"""Computation of ``machopt plan-poses`` in memory, before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from machopt.cell.cell_reader import load_cell
from machopt.commands.input_hashes import compute_input_hashes
from machopt.commands.plan_poses.diagnosis_input import read_diagnosis
from machopt.commands.plan_poses.job_loads import read_job_loads
from machopt.data_types.cell import Cell
from machopt.data_types.documents.pose_plan_document import PosesDocument
from machopt.data_types.manifest import add_scope_to_verdict
from machopt.data_types.measurements.measurement_poses_table import PosesTable
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import describe_ignored_springs
from machopt.errors import OptionError
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.measurement.design.external_axis_position_option import (
    describe_external_axis_positions,
    set_external_axis_positions,
)
from machopt.measurement.design.measurement_plan_document import PlannedMeasurement, build_measurement_plan_document
from machopt.measurement.design.measurement_table_and_empty_recording import (
    build_poses_table,
    build_recording_template,
    expand_load_steps,
)
from machopt.measurement.design.plan_warnings import build_plan_warnings
from machopt.measurement.design.request import PosesRequest, list_unchecked_conditions
from machopt.measurement.design.request_checks import check_poses_request
from machopt.measurement.diagnosis.discrimination.discrimination_document import build_discrimination_document
from machopt.measurement.diagnosis.discrimination.next_measurement import plan_next_measurement
from machopt.report.page_data.machine_scene import build_machine_scene
from machopt.report.page_data.pose_plan import build_pose_plan_page_data
from machopt.report.page_types.pose_plan_page_data import PosePlanPageData
from machopt.report.pages.pose_plan_page import format_verdict_sentence


@dataclass(frozen=True, kw_only=True)
class PlanPosesComputation:
    """Planned load tests in memory, not written yet."""

    request: PosesRequest
    cell: Cell
    table: PosesTable | None  # None where no pose can be measured
    template: Recording | None
    page: PosePlanPageData
    result: PosesDocument
    verdict: str

    @property
    def exit_code(self) -> int:
        return 0 if self.table is not None else 3

    @property
    def message(self) -> str:
        """One sentence, with what was not checked."""
        return add_scope_to_verdict(self.verdict, list_unchecked_conditions(self.request))


def compute_pose_plan(
    request: PosesRequest, progress: Callable[[str], None], cell: Cell | None = None
) -> PlanPosesComputation:
    """Return the planned load tests.

    Args:
        request: The validated request; its ``out`` is not used.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.
    """
    check_poses_request(request)
    progress("reading the cell")
    cell = load_cell(request.cell, allow_external=request.allow_external) if cell is None else cell
    cell = set_external_axis_positions(cell, request.external)
    check_no_mimic_joints(cell, "plan-poses")
    found = None if request.discriminate is None else read_diagnosis(request.discriminate)
    if found is not None and not found.rival_sets:
        raise OptionError(
            "this diagnosis left no explanations that poses and loads could separate",
            file=request.discriminate,
            where="--discriminate",
        )
    job = read_job_loads(request, cell)
    m = plan_next_measurement(request, cell, found, progress, job)
    plan_warnings = build_plan_warnings(request, m.pool, m.cases, m.plan, m.noise, m.load_methods)
    fixed_positions = describe_external_axis_positions(cell)
    rigid = () if cell.stiffness is None else describe_ignored_springs(cell.stiffness.external)
    warnings = (
        *list_unchecked_conditions(request),
        *([fixed_positions] if fixed_positions else []),
        *rigid,
        *cell.warnings,
        *m.warnings,
        *plan_warnings,
    )
    progress("order of work, clearances, tables")
    hashes = compute_input_hashes(cell)
    discrimination = None if m.discrimination is None else build_discrimination_document(m.discrimination)
    steps = (1.0,) if m.plan is None else m.plan.steps if m.discrimination is None else m.discrimination.steps
    planned = PlannedMeasurement(
        pool=m.pool, cases=m.cases, plan=m.plan, noise=m.noise, length=m.length, load_methods=m.load_methods
    )
    result = build_measurement_plan_document(request, cell, planned, warnings, hashes, discrimination, job)
    table = template = None
    if m.plan is not None:
        table = build_poses_table(m.plan, m.pool, m.load_methods, m.collision, cell.home, m.noise)
        table = expand_load_steps(table, steps)
        if found is None or found.channel == "deflection":
            template = build_recording_template(table, m.plan, m.noise, request, steps)
            template = replace(
                template, notes=f"{template.notes} Note: {fixed_positions}." if fixed_positions else template.notes
            )
    scene = None if m.collision is None else build_machine_scene(cell, m.robot, m.collision.bodies)
    page = build_pose_plan_page_data(request, cell, m, table, hashes, warnings, scene, job)
    verdict = page.reason or format_verdict_sentence(page)
    return PlanPosesComputation(
        request=request, cell=cell, table=table, template=template, page=page, result=result, verdict=verdict
    )

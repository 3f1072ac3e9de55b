"""The document plan.json of a measurement plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.pose_plan_document import (
    BaselineDesignEntry,
    DesignQualitySection,
    DiscriminationSection,
    JobJointEntry,
    JobSection,
    LoadCasesSection,
    PoseCandidatesSection,
    PosesDocument,
    UncertaintyCurveSection,
    UncertaintyTargetSection,
    UnknownParameterEntry,
    WorkStepEntry,
)
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.measurement_plan import HeuristicComparison, MeasurementPlan
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.design.request import PosesRequest, list_request_options
from machopt.measurement.design.torque_reversal_loads import ProcessLoads
from machopt.version import __version__


@dataclass(frozen=True, kw_only=True)
class PlannedMeasurement:
    """Candidates of a measurement and the plan."""

    pool: PosePool
    cases: LoadCases  # admissible ones
    plan: MeasurementPlan | None  # None without admissible load cases
    noise: ReadingNoise
    length: float  # m, characteristic length of the conditioning index
    load_methods: Sequence[LoadMethod]


def _build_design_section(plan: MeasurementPlan) -> DesignQualitySection:
    found, assessed = plan.accuracy, plan.accuracy_by_belief
    return DesignQualitySection(
        condition_number=found.condition,
        rms=found.rms(assessed),
        worst=found.worst(assessed),
        log_det=plan.design.value,
        d_efficiency_at_least=plan.bound,
        worst_if_prior_wrong=tuple(a.worst(assessed) for a in plan.believed_values),
    )


def build_measurement_plan_document(
    request: PosesRequest,
    cell: Cell,
    planned: PlannedMeasurement,
    warnings: Sequence[str],
    hashes: dict[str, str],
    discriminate: DiscriminationSection | None = None,
    job: ProcessLoads | None = None,
) -> PosesDocument:
    """Build the document plan.json; relative uncertainties refer to the prior value.

    Args:
        request: Validated user request.
        cell: Robot cell.
        planned: Candidates and the plan.
        warnings: Warnings of the plan.
        hashes: Hashes of the input files.
        discriminate: Section of a plan that discriminates between explanations.
        job: Process loads, or None.

    Returns:
        The document.
    """
    pool, cases, plan = planned.pool, planned.cases, planned.plan
    head = PosesDocument(
        machopt_poses=1,
        version=__version__,
        verdict="done" if plan is not None else "infeasible",
        inputs=hashes,
        options=dict(list_request_options(request)),
        cell=cell.name,
        characteristic_length_mm=planned.length * 1e3,
        reading_uncertainty_mm=planned.noise.reading * 1e3,
        candidates=PoseCandidatesSection(poses=len(pool), tried=pool.drawn_count, rejected=pool.rejected),
        load_cases=LoadCasesSection(ways=len(planned.load_methods), admissible=len(cases), rejected=cases.rejected),
        warnings=tuple(warnings),
    )
    if plan is None:
        return head
    found, poses = plan.accuracy, len(plan.design.blocks)
    steps = len(plan.steps if discriminate is None else discriminate.steps)
    sections = {
        "poses": poses,
        "readings": len(plan.visits) * steps,
        "load_cases_chosen": len(plan.design.readings),
        "unknowns": _build_unknown_entries(plan),
        "not_told_apart": tuple(tuple(plan.unknowns.names[p] for p in group) for group in found.unidentified_groups),
        "design": _build_design_section(plan),
        "target": _build_target_section(plan, request, steps),
        "curve": UncertaintyCurveSection(poses=plan.curve_poses, rms=plan.curve),
        "heuristics": tuple(_build_heuristic_entry(c) for c in plan.comparisons),
        "order": tuple(WorkStepEntry(pose=v.pose + 1, cycle=v.cycle + 1, session=v.round + 1) for v in plan.visits),
    }
    more: dict[str, DiscriminationSection | JobSection] = {} if discriminate is None else {"discriminate": discriminate}
    more |= {} if job is None else {"job": _build_job_entry(job, plan)}
    return head.model_copy(update=sections | more)


def _build_target_section(plan: MeasurementPlan, request: PosesRequest, steps: int) -> UncertaintyTargetSection | None:
    if request.target_percent is None:
        return None
    poses = plan.needed_poses
    readings = None if poses is None else poses * request.loads * request.cycles * steps
    return UncertaintyTargetSection(percent=request.target_percent, poses=poses, readings=readings)


def _build_job_entry(job: ProcessLoads, plan: MeasurementPlan) -> JobSection:
    return JobSection(
        source=job.words,
        force_N=job.force,
        steps=plan.steps,
        joints=tuple(
            JobJointEntry(
                joint=j.joint,
                job_Nm=j.job,
                tests_Nm=j.tests,
                turns_round=j.is_reversed_in_job,
                play_noncentrality=j.backlash_noncentrality,
                play_shows=j.detects_backlash,
            )
            for j in plan.joints
        ),
    )


def _build_unknown_entries(plan: MeasurementPlan) -> tuple[UnknownParameterEntry, ...]:
    u = plan.unknowns
    rows = zip(u.names, u.units, u.scale.tolist(), u.relative.tolist(), plan.accuracy.sigma.tolist(), strict=True)
    return tuple(
        UnknownParameterEntry(name=n, unit=unit, scale=s, relative=r, standard_uncertainty=e, seen=bool(np.isfinite(e)))
        for n, unit, s, r, e in rows
    )


def _build_heuristic_entry(c: HeuristicComparison) -> BaselineDesignEntry:
    return BaselineDesignEntry(
        name=c.name,
        poses=c.poses,
        rms_10_50_90=c.rms,
        standard_uncertainty=tuple(c.sigma.tolist()),
        d_efficiency=c.efficiency[0],
        a_efficiency=c.efficiency[1],
        e_efficiency=c.efficiency[2],
        readings_for_the_same=c.readings,
        curve_rms=tuple(c.curve),
    )

"""A measurement plan as plan.json."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.design.asked import PosesRequest, shown
from machopt.design.candidates import PosePool
from machopt.design.joblike import JobLoads
from machopt.design.loadcases import LoadCases
from machopt.design.loads import LoadWay
from machopt.design.measurement import ReadingNoise
from machopt.design.poseplan import Comparison, PosePlan
from machopt.domain.cell import Cell
from machopt.domain.results.poses import (
    CandidatesTold,
    CurveTold,
    DesignTold,
    DiscriminateTold,
    HeuristicTold,
    JobJointTold,
    JobTold,
    LoadCasesTold,
    PosesResult,
    TargetTold,
    UnknownTold,
    Visit,
)
from machopt.version import __version__


def result_of(
    request: PosesRequest,
    cell: Cell,
    pool: PosePool,
    cases: LoadCases,
    plan: PosePlan | None,
    noise: ReadingNoise,
    warnings: Sequence[str],
    hashes: dict[str, str],
    length: float,
    ways: Sequence[LoadWay],
    discriminate: DiscriminateTold | None = None,
    job: JobLoads | None = None,
) -> PosesResult:
    """plan.json; relative uncertainties are shares of the prior value.

    Args:
        discriminate: of a plan that tells explanations apart.
        job: what the arm is measured for.
    """
    head = PosesResult(
        machopt_poses=1,
        version=__version__,
        verdict="done" if plan is not None else "infeasible",
        inputs=hashes,
        options=dict(shown(request)),
        cell=cell.name,
        characteristic_length_mm=length * 1e3,
        reading_uncertainty_mm=noise.reading * 1e3,
        candidates=CandidatesTold(poses=len(pool), tried=pool.tried, rejected=pool.rejected),
        load_cases=LoadCasesTold(ways=len(ways), admissible=len(cases), rejected=cases.rejected),
        warnings=tuple(warnings),
    )
    if plan is None:
        return head
    found, poses, target = plan.found, len(plan.design.blocks), request.target_percent
    steps = len(plan.steps if discriminate is None else discriminate.steps)
    planned = {
        "poses": poses,
        "readings": len(plan.visits) * steps,
        "load_cases_chosen": len(plan.design.readings),
        "unknowns": _unknowns(plan),
        "not_told_apart": tuple(tuple(plan.unknowns.names[p] for p in group) for group in found.unseen),
        "design": DesignTold(
            condition_number=found.condition,
            rms=found.rms(plan.judged),
            worst=found.worst(plan.judged),
            log_det=plan.design.value,
            d_efficiency_at_least=plan.bound,
            worst_if_prior_wrong=tuple(a.worst(plan.judged) for a in plan.believed),
        ),
        "target": None
        if target is None
        else TargetTold(
            percent=target,
            poses=plan.needed,
            readings=None if plan.needed is None else plan.needed * request.loads * request.cycles * steps,
        ),
        "curve": CurveTold(poses=plan.curve_poses, rms=plan.curve),
        "heuristics": tuple(_comparison(c) for c in plan.comparisons),
        "order": tuple(Visit(pose=v.pose + 1, cycle=v.cycle + 1, session=v.round + 1) for v in plan.visits),
    }
    more: dict[str, DiscriminateTold | JobTold] = {} if discriminate is None else {"discriminate": discriminate}
    more |= {} if job is None else {"job": _job(job, plan)}
    return head.model_copy(update=planned | more)


def _job(job: JobLoads, plan: PosePlan) -> JobTold:
    return JobTold(
        source=job.words,
        force_N=job.force,
        steps=plan.steps,
        joints=tuple(
            JobJointTold(
                joint=j.joint,
                job_Nm=j.job,
                tests_Nm=j.tests,
                turns_round=j.turns_round,
                play_noncentrality=j.play,
                play_shows=j.shows,
            )
            for j in plan.joints
        ),
    )


def _unknowns(plan: PosePlan) -> tuple[UnknownTold, ...]:
    u = plan.unknowns
    rows = zip(u.names, u.units, u.scale.tolist(), u.relative.tolist(), plan.found.sigma.tolist(), strict=True)
    return tuple(
        UnknownTold(name=n, unit=unit, scale=s, relative=r, standard_uncertainty=e, seen=bool(np.isfinite(e)))
        for n, unit, s, r, e in rows
    )


def _comparison(c: Comparison) -> HeuristicTold:
    return HeuristicTold(
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

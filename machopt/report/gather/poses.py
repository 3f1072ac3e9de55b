"""The page of a measurement plan from the plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.design.asked import PosesRequest, shown
from machopt.design.candidates import PosePool
from machopt.design.joblike import JobLoads
from machopt.design.loadcases import LoadCases
from machopt.design.maximin import needed_noncentrality
from machopt.design.poseplan import PosePlan
from machopt.diagnose.apart.separate import Discriminating, described
from machopt.domain.cell import Cell
from machopt.domain.poses import PosesTable
from machopt.model.robot import Robot
from machopt.report import poses_data as page
from machopt.report.display import FINE_LENGTH, LENGTH
from machopt.report.scene import Postures, Scene, Vectors
from machopt.version import __version__


def page_of(
    request: PosesRequest,
    cell: Cell,
    robot: Robot,
    pool: PosePool,
    cases: LoadCases,
    plan: PosePlan | None,
    table: PosesTable | None,
    hashes: dict[str, str],
    warnings: Sequence[str],
    apart: Discriminating | None = None,
    scene: Scene | None = None,
    job: JobLoads | None = None,
) -> page.PosesPage:
    """Everything the page shows."""
    common: dict[str, Any] = {
        "title": f"{'Load tests' if apart is None else 'Next measurement'} for {cell.name}",
        "cell": cell.name,
        "version": __version__,
        "tried": pool.tried,
        "passed": len(pool),
        "cases": len(cases),
        "rejected_poses": tuple(pool.rejected.items()),
        "rejected_loads": tuple(cases.rejected.items()),
        "warnings": tuple(warnings),
        "options": tuple(shown(request)),
        "hashes": tuple(hashes.items()),
    }
    if plan is None or table is None:
        return page.PosesPage(**common, reason=warnings[-1])
    u, steps = plan.unknowns, plan.steps if apart is None else apart.steps
    chosen = pool.q[plan.cases.pose[[b[0] for b in plan.design.blocks]]]
    return page.PosesPage(
        **common,
        apart=() if apart is None else _pairs(apart),
        rounds=0 if apart is None else apart.noise.cycles,
        enough=needed_noncentrality(),
        unknowns=u.names,
        relative=u.relative,
        sigma=plan.found.sigma,
        rms=plan.found.rms(plan.judged),
        condition=plan.found.condition,
        bound=plan.bound,
        poses=len(chosen),
        readings=len(table),
        per_pose=request.loads * len(plan.visits) * len(steps) // max(len(plan.design.readings), 1),
        heuristics=_heuristics(plan),
        curve_poses=plan.curve_poses,
        curve=np.array(plan.curve),
        target=_share(request.target_percent),
        needed=plan.needed,
        cloud=pool.T_base_tcp[:CLOUD, :3, 3],
        job=()
        if job is None
        else tuple(page.Asked(joint=j.joint, job=j.job, tests=j.tests, shows=j.shows) for j in plan.joints),
        steps=steps,
        arms=_arm_points(robot, chosen, cell),
        scene=scene,
        postures=_postures(chosen, table, cell.external_home),
        work=_work(table),
    )


def _heuristics(plan: PosePlan) -> tuple[page.Heuristic, ...]:
    return tuple(
        page.Heuristic(
            name=c.name,
            words=SOURCES[c.name],
            poses=c.poses,
            sigma=c.sigma,
            rms=c.rms,
            efficiency=c.efficiency,
            readings=c.readings,
            curve=np.array(c.curve),
        )
        for c in plan.comparisons
    )


def _pairs(apart: Discriminating) -> tuple[page.Apart, ...]:
    """Each pair of explanations, and how the plan tells them apart."""
    return tuple(
        page.Apart(
            pair=described(p),
            why=p.why,
            per_cycle=p.per_cycle,
            planned=p.planned,
            told=p.told,
            cycles=p.cycles,
            until=p.until,
            random=p.random,
            advice=p.advice,
        )
        for p in apart.pairs
    )


def _work(table: PosesTable) -> page.Work:
    """The readings in the order in which they are taken."""
    return page.Work(
        session=table.session,
        pose=table.pose,
        cycle=table.cycle,
        q=table.q,
        load=table.load,
        deflection=np.linalg.norm(table.displacement[:, :3], axis=1),
        kci=table.kci,
        nu_p=table.nu_p,
        clearance=table.clearance,
        way_free=table.way_free,
    )


def _postures(chosen: Array, table: PosesTable, external: Array) -> Postures:
    """The poses in the order they are chosen in, with the first load of each; external joints stand at (E,)."""
    rows = [np.flatnonzero(np.isclose(table.q, q).all(axis=1)) for q in chosen]
    known = [n for n, found in enumerate(rows) if len(found)]
    first = [int(rows[n][0]) for n in known]
    return Postures(
        q=np.hstack([chosen[known], np.broadcast_to(external, (len(known), len(external)))]),
        label="Pose",
        names=tuple(f"Pose {table.pose[k]}" for k in first),
        words=tuple(
            (
                ("Readings", str(len(rows[n]))),
                ("First load", table.load[k]),
                ("Displacement", FINE_LENGTH.text(float(np.linalg.norm(table.displacement[k, :3])), unit=True)),
                ("Clearance", LENGTH.text(float(table.clearance[k]), unit=True)),
            )
            for n, k in zip(known, first, strict=True)
        ),
        vectors=(
            Vectors("force of the pose's first load", "#d61f69", table.wrench[first, :3]),
            Vectors("displacement that it is expected to make", "#1d9a6c", table.displacement[first, :3]),
        ),
    )


def _share(percent: float | None) -> float:
    return float("nan") if percent is None else percent / 100


def _arm_points(robot: Robot, q: Array, cell: Cell) -> Array:
    """(B, 8, 3) m: points on the six axes, flange and TCP of each pose, in base_link."""
    bodies = robot.link_poses(q)
    on_axes = [np.einsum("bij,j->bi", bodies[:, i, :3, :3], robot.point[i]) + bodies[:, i, :3, 3] for i in range(6)]
    ends = [robot.fk(q)[:, :3, 3], robot.fk(q, cell.tool.T_flange_tcp)[:, :3, 3]]
    return np.stack([*on_axes, *ends], axis=1)


CLOUD = 600  # candidates drawn on the page
SOURCES = {
    "random": "any pose that can be reached and loaded",
    "dumas2011": "zones of good dexterity with low ν_p",
    "zhang2025": "KCI above 0.45",
    "jiao2022": "corners and centre of a cube, ±10°",
}

"""Data of the measurement plan page from the plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.measurement_poses_table import PosesTable
from machopt.kinematics.robot import Robot
from machopt.measurement.design.maximin_discrimination import compute_required_noncentrality
from machopt.measurement.design.measurement_plan import MeasurementPlan
from machopt.measurement.design.request import PosesRequest, list_request_options
from machopt.measurement.design.torque_reversal_loads import ProcessLoads
from machopt.measurement.diagnosis.discrimination.next_measurement import NextMeasurement
from machopt.measurement.diagnosis.discrimination.rival_pairs import DiscriminationPlan, format_pair
from machopt.numerics.array_types import Array
from machopt.report.page_types import pose_plan_page_data as page
from machopt.report.page_types.display_units import FINE_LENGTH, LENGTH
from machopt.report.scene.scene_types import CellScene, PostureVectors, ScenePostures
from machopt.version import __version__


def build_pose_plan_page_data(
    request: PosesRequest,
    cell: Cell,
    measurement: NextMeasurement,
    table: PosesTable | None,
    hashes: dict[str, str],
    warnings: Sequence[str],
    scene: CellScene | None = None,
    job: ProcessLoads | None = None,
) -> page.PosePlanPageData:
    """Return everything that the page shows.

    Args:
        request: The request of ``machopt plan-poses``.
        cell: The robot cell.
        measurement: Candidate poses, load cases and the plan, if one was computed.
        table: Table of the poses; None without a plan.
        hashes: SHA-256 of the input files by name.
        warnings: Warnings to show.
        scene: The cell for the 3-D view; None without one.
        job: Loads of the job that the stiffness is needed for; None without one.
    """
    pool, cases, plan, apart = measurement.pool, measurement.cases, measurement.plan, measurement.discrimination
    head = page.PosePlanPageData(
        title=f"{'Load tests' if apart is None else 'Next measurement'} for {cell.name}",
        cell=cell.name,
        version=__version__,
        tried=pool.drawn_count,
        passed=len(pool),
        cases=len(cases),
        rejected_poses=tuple(pool.rejected.items()),
        rejected_loads=tuple(cases.rejected.items()),
        warnings=tuple(warnings),
        options=tuple(list_request_options(request)),
        hashes=tuple(hashes.items()),
    )
    if plan is None or table is None:
        return replace(head, reason=warnings[-1])
    head = replace(head, scene=scene, job=() if job is None else _list_joint_demands(plan))
    return _add_plan(head, request, cell, measurement, plan, table)


def _add_plan(
    head: page.PosePlanPageData,
    request: PosesRequest,
    cell: Cell,
    measurement: NextMeasurement,
    plan: MeasurementPlan,
    table: PosesTable,
) -> page.PosePlanPageData:
    """Return the data of the page with those of the plan and its table."""
    pool, apart = measurement.pool, measurement.discrimination
    u, steps = plan.unknowns, plan.steps if apart is None else apart.steps
    chosen = pool.q[plan.cases.pose[[b[0] for b in plan.design.blocks]]]
    return replace(
        head,
        explanation_pairs=() if apart is None else _list_explanation_pairs(apart),
        rounds=0 if apart is None else apart.noise.cycles,
        required_noncentrality=compute_required_noncentrality(),
        unknowns=u.names,
        relative=u.relative,
        sigma=plan.accuracy.sigma,
        rms=plan.accuracy.rms(plan.accuracy_by_belief),
        condition=plan.accuracy.condition,
        bound=plan.bound,
        poses=len(chosen),
        readings=len(table),
        per_pose=request.loads * len(plan.visits) * len(steps) // max(len(plan.design.readings), 1),
        heuristics=_list_heuristics(plan),
        curve_poses=plan.curve_poses,
        curve=np.array(plan.curve),
        target=_convert_percent(request.target_percent),
        needed=plan.needed_poses,
        cloud=pool.T_base_tcp[:MAX_CLOUD_POINTS, :3, 3],
        steps=steps,
        arms=_compute_arm_points(measurement.robot, chosen, cell),
        postures=_build_postures(chosen, table, cell.external_home),
        work=_build_load_cycles(table),
    )


def _list_joint_demands(plan: MeasurementPlan) -> tuple[page.JointDemand, ...]:
    return tuple(
        page.JointDemand(joint=j.joint, job=j.job, tests=j.tests, shows_play=j.detects_backlash) for j in plan.joints
    )


def _list_heuristics(plan: MeasurementPlan) -> tuple[page.HeuristicRow, ...]:
    return tuple(
        page.HeuristicRow(
            name=c.name,
            words=HEURISTIC_SOURCES[c.name],
            poses=c.poses,
            sigma=c.sigma,
            rms=c.rms,
            efficiency=c.efficiency,
            readings=c.readings,
            curve=np.array(c.curve),
        )
        for c in plan.comparisons
    )


def _list_explanation_pairs(apart: DiscriminationPlan) -> tuple[page.ExplanationPair, ...]:
    """Each pair of explanations, and how well the plan separates them."""
    return tuple(
        page.ExplanationPair(
            pair=format_pair(p),
            why=p.reason,
            per_cycle=p.per_cycle,
            planned=p.planned,
            is_distinguished=p.is_separated,
            cycles=p.cycles,
            cycles_until_excluded=p.required_cycles,
            random=p.random,
            advice=p.advice,
        )
        for p in apart.pairs
    )


def _build_load_cycles(table: PosesTable) -> page.LoadCycles:
    """The readings in the order in which they are taken."""
    return page.LoadCycles(
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


def _build_postures(chosen: Array, table: PosesTable, external: Array) -> ScenePostures:
    """The poses in the order they are chosen in, with the first load of each; external joints stand at (E,)."""
    rows = [np.flatnonzero(np.isclose(table.q, q).all(axis=1)) for q in chosen]
    known = [n for n, found in enumerate(rows) if len(found)]
    first = [int(rows[n][0]) for n in known]
    return ScenePostures(
        q=np.hstack([chosen[known], np.broadcast_to(external, (len(known), len(external)))]),
        label="Pose",
        names=tuple(f"Pose {table.pose[k]}" for k in first),
        words=tuple(
            (
                ("Readings", str(len(rows[n]))),
                ("First load", table.load[k]),
                ("Displacement", FINE_LENGTH.format_value(float(np.linalg.norm(table.displacement[k, :3])), unit=True)),
                ("Clearance", LENGTH.format_value(float(table.clearance[k]), unit=True)),
            )
            for n, k in zip(known, first, strict=True)
        ),
        vectors=(
            PostureVectors("force of the pose's first load", "#d61f69", table.wrench[first, :3]),
            PostureVectors("displacement that it is expected to make", "#1d9a6c", table.displacement[first, :3]),
        ),
    )


def _convert_percent(percent: float | None) -> float:
    return float("nan") if percent is None else percent / 100


def _compute_arm_points(robot: Robot, q: Array, cell: Cell) -> Array:
    """(B, 8, 3) m: points on the six axes, flange and TCP of each pose, in base_link."""
    bodies = robot.compute_link_poses(q)
    on_axes = [np.einsum("bij,j->bi", bodies[:, i, :3, :3], robot.point[i]) + bodies[:, i, :3, 3] for i in range(6)]
    ends = [robot.compute_fk(q)[:, :3, 3], robot.compute_fk(q, cell.tool.T_flange_tcp)[:, :3, 3]]
    return np.stack([*on_axes, *ends], axis=1)


MAX_CLOUD_POINTS = 600  # candidates drawn on the page
HEURISTIC_SOURCES = {
    "random": "any pose that can be reached and loaded",
    "dumas2011": "zones of good dexterity with low ν_p",
    "zhang2025": "KCI above 0.45",
    "jiao2022": "corners and centre of a cube, ±10°",
}

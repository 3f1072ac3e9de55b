"""3-D scene of the optimize report: toolpath, motion, and a posture for every cell of the rotation map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.process_columns import OUTCOMES
from machopt.data_types.toolpath import Toolpath
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.plan_output.collision_map import CollisionMap, find_cut_stations
from machopt.planning.plan_output.point_table import PointResults
from machopt.report.page_data.machine_scene import build_bodies, build_machine_scene
from machopt.report.page_data.optimize_series import compute_cut_length, interpolate_path_length
from machopt.report.scene.scene_types import (
    CellScene,
    MotionScene,
    OptimizeScene,
    SceneBody,
    StationPostures,
    ToolpathScene,
)

MAX_PATH_POINTS = 20_000  # points of the toolpath that are drawn; of a longer one every so many


def build_optimize_scene(
    plan: Plan,
    toolpath: Toolpath,
    points: PointResults,
    timeline: MotionTimeline | None,
    collision_map: CollisionMap,
    index: Array,
) -> OptimizeScene:
    """Return everything that the 3-D view shows.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        timeline: The motion over time; None where there is no motion.
        collision_map: The map of feasible rotations and branches.
        index: (N,) stiffness index of the plan, in the quantity of the page.
    """
    return OptimizeScene(
        scene=_build_cell_scene(plan),
        path=_build_toolpath_scene(plan, toolpath, points, index),
        stations=_build_stations(plan, points, collision_map),
        motion=_build_motion_scene(plan, toolpath, points, timeline),
        corrected=plan.setup.correction is not None,
    )


def _build_cell_scene(plan: Plan) -> CellScene:
    """The cell; with the bodies of every tool that is on where the job changes them."""
    if not plan.parts:
        return _add_stock(_build_scene_with_tool(plan.setup), plan)
    names = list_tools(plan)
    each = {str(p.plan.setup.cell.tool_name): _build_scene_with_tool(p.plan.setup) for p in plan.parts}
    first = each[names[0]]
    bodies = [b for b in first.bodies if b.kind not in ("tool", "cutter")]
    for n, name in enumerate(names):
        bodies += [replace(b, tools=(n,)) for b in each[name].bodies if b.kind in ("tool", "cutter")]
    tools = tuple((name, each[name].T_root_tool) for name in names)
    return _add_stock(replace(first, bodies=tuple(bodies), tools=tools), plan)


def _add_stock(scene: CellScene, plan: Plan) -> CellScene:
    """Return the scene with the stock at the place of the workpiece."""
    process = (plan.parts[0].plan if plan.parts else plan).setup.cell.process
    if process is None or process.stock is None:
        return scene
    T = scene.T_root_part
    body = SceneBody(
        name="stock",
        kind="stock",
        joint=scene.part_joint,
        vertices=process.stock.vertices @ T[:3, :3].T + T[:3, 3],
        faces=process.stock.faces.astype(np.int32),
    )
    return replace(scene, bodies=(*scene.bodies, body))


def list_tools(plan: Plan) -> list[str]:
    """Return the tools of a job with tool changes, each once, in the order of the job.

    Args:
        plan: The plan.
    """
    return list(dict.fromkeys(str(part.plan.setup.cell.tool_name) for part in plan.parts))


def _find_tool_per_segment(plan: Plan, stretch: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Which of :func:`list_tools` is on in each stretch of the job (N,)."""
    names = list_tools(plan)
    return np.asarray(np.array([names.index(str(p.plan.setup.cell.tool_name)) for p in plan.parts])[stretch])


def _build_scene_with_tool(setup: PlanningSetup) -> CellScene:
    if setup.collision is not None:
        return build_machine_scene(setup.driven, setup.robot, setup.collision.bodies)
    return build_machine_scene(
        setup.driven, setup.robot, build_bodies(setup.driven, setup.robot, load_chain(setup.cell)[1])
    )


def _build_toolpath_scene(plan: Plan, toolpath: Toolpath, points: PointResults, index: Array) -> ToolpathScene:
    bend = points.table.deflection
    counted = plan.path.counted[points.rows]
    by_bend = bool(np.isfinite(bend[counted]).any())
    n = len(toolpath)
    k = np.unique(np.r_[0 : n : -(-n // MAX_PATH_POINTS), n - 1])
    value = bend * 1e3 if by_bend else index * 1e-6
    return ToolpathScene(
        position=toolpath.position[k],
        point=k.astype(float),
        cutting=counted[k],
        value=np.where(counted, value, np.nan)[k],
        label="predicted deflection (mm)" if by_bend else "stiffness (N/µm)",
        large_is_good=not by_bend,
        **_build_outcomes(points, k),
    )


def _build_outcomes(points: PointResults, k: NDArray[np.intp]) -> dict[str, Any]:
    """Return outcome, probability and cause of the drawn points ``k``."""
    found = points.table.process
    if found is None:
        return {}
    codes = {"": 0, **{word: n + 1 for n, word in enumerate(OUTCOMES)}}
    return {
        "outcome": np.array([codes[found.outcome[i]] for i in k], np.uint8),
        "p_in": found.p_in[k],
        "cause": tuple(found.cause[i] for i in k),
    }


def _build_stations(plan: Plan, points: PointResults, collision_map: CollisionMap) -> StationPostures | None:
    st = find_cut_stations(plan)
    if not len(st) or collision_map.postures is None:
        return None
    rows = plan.path.stations[st]
    a, d = plan.chosen.assignment, plan.directions
    C, bend = np.full((len(st), 6), np.nan), np.full((len(st), 3), np.nan)
    given = plan.options.force.given
    terms: list[str] = []
    for own, mine in plan.among(rows):
        terms += [f"{t.effect} at {t.location}" for t in own.setup.elasticity.terms]
        terms += [f"external joint {s.joint}" for s in own.setup.elasticity.stiffness.external if s.is_compliant]
        some = mine[a.reason[rows[mine]] == InfeasibilityReason.OK]
        if not len(some):
            continue
        elastic = d.elastic(own.setup.elasticity, a.q[rows[some]], rows[some])
        full = elastic.compute_compliance()
        C[some] = full[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        if given:
            bend[some] = elastic.compute_deflection(d.force[rows[some]])
    near = np.clip(np.round(plan.path.index[rows]).astype(int), 0, len(points.rows) - 1)
    return StationPostures(
        q=_append_external_joints(np.asarray(collision_map.postures), plan.path.external[rows][:, None]),
        chosen=_append_external_joints(
            np.where((a.reason[rows] == InfeasibilityReason.OK)[:, None], a.q[rows], np.nan), plan.path.external[rows]
        ),
        k=d.k[rows],
        force=d.force[rows] if given else None,
        bend=bend if given else None,
        compliance=C,
        clearance=points.table.clearance[near],
        nearest=tuple(points.nearest_pair[i] for i in near),
        singularity=points.table.singularity[near],
        tool=_find_tool_per_segment(plan, plan.part_of(rows)) if plan.parts else None,
        terms=tuple(dict.fromkeys(terms)),
    )


def _append_external_joints(q: Array | NDArray[np.float32], external: Array) -> Array:
    """Joints of the arm (…, 6) and where the external ones stand there (…, E), as the picture has them: (…, 6 + E)."""
    external_values = np.broadcast_to(external, (*q.shape[:-1], external.shape[-1])).astype(q.dtype)
    return np.concatenate([q, external_values], axis=-1)


def _build_motion_scene(
    plan: Plan, toolpath: Toolpath, points: PointResults, timeline: MotionTimeline | None
) -> MotionScene | None:
    t = timeline.trajectory if timeline else None
    if t is None:
        return None
    s = compute_cut_length(toolpath, plan.path.counted[points.rows])
    known = np.isfinite(t.point) & np.isfinite(t.gamma)
    phi = np.interp(np.where(known, t.point, 0.0), plan.path.index, plan.chosen.assignment.phi)
    q = t.q if plan.setup.correction is None else plan.setup.correction.compute_true_angles(t.q)
    return MotionScene(
        time=t.time,
        q=_append_external_joints(q, t.external),
        point=t.point,
        s=interpolate_path_length(s, t.point),
        phi=np.where(known, wrap_angle(phi), np.nan),
        gamma=t.gamma,
        tool=None if t.tool is None else _find_tool_per_segment(plan, t.tool),
    )

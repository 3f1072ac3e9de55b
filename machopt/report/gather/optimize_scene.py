"""The 3-D picture of optimize: toolpath, motion, and a posture for every cell of the map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Bools, any_last
from machopt.domain.reason import Reason
from machopt.domain.toolpath import Toolpath
from machopt.model.robot import load_chain
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Setup
from machopt.plan.written.contact_map import Mapped
from machopt.plan.written.points import PointResults
from machopt.report.gather.optimize_map import best_branch, cut_stations
from machopt.report.gather.optimize_series import along, cut_length
from machopt.report.gather.scene import bodies_of, scene_of
from machopt.report.scene import Motion3D, Path3D, Scene, Stations, View
from machopt.se3 import wrap

LONGEST = 20_000  # points of the toolpath that are drawn; of a longer one every so many


def view_of(
    plan: Plan,
    toolpath: Toolpath,
    points: PointResults,
    timeline: Timeline | None,
    shown: Mapped,
    index: Array,
) -> View:
    """What the picture shows; ``index`` (N,) is the chosen plan's, in the quantity of the page."""
    return View(
        scene=_scene(plan),
        path=_path(plan, toolpath, points, index),
        stations=_stations(plan, points, shown),
        motion=_motion(plan, toolpath, points, timeline),
        corrected=plan.setup.correction is not None,
    )


def _scene(plan: Plan) -> Scene:
    """The cell; with the bodies of every tool that is on where the job changes them."""
    if not plan.parts:
        return _with_tool(plan.setup)
    names = tools_of(plan)
    each = {str(p.plan.setup.cell.tool_name): _with_tool(p.plan.setup) for p in plan.parts}
    first = each[names[0]]
    bodies = [b for b in first.bodies if b.kind not in ("tool", "cutter")]
    for n, name in enumerate(names):
        bodies += [replace(b, tools=(n,)) for b in each[name].bodies if b.kind in ("tool", "cutter")]
    tools = tuple((name, each[name].T_root_tool) for name in names)
    return replace(first, bodies=tuple(bodies), tools=tools)


def tools_of(plan: Plan) -> list[str]:
    """The tools of a job that changes them, each once, in the order of the job."""
    return list(dict.fromkeys(str(part.plan.setup.cell.tool_name) for part in plan.parts))


def _tool_at(plan: Plan, stretch: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Which of :func:`tools_of` is on in each stretch of the job (N,)."""
    names = tools_of(plan)
    return np.asarray(np.array([names.index(str(p.plan.setup.cell.tool_name)) for p in plan.parts])[stretch])


def _with_tool(setup: Setup) -> Scene:
    if setup.collision is not None:
        return scene_of(setup.driven, setup.robot, setup.collision.bodies)
    return scene_of(setup.driven, setup.robot, bodies_of(setup.driven, setup.robot, load_chain(setup.cell)[1]))


def _path(plan: Plan, toolpath: Toolpath, points: PointResults, index: Array) -> Path3D:
    bend = points.table.deflection
    counted = plan.path.counted[points.rows]
    by_bend = bool(np.isfinite(bend[counted]).any())
    n = len(toolpath)
    k = np.unique(np.r_[0 : n : -(-n // LONGEST), n - 1])
    value = bend * 1e3 if by_bend else index * 1e-6
    return Path3D(
        position=toolpath.position[k],
        point=k.astype(float),
        cutting=counted[k],
        value=np.where(counted, value, np.nan)[k],
        label="predicted deflection (mm)" if by_bend else "stiffness (N/µm)",
        large_is_good=not by_bend,
    )


def _stations(plan: Plan, points: PointResults, shown: Mapped) -> Stations | None:
    st = cut_stations(plan)
    if not len(st):
        return None
    rows = plan.path.stations[st]
    a, d = plan.chosen.assignment, plan.directions
    C, bend = np.full((len(st), 6), np.nan), np.full((len(st), 3), np.nan)
    given = plan.options.force.given
    terms: list[str] = []
    for own, mine in plan.among(rows):
        terms += [f"{t.effect} at {t.location}" for t in own.setup.elasticity.terms]
        terms += [f"external joint {s.joint}" for s in own.setup.elasticity.stiffness.external if s.gives]
        some = mine[a.reason[rows[mine]] == Reason.OK]
        if not len(some):
            continue
        elastic = d.elastic(own.setup.elasticity, a.q[rows[some]], rows[some])
        full = elastic.compliance()
        C[some] = full[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        if given:
            bend[some] = elastic.deflection(d.force[rows[some]])
    near = np.clip(np.round(plan.path.index[rows]).astype(int), 0, len(points.rows) - 1)
    return Stations(
        q=_with_external(_postures(plan, shown, st), plan.path.external[rows][:, None]),
        chosen=_with_external(
            np.where((a.reason[rows] == Reason.OK)[:, None], a.q[rows], np.nan), plan.path.external[rows]
        ),
        k=d.k[rows],
        force=d.force[rows] if given else None,
        bend=bend if given else None,
        compliance=C,
        clearance=points.table.clearance[near],
        nearest=tuple(points.nearest_pair[i] for i in near),
        singularity=points.table.singularity[near],
        tool=_tool_at(plan, plan.part_of(rows)) if plan.parts else None,
        terms=tuple(dict.fromkeys(terms)),
    )


def _postures(plan: Plan, shown: Mapped, st: NDArray[np.intp]) -> Array:
    """(N, R, 6) the posture whose index or reason the map shows, wound into the middle of the limits; NaN without."""
    c, limits = shown.candidates, plan.setup.driven.limits
    usable: Bools = any_last(c.feasible[st])
    branch, _ = best_branch(plan, shown, st)
    farthest = np.where(np.isfinite(c.q[st, :, :, 0]), c.reason[st], 0).argmax(axis=2)
    pick = np.where(usable.any(axis=2), branch, farthest)
    q = c.q[st[:, None], np.arange(pick.shape[1]), pick]
    middle = 0.5 * (limits.lower[:6] + limits.upper[:6])
    return np.asarray(q - 2 * np.pi * np.round((q - middle) / (2 * np.pi)), np.float32)


def _with_external(q: Array, external: Array) -> Array:
    """Joints of the arm (…, 6) and where the external ones stand there (…, E), as the picture has them: (…, 6 + E)."""
    stands = np.broadcast_to(external, (*q.shape[:-1], external.shape[-1])).astype(q.dtype)
    return np.concatenate([q, stands], axis=-1)


def _motion(plan: Plan, toolpath: Toolpath, points: PointResults, timeline: Timeline | None) -> Motion3D | None:
    t = timeline.trajectory if timeline else None
    if t is None:
        return None
    s = cut_length(toolpath, plan.path.counted[points.rows])
    known = np.isfinite(t.point) & np.isfinite(t.gamma)
    phi = np.interp(np.where(known, t.point, 0.0), plan.path.index, plan.chosen.assignment.phi)
    q = t.q if plan.setup.correction is None else plan.setup.correction.true_angles(t.q)
    return Motion3D(
        time=t.time,
        q=_with_external(q, t.external),
        point=t.point,
        s=along(s, t.point),
        phi=np.where(known, wrap(phi), np.nan),
        gamma=t.gamma,
        tool=None if t.tool is None else _tool_at(plan, t.tool),
    )

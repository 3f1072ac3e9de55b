"""Stability map of the optimize report: stable depth over planned depth, along the path and over the rotation."""

from __future__ import annotations

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.candidate_enumeration import solve_stations
from machopt.planning.stability.depth_ratio import StabilityModel
from machopt.report.page_data.optimize_series import interpolate_path_length
from machopt.report.page_types import optimize_page_data as page

STATIONS = 300  # columns of the picture at most


def build_stability_map(plan: Plan, toolpath: Toolpath, s: Array) -> page.StabilityMap | None:
    """Return the map over the rotations of the chosen branch; None where stability is not known.

    Args:
        plan: The plan; of a job with tool changes there is no map.
        toolpath: The toolpath, with the operations of the process.
        s: (N,) path length at the toolpath's points, m.
    """
    if plan.parts or toolpath.process_operation is None:
        return None
    setup, path, c = plan.setup, plan.path, plan.candidates
    model = StabilityModel.build(setup.cell, toolpath, path, setup.arm, setup.robot, plan.directions)
    if model is None:
        return None
    milled = np.flatnonzero(model.is_milled[path.stations])
    shown = milled[np.unique(np.linspace(0, len(milled) - 1, min(len(milled), STATIONS)).round().astype(int))]
    number = plan.chosen.assignment.branch[path.stations[shown]]
    branch = np.minimum(np.searchsorted(c.branch, number), len(c.branch) - 1)
    every = solve_stations(path, setup.arm, c, shown)[0]  # (S, R, A, 6)
    q = every[np.arange(len(shown)), :, np.maximum(number, 0)]
    reached = c.usable | (c.reason == InfeasibilityReason.UNSTABLE)
    usable = reached[shown[:, None], np.arange(c.q.shape[1])[None], branch[:, None]]
    usable &= (c.branch[branch] == number)[:, None]
    n, r = np.nonzero(usable)
    ratio = np.full(usable.shape, np.nan)
    ratio[n, r] = model.compute_ratios(path.stations[shown[n]].astype(np.intp), q[n, r])
    a = plan.chosen.assignment
    phi = np.where(a.reason == InfeasibilityReason.OK, a.phi, np.nan)[path.stations[shown]]
    return page.StabilityMap(
        s=interpolate_path_length(s, path.index[path.stations[shown]]),
        rotation=np.asarray(c.phi),
        ratio=ratio,
        chosen=np.asarray(wrap_angle(phi)),
        least=plan.options.min_stability_ratio,
    )

"""More planning points for a plan that is made: the choice stays what it is, the path is followed more closely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.domain.reason import Reason
from machopt.domain.steering import kept
from machopt.domain.toolpath import Toolpath
from machopt.plan.compensation.compensate import LENGTHS, STEEPEST, rescored, shifted, steepness
from machopt.plan.configurations.realise import Assignment, realise
from machopt.plan.cost.score import directions
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Scored
from machopt.plan.stations.path import Path, build_path


def compensate(plan: Plan, toolpath: Toolpath) -> Plan:
    """The plan for the path shifted against its deflection, with the same rotation; what cannot be shifted says why.

    The shift turns, comes and goes over the least of LENGTHS at which it is nowhere steeper than STEEPEST.
    """
    found = plan
    for length in LENGTHS:
        fine = with_corners(plan, toolpath, length)
        found = shifted(fine, length)
        if found.compensation is None or steepness(fine.path, found.compensation.offset).max() <= STEEPEST:
            break
    return found


def with_corners(plan: Plan, toolpath: Toolpath, length: float) -> Plan:
    """The plan with more planning points around corners, starts and ends of cuts; rotation in between on the line.

    There a shift against the deflection turns, comes and goes, over ``length`` (m) to either side.
    """
    old = plan.path
    path = build_path(toolpath, kept(plan.options), corners=length)
    if len(path.index) == len(old.index):
        return plan
    rows = np.searchsorted(path.index, old.index)
    stands = [np.interp(path.index, old.index, column) for column in old.external.T]  # added points lie inside runs
    external = np.array(stands).T.reshape(len(path.index), -1)
    path = replace(path, stations=rows[old.stations].astype(np.int32), external=external)
    setup = plan.setup
    refined = replace(
        plan,
        path=path,
        check=None,
        directions=directions(path, setup.arm, setup.elasticity, plan.options.force),
    )

    def carried(scored: Scored) -> Scored:
        assignment = _between(plan, path, rows, scored.assignment)
        return rescored(replace(refined, chosen=scored), assignment).chosen

    return replace(
        refined, chosen=carried(plan.chosen), jiao2022=carried(plan.jiao2022), cam_default=carried(plan.cam_default)
    )


def _between(plan: Plan, path: Path, rows: NDArray[np.intp], a: Assignment) -> Assignment:
    """The assignment at more points; at the old ones (``rows``) to the last bit."""
    index = plan.path.index
    phi = np.interp(path.index, index, a.phi)
    seed = np.column_stack([np.interp(path.index, index, a.q[:, j]) for j in range(6)])
    found = realise(path, plan.setup.arm, plan.setup.robot, phi, seed)
    whole = np.interp(path.index, index, (a.reason != Reason.OK).astype(float)) == 0  # both neighbours are
    values = {name: value.copy() for name, value in vars(found).items()}
    values["reason"][~whole] = Reason.NO_PATH
    for name, value in vars(a).items():
        values[name][rows] = value
    return Assignment(**values)

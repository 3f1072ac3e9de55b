"""Loads of a job on the arm, for ``plan-poses``: from toolpath and process force, or from a range of forces alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.cell.tool_selection import select_single_tool
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.errors import OptionError
from machopt.measurement.design.request import PosesRequest, build_prior_stiffness
from machopt.measurement.design.torque_reversal_loads import ProcessLoads
from machopt.numerics.array_types import Array
from machopt.options.plan_option_reader import load_options
from machopt.toolpath.unknown_words import read_for_plan


def read_job_loads(request: PosesRequest, cell: Cell) -> ProcessLoads | None:
    """Return the loads of the job; None where the request names no job.

    Args:
        request: The validated request.
        cell: The robot cell.

    Raises:
        InputError: a toolpath that cannot be read or has no force, or that the arm cannot drive.
    """
    if request.toolpath is None:
        given = request.force_N
        return None if given is None else ProcessLoads(force=(min(given), max(given)), words="--force-N")
    from machopt.planning.pipeline.path_planner import plan_path  # the planner takes a second to load

    options = load_options(cell.plan, overrides=request.overrides)
    if request.force_N is None and not options.force.given:
        raise OptionError(
            "no process force is stated for it; --force-N 200,800 or force_N of the cell's plan would work",
            file=request.toolpath,
            where="--toolpath",
        )
    path = place_toolpath(read_for_plan(request.toolpath, get_reading_options(cell)), cell)
    toolled = select_single_tool(cell, path)
    found = plan_path(replace(toolled, stiffness=build_prior_stiffness(request, cell)), path, options)
    rows = np.flatnonzero(found.path.counted & (found.chosen.assignment.reason == InfeasibilityReason.OK))
    if not len(rows):
        raise OptionError(
            "none of its cut points can be reached with this cell; give --force-N 200,800 without --toolpath",
            file=request.toolpath,
            where="--toolpath",
        )
    force = found.directions.force[rows] if options.force.given else found.directions.axial[rows]
    size = np.linalg.norm(force, axis=1)
    sizes = request.force_N or (float(size.min()), float(size.max()))
    setup = found.setup
    state = setup.robot.compute_state(found.chosen.assignment.q[rows], setup.elasticity.T_flange_tcp, bodies=True)
    per_newton = np.einsum("nci,nc->ni", state.J[:, :3], force / np.maximum(size, np.finfo(float).tiny)[:, None])
    masses = setup.elasticity.masses
    weight = np.zeros(per_newton.shape) if masses is None else compute_weight_torque(setup.robot, masses, state)
    whole: Array = np.concatenate([weight + s * per_newton for s in (min(sizes), max(sizes))])
    return ProcessLoads(
        force=(float(min(sizes)), float(max(sizes))),
        torque=np.stack([whole.min(axis=0), whole.max(axis=0)]),
        words=request.toolpath.name,
    )

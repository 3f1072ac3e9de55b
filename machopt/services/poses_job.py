"""What a job asks of the arm, for ``plan-poses``: by toolpath and process force, or by a range of forces alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.design.asked import PosesRequest, prior_of
from machopt.design.joblike import JobLoads
from machopt.domain.cell import Cell
from machopt.domain.reason import Reason
from machopt.errors import InputError
from machopt.formats.options import load_options
from machopt.formats.setups import placed
from machopt.formats.toolchoice import with_tool
from machopt.formats.unknownwords import read_for_plan
from machopt.model.gravity import weight_torque
from machopt.services.knownrobot import reading_of


def job_of(request: PosesRequest, cell: Cell) -> JobLoads | None:
    """None where no job was told.

    Raises:
        InputError: a toolpath that cannot be read or has no force, or that the arm cannot drive.
    """
    if request.toolpath is None:
        given = request.force_N
        return None if given is None else JobLoads(force=(min(given), max(given)), words="--force-N")
    from machopt.plan.pipeline.run import plan  # the planner takes a second to load

    options = load_options(cell.plan, overrides=request.overrides)
    if request.force_N is None and not options.force.given:
        raise InputError(
            "no process force is stated for it; --force-N 200,800 or force_N of the cell's plan would work",
            file=request.toolpath,
            where="--toolpath",
        )
    path = placed(read_for_plan(request.toolpath, **reading_of(cell)), cell)
    toolled = with_tool(cell, path)
    found = plan(replace(toolled, stiffness=prior_of(request, cell)), path, options)
    rows = np.flatnonzero(found.path.counted & (found.chosen.assignment.reason == Reason.OK))
    if not len(rows):
        raise InputError(
            "no point of it that is cut can be reached as the cell stands; --force-N 200,800 alone would work",
            file=request.toolpath,
            where="--toolpath",
        )
    force = found.directions.force[rows] if options.force.given else found.directions.axial[rows]
    size = np.linalg.norm(force, axis=1)
    sizes = request.force_N or (float(size.min()), float(size.max()))
    setup = found.setup
    state = setup.robot.state(found.chosen.assignment.q[rows], setup.elasticity.T_flange_tcp, bodies=True)
    per_newton = np.einsum("nci,nc->ni", state.J[:, :3], force / np.maximum(size, np.finfo(float).tiny)[:, None])
    masses = setup.elasticity.masses
    weight = np.zeros(per_newton.shape) if masses is None else weight_torque(setup.robot, masses, state)
    whole: Array = np.concatenate([weight + s * per_newton for s in (min(sizes), max(sizes))])
    return JobLoads(
        force=(float(min(sizes)), float(max(sizes))),
        torque=np.stack([whole.min(axis=0), whole.max(axis=0)]),
        words=request.toolpath.name,
    )

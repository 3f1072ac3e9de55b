"""The refinement of rotation and external joints goes on beside the user's wishes about places, and keeps them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from examples import examples
from external_cell import external_cell
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_external import OPTIONS, UP, K
from test_path import Rows, toolpath
from test_refine_external import by_grids

from machopt.domain.options import ExternalAxis, ExternalMode, Steer
from machopt.domain.steering import inside
from machopt.domain.toolpath import Move, Toolpath
from machopt.plan.best.base import best_plan
from machopt.plan.external.axes import axes_of
from machopt.plan.external.ranking import Worth
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.run import obeys
from machopt.se3 import wrap

E_PIN = Steer(points=(4, 6), joint="rail", at=0.35, unit="mm")
E_ZONE = Steer(points=(9, 16), joint="rail", away=(-0.05, 0.15), unit="mm")
PIN, ZONE = Steer(points=(10, 10), gamma=0.4), Steer(points=(12, 17), forbid=(-0.4, 0.8))


def weaving() -> Toolpath:
    y = np.linspace(-0.6, 0.6, 20)
    rows: Rows = [((0.0, y[0], 0.05), UP, Move.RAPID)]
    rows += [((0.25 * float(np.sin(7.0 * v)), float(v), 0.0), UP, Move.CUT) for v in y]
    return toolpath(rows, feed=0.05)


def before_and_after(folder: FilePath, wishes: tuple[Steer, ...], mode: ExternalMode) -> tuple[Plan, Plan]:
    """What the search by grids comes to, and what is exported."""
    cell, path = replace(external_cell(folder, rail=True), stiffness=K), weaving()
    options = replace(
        OPTIONS,
        rotation_step=np.radians(15.0),
        steer=wishes,
        external=(ExternalAxis(joint="rail", mode=mode, weight=2.0),),
    )
    first = by_grids(cell, path, options)
    return first, best_plan(cell, path, options)


def gained(first: Plan, best: Plan) -> float:
    worth = Worth.of(first.setup, axes_of(first.setup.cell, first.options))
    return 1.0 - worth.plan(best) / worth.plan(first)


@pytest.mark.slow
def test_a_plan_with_wishes_is_refined_and_keeps_them(tmp_path: FilePath) -> None:
    first, best = before_and_after(tmp_path, (E_PIN, E_ZONE, PIN, ZONE), "moving")
    assert gained(first, best) > 1e-3
    index, rail = best.path.index, best.path.external[:, 0]
    assert (rail[(index >= 4) & (index <= 6)] == 0.35).all()  # to the bit: no curve of the refinement goes there
    there = rail[(index >= 9) & (index <= 16)]
    assert (there <= -0.05).all() or (there >= 0.15).all()
    gamma = np.asarray(wrap(best.chosen.assignment.phi + best.path.offset))
    assert gamma[index == 10] == pytest.approx(0.4, abs=1e-6)
    assert not inside(gamma[(index >= 12) & (index <= 17)], (-0.4, 0.8)).any()


@pytest.mark.slow
@given(
    st.lists(st.sampled_from([E_PIN, E_ZONE, PIN, ZONE, Steer(prefer=0.7, weight=0.3)]), unique=True, min_size=1),
    st.sampled_from(["moving", "operation"]),
)
@settings(max_examples=examples(2), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_with_wishes_too_refining_makes_no_plan_worse(
    tmp_path: FilePath, wishes: list[Steer], mode: ExternalMode
) -> None:
    if mode == "operation":
        wishes = [w for w in wishes if w is not E_PIN]  # one place would keep both, and the refinement nothing to do
    first, best = before_and_after(tmp_path, tuple(wishes), mode)
    assert gained(first, best) >= -1e-12
    assert len(best.missing) <= len(first.missing)
    if not len(best.missing):
        assert obeys(best.chosen.assignment, best.path, best.options)
    rows = (best.path.index >= 9) & (best.path.index <= 16)
    if E_ZONE in wishes:
        assert not ((best.path.external[rows, 0] > -0.05) & (best.path.external[rows, 0] < 0.15)).any()

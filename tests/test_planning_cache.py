"""Planning cache: results equal those of a new computation, and only valid entries are used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from small_cell import small_cell
from test_external_axes import VALUES, ring, separate_operations, slots
from test_external_axes import K as SPRINGS
from test_planning_path import toolpath

from machopt.data_types.plan_options import FixedRotation, PlanOptions
from machopt.data_types.toolpath import Toolpath, ToolpathOperation
from machopt.planning.cache import StepCache, compute_cached, use_step_cache
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.motion.trajectory_builder import build_timeline


def test_step_is_repeated_only_where_an_input_differs() -> None:
    made: list[float] = []

    def of(values: np.ndarray, options: PlanOptions, model: object) -> np.ndarray:
        def make() -> np.ndarray:
            made.append(float(values.sum()))
            return values * 2

        return compute_cached("double", lambda: (values, options, model), make)

    x, model = np.arange(4.0), object()
    of(x, PlanOptions(), model)
    of(x, PlanOptions(), model)
    assert len(made) == 2  # no cache is active
    store = StepCache()
    with use_step_cache(store):
        first = of(x, PlanOptions(), model)
        again = of(x.copy(), PlanOptions(), model)
        assert again is first
        with pytest.raises(ValueError, match="read-only"):
            first[0] = 1.0
        of(x, PlanOptions(seed=1), model)
        of(x.reshape(2, 2), PlanOptions(), model)
        of(x, PlanOptions(), object())  # another object: its equality is unknown
        assert (store.found, store.made) == ({"double": 1}, {"double": 4})
    for _ in range(3):
        with use_step_cache(store):
            of(x, PlanOptions(), model)
    assert len(store.results) == 1  # results that are not requested again are removed
    assert len(made) == 6


def build_drilled_path(path: Toolpath) -> Toolpath:
    return replace(path, operations=(ToolpathOperation("holes", "point"),))


@pytest.mark.slow
@pytest.mark.parametrize("rail", [False, True])
def test_plan_from_cached_results_equals_a_new_one(tmp_path: Path, *, rail: bool) -> None:
    """Fix the rotation in one of six holes or one of four slots.

    With a rail, the rail positions of the other slots are not evaluated again.
    """
    path = (
        separate_operations(toolpath(slots(-0.3, -0.1, 0.1, 0.3), feed=0.05))
        if rail
        else build_drilled_path(ring(holes=6))
    )
    options = replace(VALUES, collision=not rail, external=VALUES.external if rail else ())
    pinned = replace(options, fixed=(FixedRotation(8, 0.7),))
    cell = replace(external_cell(tmp_path, rail=True) if rail else small_cell(tmp_path), stiffness=SPRINGS)
    store = StepCache()
    with use_step_cache(store):
        free = find_best_plan(cell, path, options)
        build_timeline(free, path)
    for again in (False, True):  # the second time, all results come from the cache as read-only arrays
        with use_step_cache(store):
            retained = find_best_plan(cell, path, pinned, before=free)
            driven = build_timeline(retained, path)
        assert not rail or store.found["places"] > 0
        assert not again or (store.found["retime"] > 0 and not store.made)
    alone = find_best_plan(cell, path, pinned)
    timeline = build_timeline(alone, path)
    for name in ("phi", "q", "branch", "reason"):
        np.testing.assert_array_equal(getattr(retained.chosen.assignment, name), getattr(alone.chosen.assignment, name))
    np.testing.assert_array_equal(retained.path.external, alone.path.external)
    assert retained.chosen.objective == alone.chosen.objective
    assert driven.trajectory is not None
    assert timeline.trajectory is not None
    for name in ("q", "external", "gamma", "point"):
        np.testing.assert_array_equal(getattr(driven.trajectory, name), getattr(timeline.trajectory, name))

"""Bound over external joints, rotations and branches, compared with every sequence."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from external_axis_cells import external_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from small_cell import pose
from test_external_axes import OPTIONS, UP, K, separate_operations, slots
from test_planning_path import Rows, toolpath

from machopt.cli.objective_lines import format_external_lines
from machopt.data_types.cell import CollisionShape
from machopt.data_types.documents.optimize_document import ExternalSearchBoundSection
from machopt.data_types.plan_options import ExternalJointOptions
from machopt.data_types.toolpath import MoveKind
from machopt.planning.cost.objective import AssignmentCosts, compute_objective
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import build_operation_groups
from machopt.planning.external_axis_optimization.external_axis_bound import (
    BoundSearch,
    ValueGridSequences,
    bound_over_external_axes,
)
from machopt.planning.external_axis_optimization.value_grid import NEAR, VALUES, build_group_value_grid
from machopt.planning.external_axis_optimization.value_grid_construction import (
    build_value_grid_sequences,
    unwrap_to_lower_limits,
)
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import ExternalAxisBound
from machopt.planning.pipeline.planning_setup import StageTimings, fix_external_axes, prepare_planning
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.stations.planning_path import build_planning_path
from machopt.verification.folder.result_json.objective_and_gains import _check_external_gap

EXACT = 1e-9  # relative to J: rounding
TURN = 2.0 * np.pi


def random_lattice(
    seed: int, priced: tuple[float, float, float, float], flags: int, stable: bool
) -> ValueGridSequences:
    """Return four stations, two values of two joints, two rotations, two branches, and any type of step."""
    rng = np.random.default_rng(seed)
    S, G, R, B, E = 4, 2, 2, 2, 2
    V = G * R * B
    cost = rng.uniform(0.5, 2.0, (S, V))
    missing = rng.uniform(size=(S, V)) < 0.2
    worst, *prices = priced
    bits = np.array([(flags >> k) & 1 for k in range(9)], bool).reshape(3, 3)
    kind = np.vstack([np.zeros((1, 3), bool), bits])
    kind[:, 2] &= kind[:, 1]  # no plunge during a rapid move
    counted = rng.uniform(size=(S, 1)) < 0.8
    return ValueGridSequences(
        node=np.where(missing, np.inf, 0.25 * cost),
        raw=np.where(counted & ~missing, cost, 0.0),
        q=rng.uniform(-6.0, 0.5, (S, V, 6)),
        more=rng.integers(0, 3, (S, V, 6), np.int8),
        e=rng.uniform(-1.0, 1.0, (S, G, E)),
        phi=np.tile([-np.pi, 0.5], (S, 1)),
        held=rng.integers(0, 2, (S, G)),
        branches=B,
        stable=stable,
        kind=kind,
        priced=np.column_stack([rng.uniform(0.0, 2.0, S), *(p * rng.uniform(0.2, 1.0, S) for p in prices)]),
        slowness=rng.uniform(0.3, 1.0, 6 + E),
        worst=worst,
    )


def every_price(x: ValueGridSequences) -> np.ndarray:
    """Return J of every sequence by the definition of the module; infinite if it is not permitted."""
    S, V = x.node.shape
    R, B = x.phi.shape[1], x.branches

    def step(s: int, u: int, v: int) -> float:
        (g, r, b), (h, p, a) = (np.unravel_index(w, (V // (R * B), R, B)) for w in (v, u))
        same, joined, retained = x.kind[s]
        if same and x.held[s, g] != x.held[s - 1, h]:
            return np.inf
        if (joined and x.stable and a != b) or (retained and u != v):
            return np.inf
        ends = zip(x.q[s, v], x.more[s, v], x.q[s - 1, u], x.more[s - 1, u], strict=True)
        values = [(q + TURN * np.arange(m + 1), p + TURN * np.arange(n + 1)) for q, m, p, n in ends]
        way = np.array([np.abs(here[:, None] - before).min() for here, before in values])
        way = np.r_[way, np.abs(x.e[s, g] - x.e[s - 1, h])]
        turn = abs(np.angle(np.exp(1j * (x.phi[s, r] - x.phi[s - 1, p]))))
        seconds, travel, rotation, feed = x.priced[s]
        return float(travel * way.sum() + rotation * turn + feed * max(float((way * x.slowness).max()) - seconds, 0.0))

    steps = np.array([[[step(s, u, v) for v in range(V)] for u in range(V)] for s in range(1, S)])
    all_ = np.array(list(itertools.product(range(V), repeat=S)))
    rows = np.arange(S)
    total = x.node[rows, all_].sum(axis=1) + sum(steps[s, all_[:, s], all_[:, s + 1]] for s in range(S - 1))
    return np.asarray(total + x.worst * x.raw[rows, all_].max(axis=1))


prices = st.tuples(st.floats(0.0, 4.0), st.floats(0.0, 0.4), st.floats(0.0, 0.4), st.floats(0.0, 2.0))


@given(st.integers(0, 10**6), prices, st.integers(0, 511), st.booleans())
@settings(max_examples=scale_example_count(60), deadline=None)
def test_bound_and_best_against_every_sequence(
    seed: int, priced: tuple[float, float, float, float], flags: int, stable: bool
) -> None:
    problem = random_lattice(seed, priced, flags, stable)
    ideal, found = float(every_price(problem).min()), problem.best()
    if not np.isfinite(ideal):
        assert found is None
        return
    assert found is not None
    total, bound, vertex = found
    assert bound <= ideal * (1 + EXACT)
    assert bound >= ideal * (1 - 1.01 * GAP)
    assert ideal * (1 - EXACT) <= total <= ideal * (1 + 1.01 * GAP)
    message = every_price(problem)[int(np.ravel_multi_index(tuple(vertex), (problem.node.shape[1],) * len(vertex)))]
    assert message == pytest.approx(total, rel=EXACT)


def hole_and_slot() -> Rows:
    return [*slots(-0.3, x=0.0), ((0.1, 0.3, 0.05), UP, MoveKind.RAPID), ((0.1, 0.3, 0.0), UP, MoveKind.CUT)]


@pytest.mark.parametrize("modes", [("moving", "moving"), ("moving", "operation"), ("operation", "operation")])
def test_bound_uses_the_costs_of_the_objective(tmp_path: FilePath, modes: tuple[str, str]) -> None:
    """The best sequence of the grid, executed as a path, has the computed J; other sequences have no smaller one."""
    cell = replace(external_cell(tmp_path, rail=True, table=True), stiffness=K)
    path_in = separate_operations(toolpath(hole_and_slot()))
    free = tuple(
        ExternalJointOptions(joint=n, mode=m, range=(-0.4, 0.4)) for n, m in zip(("rail", "turn"), modes, strict=True)
    )
    options = replace(OPTIONS, external=free, rotation_step=np.radians(45.0))
    setup, path = prepare_planning(cell, options), fix_external_axes(build_planning_path(path_in), cell.external_home)
    groups = build_operation_groups(cell, path_in, path, resolve_axis_options(cell, options))
    grids = [build_group_value_grid(g, path, counts={2: 2}) for g in groups]
    lattice = build_value_grid_sequences(setup, options, path, groups, grids, 1e-6)
    found = lattice.best(1e-6)
    assert found is not None
    total, bound, vertex = found
    R, B, S = lattice.phi.shape[1], lattice.branches, len(vertex)
    rng = np.random.default_rng(1)

    def price(vertex: np.ndarray) -> float:
        rows, g = np.arange(S), vertex // (R * B)
        q = np.unwrap(lattice.q[rows, vertex], axis=0)
        x = np.hstack([q, lattice.e[rows, g]])
        phi = np.unwrap(lattice.phi[rows, vertex // B % R])
        w, share = options.weights, path.weight
        cost = np.zeros(S)
        cost[share > 0] = 1e-6 * lattice.node[rows, vertex][share > 0] / (w.mean * share[share > 0])
        costs = AssignmentCosts(cost=cost, q=x, phi=phi)
        return compute_objective(path, costs, 1e-6, setup.velocity, options).total

    assert price(vertex) == pytest.approx(total, rel=1e-9)
    assert bound <= total
    if "operation" in modes:
        run = path.run
        for n, (name, mode) in enumerate(zip(("rail", "turn"), modes, strict=True)):
            value = lattice.e[np.arange(S), vertex // (R * B), n]
            assert mode == "moving" or all(np.ptp(value[run == k]) == 0 for k in range(run[-1] + 1)), name
    still = np.isfinite(lattice.node).all(axis=0)
    for v in rng.choice(np.flatnonzero(still), 20):  # the same vertex at every station is a sequence
        assert price(np.full(S, v)) >= bound * (1 - 1e-12)


def test_plan_is_compared_with_all_values_or_a_reason_is_given(tmp_path: FilePath) -> None:
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K)
    path = toolpath(slots(0.15))
    options = replace(OPTIONS, external=(ExternalJointOptions(joint="rail", mode="operation"),))
    found = bound_over_external_axes(plan_path(cell, path, options), path, StageTimings())
    assert found is not None
    assert not found.why
    assert found.bound <= found.sequence
    assert found.bound < found.plan
    assert found.values == len(np.unique([*np.linspace(-2.5, 2.5, VALUES[1]), 0.0])) + 2 * len(NEAR)
    finer = bound_over_external_axes(plan_path(cell, path, options), path, StageTimings(), {1: 2 * VALUES[1] - 1})
    assert finer is not None
    assert finer.bound <= found.sequence * (1 + EXACT)  # the finer grid contains every value of the coarser one
    many = bound_over_external_axes(plan_path(cell, path, options), path, StageTimings(), {1: 2000})
    assert many is not None
    assert f"{2002 + 2 * len(NEAR)} values" in many.why
    assert not np.isfinite(many.bound)
    locked = replace(OPTIONS, external=(ExternalJointOptions(joint="rail", mode="locked"),))
    assert bound_over_external_axes(plan_path(cell, path, locked), path, StageTimings()) is None
    beyond = toolpath(slots(9.0))
    none = bound_over_external_axes(plan_path(cell, beyond, options), beyond, StageTimings())
    assert none is not None
    assert "gaps" in none.why


@given(st.floats(-7.0, 7.0), st.floats(-6.5, -0.1), st.floats(0.1, 6.5))
@settings(max_examples=scale_example_count(100), deadline=None)
def test_whole_turns_within_the_limits_are_counted(q: float, lower: float, upper: float) -> None:
    """Reference: count whole turns one by one; a value on a limit counts."""
    values = [k for k in range(-4, 5) if lower <= q + TURN * k <= upper]
    low, more = unwrap_to_lower_limits(np.full((1, 6), q), np.full(6, lower), np.full(6, upper))
    if values:
        assert low[0, 0] == pytest.approx(q + TURN * values[0], abs=1e-6)
        assert more[0, 0] == len(values) - 1


def test_plan_is_one_of_the_sequences_and_above_the_bound(tmp_path: FilePath) -> None:
    """For any rotation: the bound is never above the plan, and the plan's own sequence gives the plan as a start."""
    cell = replace(external_cell(tmp_path, rail=True, table=True), stiffness=K)
    path = toolpath(slots(0.12))
    free = tuple(ExternalJointOptions(joint=n, mode="moving") for n in ("rail", "turn"))
    options = replace(OPTIONS, external=free, rotation_step=np.radians(15.0))
    made = plan_path(cell, path, options)
    groups = build_operation_groups(cell, path, made.path, resolve_axis_options(cell, options))
    around = BoundSearch.build(made, groups, {2: 2})
    assert not isinstance(around, str)
    found = around.best()
    assert found is not None
    assert found.bound <= found.total <= around.own * (1 + EXACT)
    x, R = around.lattice, around.lattice.phi.shape[1]
    a, st_ = made.chosen.assignment, around.part.stations
    still = np.flatnonzero(np.isclose(x.phi[0], a.phi[st_[0]], atol=1e-12))[0]
    own = ((x.e.shape[1] - 1) * R + still) * x.branches + a.branch[st_].astype(np.int64)
    again = around.start(own, made)
    assert again.phi == pytest.approx(a.phi, abs=1e-9)
    assert again.external == pytest.approx(made.path.external, abs=1e-9)
    assert again.seed == pytest.approx(a.q, abs=1e-6)


def test_best_sequence_is_free_of_contacts(tmp_path: FilePath) -> None:
    """A bar at the best position of the arm: the result equals that with all colliding poses excluded in advance."""
    bar = CollisionShape(name="bar", kind="box", size=(0.1, 0.1, 2.0), mesh=None, T_parent_shape=pose(0.5, -0.15, 0.8))
    cell = replace(external_cell(tmp_path, rail=True), stiffness=K, obstacles=(bar,))
    path = toolpath(slots(0.15))
    options = replace(OPTIONS, collision=True, external=(ExternalJointOptions(joint="rail", mode="moving"),))
    made = plan_path(cell, path, options)
    around = BoundSearch.build(
        made, build_operation_groups(cell, path, made.path, resolve_axis_options(cell, options)), VALUES
    )
    assert not isinstance(around, str)
    every = np.nonzero(np.isfinite(around.lattice.node))
    touching = around.touching(*every)
    first = around.lattice.best()
    best = around.best()
    assert first is not None
    assert best is not None
    rows = np.arange(len(first[2]))
    assert around.touching(rows, first[2]).any()
    assert not around.touching(rows, best.vertex).any()
    around.lattice.node[tuple(at[touching] for at in every)] = np.inf
    ideal = around.lattice.best()
    assert ideal is not None
    assert best.bound <= ideal[0] * (1 + EXACT)
    assert best.total == pytest.approx(ideal[0], rel=2 * GAP)
    assert best.bound >= first[1] * (1 - EXACT)


@pytest.mark.parametrize(("bound", "plan", "gap"), [(0.9, 1.0, 0.1), (1.0, 1.0, 0.0), (1.1, 1.0, None)])
def test_plan_below_the_grid_bound_has_no_gap(bound: float, plan: float, gap: float | None) -> None:
    """The plan uses values between the grid values, for which the bound does not hold; the document states this."""
    found = ExternalAxisBound(bound=bound, sequence=1.2, plan=plan, values=13, stations=9, step=0.2)
    assert found.gap == (gap if gap is None else pytest.approx(gap, abs=1e-12))
    external_search_bound_section = ExternalSearchBoundSection(
        why_none="", values=13, stations=9, rotation_step_deg=15.0, sequence=1.2, lower_bound=bound, plan=plan,
        gap_percent=None if found.gap is None else 100.0 * found.gap,
    )  # fmt: skip
    assert list(_check_external_gap(external_search_bound_section)) == []
    wrong = external_search_bound_section.model_copy(
        update={"gap_percent": 100.0 * (1.0 - bound / plan) if gap is None else None}
    )
    assert "gap_percent" in " ".join(_check_external_gap(wrong))
    words = " ".join(format_external_lines(external_search_bound_section))
    assert ("the bound does not apply to it" in words) == (gap is None)
    assert "gap -" not in words

"""Search for a collision-free sequence, compared with exhaustive search."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from small_cell import pose, small_cell
from test_planning_path import Rows, toolpath
from test_planning_pipeline import K

from machopt.data_types.cell import CollisionShape
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead
from machopt.planning.collision_handling.path_check import PathCollisionChecker
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.collision_map import compute_collision_map
from machopt.planning.plan_output.infeasibility_reasons import explain_points
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import choose_sequence
from machopt.planning.sequence_search.search_kernels import JUMP
from machopt.planning.sequence_search.worst_value_constraint import GAP

UP = (0.0, 0.0, 1.0)
C, R = MoveKind.CUT, MoveKind.RAPID
OPTIONS = PlanOptions(
    rotation_step=np.radians(30.0),
    collision_step=np.radians(3.0),
    weights=ObjectiveWeights(rapid=0.0, reorientation=0.0, clearance=0.0),
)


def plan_leaning_spindle(
    folder: FilePath, rows: Rows, obstacles: tuple[CollisionShape, ...], options: PlanOptions = OPTIONS
) -> Plan:
    """Plan for the small cell with its spindle at 45° to the flange, so that rotation about the tool axis moves the
    whole arm."""
    tool = small_cell(folder).tool
    lean = pose(0.1, 0, 0.25, np.pi / 4)
    tool = replace(
        tool,
        T_flange_tcp=lean,
        geometry=(
            CollisionShape(
                name="spindle", kind="box", size=(0.1, 0.1, 0.2), mesh=None, T_parent_shape=lean @ pose(0, 0, -0.17)
            ),
        ),
    )
    cell = small_cell(folder, stiffness=ArmStiffness(joints=K), tool=tool, obstacles=obstacles)
    return plan_path(cell, toolpath(rows), options)


def build_crowded_job(seed: int) -> tuple[Rows, tuple[CollisionShape, ...]]:
    """Build a short pass over the block between random posts, some of which collide at every rotation."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 6))
    start = np.array([rng.uniform(-0.15, 0.0), rng.uniform(-0.1, 0.1), 0.02])
    step = np.array([0.019 * np.cos(a := rng.uniform(-np.pi, np.pi)), 0.019 * np.sin(a), 0.0])
    rows: Rows = [(tuple(start + k * step), UP, R if k == 0 else C) for k in range(n)]
    posts = []
    for k in range(int(rng.integers(2, 7))):
        a, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.4)
        x, y = 1.5 + start[0] + far * np.cos(a), start[1] + far * np.sin(a)
        wide, high = rng.uniform(0.02, 0.2), rng.uniform(0.1, 0.5)
        posts.append(
            CollisionShape(
                name=f"post_{k}",
                kind="box",
                size=(wide, wide, high),
                mesh=None,
                T_parent_shape=pose(x, y, 0.62 + high / 2),
            )
        )
    return rows, tuple(posts)


def rods(seed: int) -> tuple[Rows, tuple[CollisionShape, ...]]:
    """Build a short pass between thin rods that the arm can pass on either side: poses are free, motions between
    them collide."""
    rng = np.random.default_rng(seed)
    start = np.array([rng.uniform(-0.15, 0.0), rng.uniform(-0.1, 0.1), 0.02])
    a = rng.uniform(-np.pi, np.pi)
    step = np.array([0.019 * np.cos(a), 0.019 * np.sin(a), 0.0])
    rows: Rows = [(tuple(start + k * step), UP, R if k == 0 else C) for k in range(5)]
    standing = []
    for k in range(int(rng.integers(6, 16))):
        a, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.08, 0.35)
        x, y = 1.5 + start[0] + far * np.cos(a), start[1] + far * np.sin(a)
        high = rng.uniform(0.1, 0.5)
        standing.append(
            CollisionShape(
                name=f"rod_{k}",
                kind="cylinder",
                size=(0.003, high),
                mesh=None,
                T_parent_shape=pose(x, y, 0.62 + high / 2),
            )
        )
    return rows, tuple(standing)


def reachable(p: Plan) -> list[int]:
    """Count the vertices of each station that some sequence from the first station reaches, with every pose and edge
    checked.

    Vertices are checked at their own pose and edges along their own linear joint motion; no exclusion is transferred to
    another vertex or edge.
    """
    c: CandidateGrid = enumerate_candidates(p.path, p.setup.arm, p.options)
    model, path = p.setup.collision, p.path
    assert model is not None
    checker = PathCollisionChecker.build(path, p.setup.arm, p.setup.robot, model, p.options)
    S, rotations = c.feasible.shape[:2]
    free = c.feasible.copy()
    for s in range(S):
        r, b = np.nonzero(free[s].any(axis=2))
        touch = np.full(len(r), path.may_touch[path.stations[s]])
        free[s, r, b] &= ~model.check_configurations(c.q[s, r, b], touch).hit[:, None]
    alive = [{tuple(int(x) for x in v) for v in np.argwhere(free[0])}]
    steps = int(JUMP / (2 * np.pi / rotations) + 1e-9)
    for s in range(1, S):
        now, ways = set(), {}
        for r, b, t in (tuple(int(x) for x in v) for v in np.argwhere(free[s])):
            for ru, bu, tu in alive[-1]:
                turn = (r - ru + rotations // 2) % rotations - rotations // 2
                qa, qb = c.q[s - 1, ru, bu] + c.turns[tu], c.q[s, r, b] + c.turns[t]
                if b != bu or abs(turn) > max(steps, 1) or np.abs(qb - qa).max() > JUMP:
                    continue
                key = (ru, bu, r, b)
                if key not in ways:
                    phi = c.phi[ru] + np.array([0.0, float(wrap_angle(c.phi[r] - c.phi[ru]))])
                    hit, _, lost = checker.stretch(path.stations[[s - 1, s]], phi, np.vstack([qa, qb]))
                    ways[key] = not (hit.any() or lost.any())
                if ways[key]:
                    now.add((r, b, t))
        alive.append(now)
        if not now:
            break
    return [len(a) for a in alive] + [0] * (S - len(alive))


def agrees(rows: Rows, obstacles: tuple[CollisionShape, ...], folder: FilePath) -> Plan:
    """Check that the planner finds a sequence if exhaustive search finds one, and otherwise states the station where
    none continues."""
    p = plan_leaning_spindle(folder, rows, obstacles)
    counts = reachable(p)
    ok = bool((p.chosen.assignment.reason == InfeasibilityReason.OK).all()) and not p.breaks
    if p.chosen_from in ("jiao2022", "cam default"):
        assert ok  # refined between the grid rotations
        return p
    assert ok == all(counts), (ok, counts, [b.text for b in p.breaks])
    if not ok:
        first = counts.index(0)  # the first unreachable station: a point without a solution, or a break before it
        at = float(p.path.index[p.path.stations[first]])
        named = {float(p.path.index[k]) for k in p.missing} | {b.after for b in p.breaks}
        assert at in named
        sentences = explain_points(p)
        assert all(sentences[int(k)] for k in p.missing)
        for b in p.breaks:
            assert b.code == "collision"
            assert "~" in b.pair
            assert b.pair in b.text
            assert "would help" in b.help
    return p


@pytest.mark.parametrize("seed", [0, 1, 3, 4, 6, 7, 8, 9])
def test_feasibility_equals_that_of_exhaustive_search(seed: int, tmp_path: FilePath) -> None:
    agrees(*build_crowded_job(seed), tmp_path)


@pytest.mark.parametrize("seed", [33, 41, 42])
def test_single_colliding_edges_between_free_poses_are_excluded(seed: int, tmp_path: FilePath) -> None:
    """Seeds for which an edge between two free poses collides, or no complete sequence exists."""
    p = agrees(*rods(seed), tmp_path)
    assert p.found is not None
    assert len(p.found.edges) or p.breaks
    model = p.setup.collision
    assert model is not None
    for s, u, _ in list(zip(p.found.edges.station, p.found.edges.source, p.found.edges.target, strict=True))[:20]:
        branches, turns = p.candidates.feasible.shape[2:]
        r, b = u // (branches * turns), u // turns % branches
        touch = np.array([p.path.may_touch[p.path.stations[s - 1]]])
        assert not model.check_configurations(p.candidates.q[s - 1, r, b][None], touch).hit[
            0
        ]  # the pose itself is free
    assert_closed_by_themselves(p)


def assert_closed_by_themselves(p: Plan) -> None:
    """Check that each edge excluded in every turn collides, or has no IK solution, along its own motion."""
    assert p.found is not None
    s, R = p.setup, len(p.candidates.phi)
    checker = PathCollisionChecker.build(p.path, s.arm, s.robot, s.collision, p.options)
    assert p.candidates.feasible.shape[1] == R
    branches, grid, st = p.candidates.feasible.shape[2], p.candidates.phi_at(), p.path.stations
    for at, u, v in p.found.edges.closed[:: max(len(p.found.edges.closed) // 60, 1)]:
        (ru, bu), (r, b) = divmod(u, branches), divmod(v, branches)
        if st[at] - st[at - 1] > 1:
            continue
        qa = p.candidates.q[at - 1, ru, bu]
        q = np.vstack([qa, qa + wrap_angle(p.candidates.q[at, r, b] - qa)])
        phi = grid[at - 1, ru] + np.array([0.0, float(wrap_angle(grid[at, r] - grid[at - 1, ru]))])
        hit, _, lost = checker.stretch(np.arange(st[at - 1], st[at] + 1), phi, q)
        assert hit.any() or lost.any()


@pytest.mark.parametrize("seed", [0, 7])
def test_only_colliding_edges_are_excluded(seed: int, tmp_path: FilePath) -> None:
    p = plan_leaning_spindle(tmp_path, *build_crowded_job(seed))
    whole = enumerate_candidates(p.path, p.setup.arm, p.options)
    model = p.setup.collision
    assert model is not None
    gone = whole.feasible.any(axis=3) & ~p.candidates.feasible.any(axis=3)
    assert gone.any()
    for s, r, b in np.argwhere(gone):
        touch = np.array([p.path.may_touch[p.path.stations[s]]])
        assert model.check_configurations(whole.q[s, r, b][None], touch).hit[0]
        assert p.found is not None
        assert p.found.pairs[s, r, b] >= 0


@pytest.mark.parametrize("seed", [4, 33])
def test_sequence_chosen_in_segments_has_the_bound_of_a_whole_choice(seed: int, tmp_path: FilePath) -> None:
    """The whole path is optimized once more on the remaining grid; its bound must also hold for the result of the
    segments."""
    p = plan_leaning_spindle(tmp_path, *(rods(seed) if seed > 30 else build_crowded_job(seed)))
    assert p.found is not None
    velocity = p.setup.cell.limits.velocity[:6]
    wide = p.found.wide if p.found.wide.any() else None
    whole = choose_sequence(p.path, p.candidates, p.scores, velocity, p.options, p.found.edges, wide)
    assert p.choice.total * (1 - GAP) <= whole.bound * (1 + 1e-9)
    assert p.choice.bound <= whole.total * (1 + 1e-9)


def test_lookahead_excludes_edges_of_the_same_pair_around_a_contact(tmp_path: FilePath) -> None:
    p = plan_leaning_spindle(tmp_path, *build_crowded_job(4))
    c, model = enumerate_candidates(p.path, p.setup.arm, p.options), p.setup.collision
    assert model is not None
    usable = c.feasible.any(axis=3)
    touch = p.path.may_touch[p.path.stations]
    s, r, b = np.nonzero(usable)
    found = model.check_configurations(c.q[s, r, b], touch[s])
    pair = np.bincount(found.pair[found.hit]).argmax()  # the pair with most collisions
    alike = model.check_single_pairs(c.q[s, r, b], np.full(len(s), pair))
    assert alike[found.pair == pair].all()
    assert not alike[~found.hit].any() or model.pairs[pair].unless_cutting
    ahead = ContactLookahead(
        candidates=c,
        model=model,
        may_touch=touch,
        external=np.empty((len(touch), 0)),
        pairs=np.full(usable.shape, -1, np.int32),
    )
    start = np.flatnonzero(found.pair == pair)[:1]
    seed = np.ravel_multi_index((s[start], r[start], b[start]), usable.shape)
    ahead.strike(seed, np.array([pair], np.int32))
    looked = ahead.look(seed, np.array([pair], np.int32), 10_000)
    struck = usable & ~c.feasible.any(axis=3)
    assert 1 < struck.sum() <= alike.sum()
    assert looked < usable.sum()
    assert not struck[s[~alike], r[~alike], b[~alike]].any()  # only vertices that are in contact are excluded
    out = np.argwhere(struck)
    for k in out:  # no vertex next to an excluded one is in contact with the same pair
        for n in out[np.abs(out - k).sum(axis=1) == 1]:
            assert ahead.pairs[tuple(n)] == pair
    ring = np.array([v for v in np.argwhere(c.feasible.any(axis=3)) if (np.abs(out - v).sum(axis=1) == 1).any()])
    assert not model.check_single_pairs(c.q[tuple(ring.T)], np.full(len(ring), pair)).any()


def test_map_marks_checked_edges_and_checks_the_rest_on_request(tmp_path: FilePath) -> None:
    p = plan_leaning_spindle(tmp_path, *build_crowded_job(4))
    before = p.candidates.feasible.copy()
    some, whole, none = (
        compute_collision_map(p),
        compute_collision_map(p, full=True),
        compute_collision_map(p, full=True, seconds=0.0),
    )
    assert 0 < some.looked_at < whole.looked_at
    assert some.open == none.open > whole.open
    np.testing.assert_array_equal(p.candidates.feasible, before)  # the map does not change the candidates
    model, c = p.setup.collision, whole.candidates
    assert model is not None
    cut = p.path.counted[p.path.stations]
    s, r, b = np.nonzero(c.feasible.any(axis=3) & cut[:, None, None])
    assert whole.known[s, r, b].all()
    assert not model.check_configurations(c.q[s, r, b], p.path.may_touch[p.path.stations[s]]).hit.any()
    s, r, b = np.nonzero(before.any(axis=3) & ~c.feasible.any(axis=3))
    assert model.check_configurations(c.q[s, r, b], p.path.may_touch[p.path.stations[s]]).hit.all()


def test_equal_stiffness_prefers_distance_with_a_clearance_weight(tmp_path: FilePath) -> None:
    """A post next to the tool: with a clearance weight the plan keeps a larger distance, and both are reported with
    the same J."""
    post = (
        CollisionShape(
            name="post", kind="box", size=(0.08, 0.08, 0.4), mesh=None, T_parent_shape=pose(1.5, 0.42, 0.82)
        ),
    )
    rows: Rows = [((-0.05 + 0.019 * k, 0.0, 0.02), UP, R if k == 0 else C) for k in range(4)]
    plain = plan_leaning_spindle(
        tmp_path, rows, post, replace(OPTIONS, weights=ObjectiveWeights(clearance=0.0, rapid=0.0))
    )
    weighed = replace(OPTIONS, weights=ObjectiveWeights(clearance=20.0, rapid=0.0), clearance_full=0.3)
    wary = plan_leaning_spindle(tmp_path, rows, post, weighed)

    def nearest(p: Plan) -> float:
        assert p.setup.collision is not None
        return float(p.setup.collision.find_nearest_pair(p.chosen.assignment.q, p.path.may_touch).distance.mean())

    assert nearest(wary) > nearest(plain)
    assert plain.chosen.objective.clearance == 0.0
    o, w = wary.chosen.objective, weighed.weights
    parts = w.mean * o.mean + w.worst * o.worst + w.travel * o.travel + w.rotation * o.rotation + w.feed * o.feed
    assert 0.0 < o.clearance < 1.0
    parts += w.rapid * o.rapid + w.reorientation * o.reorientation
    assert o.total == pytest.approx(parts + 20.0 * o.clearance)

"""Values of external joints are scored by contact-free configurations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from external_axis_cells import external_cell
from small_cell import pose

from machopt.data_types.cell import CollisionShape
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.external_axes.sampled_sequence import choose_collision_free_sequence
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.planning_setup import fix_external_axes, prepare_planning
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.stations.planning_path import build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath


def test_external_value_blocked_by_a_post_is_replaced(tmp_path: Path) -> None:
    cell = replace(
        external_cell(tmp_path, rail=True),
        stiffness=ArmStiffness(joints=np.array([2.0, 2.0, 1.5, 0.5, 0.4, 0.3]) * 1e6),
    )
    file = tmp_path / "hole.csv"
    file.write_text(
        "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min\n0,0,80,0,0,1,rapid,\n0,0,-2,0,0,1,cut,300\n0,0,80,0,0,1,retract,3000\n"
    )
    path, options = read_toolpath(file), PlanOptions(rotation_step=np.radians(30.0))
    own = replace(options, external=(ExternalJointOptions(joint="rail", mode="operation"),))
    free = find_best_plan(cell, path, own)
    at = float(free.path.external[0, 0])
    base = cell.T_world_base[:3, 3]
    # a post at the previous position of the arm
    cell = replace(
        cell,
        obstacles=(
            CollisionShape(
                name="post", kind="box", size=(0.5, 0.5, 3.0), mesh=None, T_parent_shape=pose(base[0] + 0.55, at, 1.5)
            ),
        ),
    )
    setup = prepare_planning(cell, options)

    def colliding(value: float) -> tuple[int, int]:
        part = fix_external_axes(build_planning_path(path), np.array([value]))
        candidates = enumerate_candidates(part, setup.arm, options)
        d = compute_load_directions(part, setup.arm, setup.elasticity, options.force)
        scores = score_candidates(part, candidates, setup.elasticity, d, options)
        choice, hits = choose_collision_free_sequence(part, candidates, scores, setup, options)
        return int(choice.dropped.sum()) + hits, int(candidates.feasible.sum())

    assert colliding(at)[0] > 0
    found = find_best_plan(cell, path, own)
    assert not len(found.missing)
    assert not found.breaks
    assert abs(float(found.path.external[0, 0]) - at) > 0.05
    assert colliding(float(found.path.external[0, 0]))[0] == 0

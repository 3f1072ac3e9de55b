"""Time of planning load tests: ``python benchmarks/plan_poses_time.py``.

The shipped KR240 cell; 20,000 candidate poses, 6 ways of loading each, 20 poses chosen. Then what the choice is worth:
its D-efficiency (at least), and how many times the readings random poses would need.
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model import CollisionModel
from machopt.kinematics.urdf_loading import load_chain
from machopt.measurement.design.d_optimal_search import compute_information_matrix, find_d_optimal_design
from machopt.measurement.design.efficiency_bound import compute_efficiency_bound
from machopt.measurement.design.expected_accuracy import compute_expected_accuracy
from machopt.measurement.design.load_cases import LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import build_load_method_combinations
from machopt.measurement.design.measurement_plan import build_design_problem, build_unknowns
from machopt.measurement.design.pose_candidates import PoseCriteria, PoseScreen, sample_poses
from machopt.measurement.design.published_heuristics import build_random_heuristic, draw_heuristic_design
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.kinetostatic_indices import compute_characteristic_length

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
CANDIDATES, POSES = 20_000, 20


def main() -> None:
    cell = load_cell(CELL)
    robot, shapes = load_chain(cell)
    T = cell.tool.T_flange_tcp
    length = compute_characteristic_length(robot, T).length
    criteria = PoseCriteria(kci=0.1, limit_margin=np.radians(5), floor=0.3, ceiling=2.5)
    screen = PoseScreen(
        robot=robot,
        T_flange_tcp=T,
        T_world_base=cell.T_world_base,
        length=length,
        criteria=criteria,
        collision=CollisionModel(cell, robot, shapes, 0.02),
    )
    start = perf_counter()
    limits = cell.limits.lower, cell.limits.upper
    pool = sample_poses(screen, limits, cell.home, CANDIDATES, seed=0)
    print(f"{'candidate poses':<34}{len(pool):>9}{perf_counter() - start:>9.2f} s  ({pool.drawn_count} tried)")
    noise = ReadingNoise(displacement=12e-6, cycle=15e-6, pose=30e-6, force=0.0075)
    R_base_world = cell.T_world_base[:3, :3].T
    ways = (
        *build_load_method_combinations((50.0,), (), 1, np.zeros((0, 3)), (0.0, 0.2), R_base_world)[:2],
        *build_load_method_combinations((), (500.0,), 4, np.zeros((0, 3)), (0.2,), R_base_world)[:4],
    )
    assert cell.stiffness is not None
    prior = ArmElasticity(robot, T, cell.stiffness)
    start = perf_counter()
    cases = build_load_cases(
        pool, ways, prior, (), LoadCriteria(min_deflection=1e-4, max_deflection=5e-3, nu_p=0.05), noise
    )
    print(f"{'load cases':<34}{len(cases):>9}{perf_counter() - start:>9.2f} s  ({len(ways)} ways)")
    rng = np.random.default_rng(0)
    problem, _ = build_design_problem(cases, build_unknowns(prior, (), cases), noise, 1.0, rng)
    for loads in (1, 2):
        start = perf_counter()
        design = find_d_optimal_design(problem, POSES, loads, rng=rng, starts=2)
        took = perf_counter() - start
        found = compute_expected_accuracy(compute_information_matrix(problem, design.blocks))
        every = np.ones(6, bool)
        chance = [
            compute_expected_accuracy(
                compute_information_matrix(
                    problem, draw_heuristic_design(build_random_heuristic(pool), problem, cases, POSES, loads, rng)
                )
            ).rms(every)
            for _ in range(40)
        ]
        ratio = (float(np.median(chance)) / found.rms(every)) ** 2
        bound = compute_efficiency_bound(problem, design, loads)
        print(
            f"{f'{POSES} poses × {loads} loads, two starts':<34}{POSES * loads:>9}{took:>9.2f} s  "
            f"(D-efficiency ≥ {bound:.2f}; random poses need {ratio:.1f} × the readings)"
        )


if __name__ == "__main__":
    main()

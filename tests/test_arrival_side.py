"""Gear hysteresis: located from increasing and decreasing loads, included for both arrival directions, absent
without a cause."""

from __future__ import annotations

from functools import cache

import numpy as np
from simulated_hidden_effects import CELLS, HiddenEffects, arm, build_iwan_law, load_tests, plan_load_tests

from machopt.cell.cell_reader import load_cell
from machopt.data_types.stiffness import ModelDiscrepancy
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.identification.assessment.hysteresis_half_width import (
    add_arrival_side,
    estimate_loop_half_widths,
    find_branch_pairs,
)

CELL = "irb6700_drilling"
LOOP = 2  # joint 3


@cache
def build_tests(loop: bool) -> LoadTestExperiment:
    a, rng = arm(CELL), np.random.default_rng(12)
    twist = {LOOP: build_iwan_law(0.4 / a.nominal[LOOP], 900.0)} if loop else {}
    recording = load_tests(a, HiddenEffects(a.nominal * 1.1, twist), plan_load_tests(a, rng, poses=14), rng)
    cell = load_cell(CELLS / CELL)
    return build_load_test_experiment(recording, load_robot(cell), cell.tool.T_flange_tcp)


def test_pairs_have_the_same_load_on_both_branches() -> None:
    tests = build_tests(True)
    rising, falling = find_branch_pairs(tests)
    # of four increasing loads the highest has no reading on unloading
    assert len(rising) == 3 * len(np.unique(tests.cycle))
    assert (tests.cycle[rising] == tests.cycle[falling]).all()
    assert (rising < falling).all()


def test_hysteresis_is_located_at_its_gear_and_nowhere_without_one() -> None:
    half = estimate_loop_half_widths(build_tests(True), np.ones((len(build_tests(True)), 3)))
    assert int(np.argmax(half)) == LOOP
    assert half[LOOP] > 1e-5  # rad
    plain = estimate_loop_half_widths(build_tests(False), np.ones((len(build_tests(False)), 3)))
    assert plain.max() < 0.2 * half[LOOP]


def test_hysteresis_is_a_separate_mode() -> None:
    doubt = ModelDiscrepancy(
        parts=("joint 1", "play 3"), torque=np.ones(6), shift=np.ones(2), modes=np.eye(2), left=0.0, noise=0.0
    )
    more = add_arrival_side(doubt, np.array([0.0, 2e-5, 4e-5, 0.0, 0.0, 0.0]))
    assert more.parts == ("joint 1", "play 3", "loop 2", "loop 3")
    np.testing.assert_allclose(np.sum(more.modes**2, axis=0), [1.0, 1.0, 2.0 * 4e-10, 2.0 * 16e-10])
    np.testing.assert_allclose(more.shift, [1.0, 1.0, 0.0, 0.0])
    assert add_arrival_side(doubt, np.zeros(6)) is doubt

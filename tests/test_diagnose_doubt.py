"""How sure a diagnosed stiffness is: what a plan, which knows no history, is told by a law that has one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import made_up_load_tests as made
import numpy as np

from machopt.diagnose.laws import at_joint
from machopt.diagnose.resting import deflection
from machopt.diagnose.run import Examined, known_masses
from machopt.diagnose.written.doubt import with_doubt
from machopt.domain.stiffness import Stiffness, Term
from machopt.estimate.experiment import experiment
from machopt.model.elastic import ArmElasticity
from machopt.plan.certainty.discrepancy import Doubt

PLAY = Term(
    "joint_hysteresis",
    "joint:1",
    {"law": "used_up", "half_clearance_arcmin": 2.0, "threshold_Nm": 900.0, "reach_Nm": 600.0, "memory": "session"},
)


def test_a_plan_foresees_loads_that_only_history_explained() -> None:
    """A law fitted the readings by what had been before each; a plan has no before, was sure and 25 % off."""
    cell, robot, T = made.cell()
    masses, rng = known_masses(cell), np.random.default_rng(8)
    pull = rng.normal(size=(16, 1, 6)) * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    pull = 1500.0 * pull / np.linalg.norm(pull, axis=2, keepdims=True) * np.array([0.4, 1.0])[:, None]
    recording = made.measured(made.planned(rng, poses=16, wrench=pull), rng, outliers=0.0)
    tests = experiment(recording, robot, T)
    r = deflection.readings_of(recording, tests, robot, T, masses, 1.0 / made.TRUE_K)
    lived, _ = at_joint.lived_through(r, (PLAY,))
    springs = ArmElasticity(robot, T, Stiffness(joints=made.TRUE_K)).at(tests.state.q)
    moved = (springs.respond(tests.wrench) + lived)[:, :3]
    recording = replace(recording, displacement=moved + rng.normal(0.0, made.WHITE, moved.shape))
    diagnosis = SimpleNamespace(used=np.ones(len(tests), bool), coefficients=())
    found = cast(Examined, SimpleNamespace(recording=recording, diagnosis=diagnosis))

    said = with_doubt(cell, found, Stiffness(joints=made.TRUE_K, terms=(PLAY,)))

    assert said is not None
    arm = ArmElasticity(robot, T, said, masses=masses, counted=True)
    doubt, q, w = Doubt.of(arm), tests.state.q, tests.wrench
    assert doubt is not None
    off = arm.at(q).respond(w)[:, :3] - moved
    state = robot.state(q, T, bodies=True)
    ways = (doubt.suspects.response(state, np.tile(made.TRUE_K, (len(q), 1)), w) @ doubt.ways.T)[:, :3]
    sigma = np.sqrt(np.sum(ways**2, axis=2) + (doubt.local * np.linalg.norm(w[:, :3], axis=1)[:, None]) ** 2)
    alone = ArmElasticity(robot, T, replace(said, discrepancy=None), masses=masses)
    before = alone.at(q).respond(w)[:, :3] - moved
    assert np.sqrt(np.mean(before**2)) > 3.0 * made.WHITE  # of the noise: history mattered
    assert np.mean(np.abs(off) < 1.645 * sigma + made.WHITE) > 0.8

"""Joint springs that measured poses under weight do not determine remain those of the cell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from test_diagnose_tcp_poses import arm, measure

from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown, DiagnosisProblem
from machopt.measurement.diagnosis.model_selection.search import search_iterations
from machopt.measurement.diagnosis.static import measured_pose_channel
from machopt.numerics.array_types import Array

NOISE = 1e-5


def waves(q: Array) -> Array:
    """Return angle errors (N, 6) in rad that no spring causes: tens of millimetres at the TCP."""
    out = np.zeros_like(q)
    out[:, 0], out[:, 2] = 3e-2 * np.sin(3 * q[:, 0]), 3e-2 * np.sin(4 * q[:, 2])
    return out


def problem(recording: Recording, kept: frozenset[int] = frozenset()) -> DiagnosisProblem:
    return measured_pose_channel.build_measured_pose_problem(
        recording, *arm(), np.random.default_rng(0), fixed_joints=kept
    )[0]


def springs(recording: Recording, kept: frozenset[int] = frozenset()) -> set[int]:
    """Return the joints whose springs are refitted."""
    return {u.spring_joint for u in problem(recording, kept).unknowns if u.spring_joint is not None}


def test_springs_above_the_noise_are_refitted_unless_fixed() -> None:
    recording = measure(noise=NOISE)
    assert springs(recording) == {2, 3, 4, 5, 6}  # the axis of joint 1 is vertical: weight applies no torque to it
    assert springs(recording, frozenset({3, 5})) == {2, 4, 6}


def test_weakly_observed_spring_remains_that_of_the_cell() -> None:
    assert springs(measure(noise=NOISE, delta=waves)) == {2, 3}  # the wrist springs would absorb the simulated waves


def test_every_spring_is_refitted_under_a_load() -> None:
    load = np.zeros((180, 6))
    load[:, 2], load[::2, 0], load[:, 3:5] = -1500.0, 900.0, 150.0
    assert springs(measure(noise=NOISE, delta=waves, load=load)) == {1, 2, 3, 4, 5, 6}


def test_implausible_spring_is_doubted_only_without_load() -> None:
    stated = problem(measure(noise=NOISE))
    cell = arm()[0].stiffness
    assert cell is not None

    def doubted(times: float, family: str) -> set[int | None]:
        x = np.array(
            [0.0 if u.spring_joint is None else 1.0 / cell.joints[u.spring_joint - 1] for u in stated.unknowns]
        )
        x[[u.spring_joint == 4 for u in stated.unknowns]] *= times
        chosen = [SimpleNamespace(whitened=SimpleNamespace(hypothesis=SimpleNamespace(family=family)))]
        return {
            stated.unknowns[n].spring_joint for n in search_iterations._find_implausible_unknowns(stated, x, chosen)
        }  # type: ignore[arg-type]

    assert doubted(50.0, "kinematic") == doubted(-1.0, "kinematic") == doubted(0.1, "kinematic") == {4}
    assert doubted(1.5, "kinematic") == set()
    assert doubted(50.0, "joint") == set()  # without a kinematic finding the cell value may be wrong by any factor


def test_unbounded_unknown_may_have_any_value() -> None:
    assert BaseUnknown(name="a", unit="m").is_plausible(-1e9)
    some = BaseUnknown(name="a", unit="m", plausible_range=(1.0, 3.0))
    assert [some.is_plausible(v) for v in (0.9, 1.0, 3.0, 3.1)] == [False, True, True, False]

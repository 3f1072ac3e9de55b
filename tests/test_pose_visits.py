"""Replicates are found by pose and load with any visit label; missing replicates are reported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_in_memory import diagnose_in_memory
from simulated_hidden_effects import CELLS, HiddenEffects, arm, load_tests, plan_load_tests, solve_equilibrium

from machopt.data_types.measurements.recording import Recording, StandardUncertainty
from machopt.measurement.diagnosis.data_types.pose_visits import label_unbroken_runs, nest_labels
from machopt.numerics.array_types import Array, Ints

CELL = CELLS / "kr240_drilling"
SOFT_BASE = np.diag([3e-8, 3e-8, 0.0])  # rad/(N·m)


def two_laps(soft: bool) -> Recording:
    """Fifteen poses under three increasing loads, in two laps; the second lap is another session."""
    rng = np.random.default_rng(3)
    a = arm(CELL.name)
    plan = plan_load_tests(a, rng, poses=15, sessions=2, loads=3, directions=1, force=1500.0)
    k = a.nominal * rng.uniform(0.8, 1.25, 6)
    recording = load_tests(a, HiddenEffects(k, hinges={0: SOFT_BASE} if soft else {}), plan, rng)
    assert recording.branch is not None
    return take(recording, np.flatnonzero(recording.branch == 1))


def take(recording: Recording, rows: Ints) -> Recording:
    names = ("q", "pose", "cycle", "session", "line", "wrench", "displacement", "time")
    return replace(recording, branch=None, **{n: getattr(recording, n)[rows] for n in names})


def relabel(recording: Recording, name: str) -> Recording:
    """Return the same readings with other labels, and once in another order."""
    lap, none = recording.session, np.zeros(len(recording), np.int64)
    if name == "session":
        return replace(recording, cycle=lap)
    if name == "no label":
        every = np.arange(len(recording), dtype=np.int64)
        return replace(recording, session=none, cycle=every, stated_labels=frozenset({"pose"}))
    recording = replace(recording, cycle=lap, session=none, stated_labels=frozenset({"pose", "cycle"}))
    return replace(take(recording, np.lexsort((lap, recording.pose))), time=None)


def diagnose(folder: Path, recording: Recording) -> dict[str, Any]:
    return diagnose_in_memory(CELL, recording, folder / "recording").result.to_json_types()


@pytest.mark.parametrize("name", ["session", "cycle, pose by pose", "no label"])
def test_result_does_not_depend_on_the_label_of_replicates(name: str, tmp_path: Path) -> None:
    found = diagnose(tmp_path, relabel(two_laps(soft=True), name))
    assert [(f["effect"], f["location"]) for f in found["findings"]] == [("base_compliance", "base")]
    assert found["verdict"] == "explained"
    nothing = diagnose(tmp_path, relabel(two_laps(soft=False), name))
    assert (nothing["verdict"], nothing["findings"]) == ("consistent", [])
    for document in (found, nothing):
        assert document["baseline"]["measured_noise"] == pytest.approx(document["baseline"]["noise_floor"])
        output = " ".join(document["notes"])
        assert ("not measured by it" in output) == (name != "session")


def poses_read_three_times(return_mm: float) -> Recording:
    """Measured poses: each visit has an error that its three readings share; two laps, no cycle column."""
    rng = np.random.default_rng(7)
    a = arm(CELL.name)
    plan = plan_load_tests(a, rng, poses=40, sessions=2, loads=1, directions=1, force=1e-6)
    rows = np.flatnonzero(~plan.loaded)
    p: Array = solve_equilibrium(a, HiddenEffects(a.nominal * 1.1), plan)[0][rows]
    p = p + 1e-3 * return_mm * rng.standard_normal(p.shape)
    again = np.repeat(np.arange(len(rows)), 3)
    N = len(again)
    return Recording(
        kind="absolute",
        source="made up",
        q=plan.q[rows][again],
        pose=plan.pose[rows][again],
        cycle=np.arange(N, dtype=np.int64),
        session=np.zeros(N, np.int64),
        line=np.arange(2, N + 2),
        position=p[again] + 5e-6 * rng.standard_normal((N, 3)),
        registration="fit",
        stated_labels=frozenset({"pose"}),
        uncertainty=StandardUncertainty(displacement=1e-5),
    )


def test_readings_of_one_visit_are_no_replicates(tmp_path: Path) -> None:
    """The shared error of a visit is not reported as a repeatable mismatch."""
    document = diagnose(tmp_path, poses_read_three_times(0.05))
    assert (document["verdict"], document["findings"]) == ("consistent", [])
    assert document["baseline"]["measured_noise"] == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize("laps", [1, 2])
def test_ordered_error_is_a_mismatch_without_stated_time(laps: int, tmp_path: Path) -> None:
    """A drift of four times the stated uncertainty over one session;
    the same errors in random order are no mismatch."""
    rng = np.random.default_rng(7)
    recording = poses_read_three_times(0.02)
    rows = np.arange(0, len(recording) * laps // 2, 3)
    assert recording.position is not None
    drift = 1.6e-4 * np.linspace(0.0, 1.0, len(rows))[:, None] * np.array([0.5, -0.3, 0.81])
    clean, labels = recording.position[rows], {n: getattr(recording, n)[rows] for n in ("q", "pose", "session", "line")}
    labels["cycle"] = np.arange(len(rows))
    bare = replace(recording, **labels, uncertainty=StandardUncertainty(displacement=4e-5))
    for name, moved in (("drift", drift), ("shuffled", rng.permutation(drift)), ("none", 0.0 * drift)):
        document = diagnose(tmp_path / name, replace(bare, position=clean + moved))
        assert (document["verdict"] == "unexplained") == (name == "drift")
        assert ("time_s" in document["next_experiment"]) == (name == "drift")


def test_runs_and_nesting() -> None:
    pose, session = np.array([1, 1, 2, 2, 1, 1]), np.array([0, 0, 0, 1, 1, 1])
    assert label_unbroken_runs([pose, session]).tolist() == [0, 0, 1, 2, 3, 3]
    assert label_unbroken_runs([np.zeros(0, np.int64)]).tolist() == []
    nested = nest_labels(np.array([0, 0, 1, 1]), np.array([5, 6, 5, 5]))
    assert len(set(nested.tolist())) == 3

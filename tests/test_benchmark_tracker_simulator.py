"""Tracker simulator of measured poses: independent of machopt; cases are generated, diagnosed and scored."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.recording import load_recording

HERE = Path(__file__).resolve().parents[1] / "benchmarks" / "diagnosis_tracker_benchmark"
MODULES = ("dh_arms", "tracker_recording", "random_cases", "run_tracker_benchmark")


@pytest.fixture(scope="module")
def yard() -> Iterator[dict[str, ModuleType]]:
    """Import the modules of the benchmark; other benchmarks contain modules with the same names."""
    before = {name: sys.modules.pop(name, None) for name in MODULES}
    sys.path.insert(0, str(HERE))
    yield {name: importlib.import_module(name) for name in MODULES}
    sys.path.remove(str(HERE))
    for name, module in before.items():
        sys.modules.pop(name, None)
        if module is not None:
            sys.modules[name] = module


def test_simulator_does_not_import_machopt() -> None:
    for path in HERE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] == "machopt" for n in names), path.name


@pytest.mark.parametrize("name", ["big", "mid", "cobot"])
def test_arm_by_dh_parameters_equals_its_urdf(name: str, yard: dict[str, ModuleType], tmp_path: Path) -> None:
    arms, tracker = yard["dh_arms"], yard["tracker_recording"]
    arm, habit = arms.Arm(name, arms.Concealed()), tracker.Habit(poses=5, sessions=1, fit=False)
    rng = np.random.default_rng(3)
    tracker.write(tmp_path / "c", arm, tracker.seen(arm, habit, rng), habit, arm.tool)
    robot = load_robot(load_cell(tmp_path / "c" / "cell"))
    q = rng.uniform(-1.5, 1.5, (20, 6))
    np.testing.assert_allclose(robot.compute_fk(q)[:, :3], arm.frames(q)[1][:, :3], atol=1e-9)
    recording = load_recording(tmp_path / "c" / "rec")
    assert len(recording) == 5
    assert recording.registration == "fixed"


def test_gravity_torques_equal_the_gradient_of_potential_energy(yard: dict[str, ModuleType]) -> None:
    arms = yard["dh_arms"]
    arm = arms.Arm("big", arms.Concealed(payload=30.0))
    q = np.random.default_rng(0).uniform(-1, 1, (4, 6))
    way = 1e-4 * np.random.default_rng(1).normal(size=(4, 6))
    lost = arm.energy(q - way) - arm.energy(q + way)
    np.testing.assert_allclose(np.einsum("nj,nj->n", arm.weight_torque(q), 2 * way), lost, rtol=1e-4, atol=1e-4)


def test_every_group_draws_different_cases_per_seed(yard: dict[str, ModuleType]) -> None:
    draws = yard["random_cases"]
    for group in draws.GROUPS:
        one, again, other = (draws.cases(s, group, 13) for s in (1, 1, 2))
        assert [c.seed for c in one] == [c.seed for c in again]
        assert not {c.seed for c in one} & {c.seed for c in other}
        assert all(bool(c.truths) == (group != "null") for c in one)


@pytest.mark.slow
def test_case_is_made_diagnosed_and_scored(yard: dict[str, ModuleType], tmp_path: Path) -> None:
    """With the command line: zero offsets in the smallest of eight random cases."""
    draws, run = yard["random_cases"], yard["run_tracker_benchmark"]
    case = min(draws.cases(1, "zeros", 8), key=lambda c: c.habit.poses * c.habit.sessions)
    case.make(tmp_path / case.name)
    judged = run.judged(case, "zeros", run.diagnosed(tmp_path / case.name))
    assert judged.named == judged.truths
    assert "| zeros | 1 |" in run.table([judged])


def test_finding_beside_the_truth_and_one_of_a_set_are_counted(yard: dict[str, ModuleType]) -> None:
    draws, run = yard["random_cases"], yard["run_tracker_benchmark"]
    truth = draws.Truth((("joint_zero_offset", "joint:3"),), ("offset", 0.05))
    case = draws.Case("x", "mid", yard["tracker_recording"].Habit(), truths=(truth,))

    def finding(effect: str, where: str, one_of: list[list[str]], low: float) -> dict[str, object]:
        fixed = {"offset": {"value": 0.05, "unit": "deg", "ci95": [low, 0.06]}}
        return {"effect": effect, "location": where, "one_of": one_of, "parameters": fixed}

    right = finding("joint_zero_offset", "joint:3", [], 0.04)
    near = finding("geometry", "joint:4", [["geometry", "joint:4"], ["joint_zero_offset", "joint:3"]], 0.04)
    out = run.judged(case, "zeros", {"verdict": "explained", "findings": [right, near]})
    assert (out.named, out.among, out.extra, out.held) == (1, 0, ("geometry joint:4",), (True,))
    out = run.judged(case, "zeros", {"verdict": "explained", "findings": [near]})
    assert (out.named, out.among, out.extra, out.held) == (0, 1, (), ())
    out = run.judged(case, "zeros", None)
    assert (out.named, out.verdict) == (0, "refused")

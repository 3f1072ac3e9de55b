"""``plan-poses`` for a job: two load sizes, torque reversals, and unobservable effects."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.commands.plan_poses.run import PlanPosesResult, PosesRequest, run_plan_poses
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.measurement.design.d_optimal_search import compute_design_criterion, find_d_optimal_design
from machopt.measurement.design.load_cases import LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import build_load_method_combinations
from machopt.measurement.design.measurement_plan import build_design_problem, build_unknowns
from machopt.measurement.design.pose_candidates import PoseCriteria, PoseScreen, sample_poses
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.design.torque_reversal_loads import (
    MAX_EFFICIENCY_LOSS,
    ProcessLoads,
    TorqueReversalCases,
    compare_joint_loads,
    compute_load_steps,
    describe_joint_loads,
    exchange_loads_for_reversal,
)
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.discrepancy_columns import TYPICAL_PLAY_RAD

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr240_drilling"
NOISE = ReadingNoise(displacement=12e-6, cycle=15e-6, pose=30e-6, force=0.0075)


class Bench:
    """The shipped arm, loaded in two directions."""

    def __init__(self) -> None:
        cell = load_cell(CELL)
        self.robot, _ = load_chain(cell)
        T, self.masses = cell.tool.T_flange_tcp, load_masses(cell)
        screen = PoseScreen(
            robot=self.robot, T_flange_tcp=T, T_world_base=cell.T_world_base, length=1.0, criteria=PoseCriteria()
        )
        self.pool = sample_poses(screen, cell.arm_limits, cell.home, 150, 0)
        prior = ArmElasticity(self.robot, T, replace(cell.stiffness, terms=()), cell.arm_limits, self.masses)  # type: ignore[type-var, arg-type]
        ways = build_load_method_combinations(
            (), (500.0, 1000.0), 8, np.zeros((0, 3)), (0.0,), cell.T_world_base[:3, :3].T
        )
        self.cases = build_load_cases(self.pool, ways, prior, (), LoadCriteria(), NOISE)
        self.unknowns = build_unknowns(prior, (), self.cases)
        self.problem, _ = build_design_problem(self.cases, self.unknowns, NOISE, 1.0, np.random.default_rng(0))
        self.design = find_d_optimal_design(self.problem, 8, 2, rng=np.random.default_rng(0), starts=1)

    def turning(self, steps: tuple[float, ...]) -> TorqueReversalCases:
        scale = self.unknowns.scale
        return TorqueReversalCases.from_cases(self.cases, self.pool, self.robot, self.masses, scale, NOISE, steps)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def test_noncentrality_of_backlash_equals_its_refit_residual(bench: Bench) -> None:
    steps = (0.3, 1.0)
    t, rows, j = bench.turning(steps), bench.design.readings, 2
    pose = bench.cases.pose[rows]
    J = bench.pool.state.J[pose][:, :3]
    load = np.einsum("nci,nc->ni", bench.pool.state.J[pose], bench.cases.wrench[rows])
    weight = compute_weight_torque(bench.robot, bench.masses, bench.pool.state)[pose]  # type: ignore[arg-type]
    springs, play = [], []
    for s in steps:
        springs.append(J * (s * load)[:, None, :])
        step = np.sign(weight[:, j] + s * load[:, j]) - np.sign(weight[:, j])
        play.append(J[:, :, j] * (TYPICAL_PLAY_RAD * step)[:, None])
    A, y = np.concatenate(springs).reshape(-1, 6), np.concatenate(play).reshape(-1)
    rest = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    # a torque near zero may count for neither side
    assert t.compute_backlash_noncentrality(rows.tolist())[j] == pytest.approx(
        float(rest @ rest) / NOISE.reading**2, rel=0.1
    )


def test_one_load_size_hides_backlash_that_two_show(bench: Bench) -> None:
    rows = bench.design.readings.tolist()
    twice, both = (
        bench.turning((1.0, 1.0)).compute_backlash_noncentrality(rows),
        bench.turning((0.25, 1.0)).compute_backlash_noncentrality(rows),
    )
    assert both[0] > 3.0 * twice[0]  # joint 1 carries no weight: every load crosses its backlash in the same way
    assert both[1] == pytest.approx(0.0, abs=1e-6)  # none of these loads reverses the torque of the weight at joint 2


def test_loads_are_exchanged_until_backlash_is_observable(bench: Bench) -> None:
    t = bench.turning((0.25, 1.0))
    found = exchange_loads_for_reversal(bench.design, bench.cases, t, bench.problem)
    before, after = (t.value(d.readings.tolist()) for d in (bench.design, found))
    assert after > before
    retained = compute_design_criterion(bench.problem, found.blocks) - compute_design_criterion(
        bench.problem, bench.design.blocks
    )
    assert retained >= 6 * np.log1p(-MAX_EFFICIENCY_LOSS) - 1e-9
    poses = [[int(bench.cases.pose[n]) for n in b] for b in bench.design.blocks]
    assert [[int(bench.cases.pose[n]) for n in b] for b in found.blocks] == poses  # at the same poses
    assert all(len(set(b)) == len(b) for b in found.blocks)
    load = t.load[found.readings]
    assert (load.min(axis=0) < 0.0).all()  # both signs
    assert (load.max(axis=0) > 0.0).all()


def test_smaller_size_is_that_of_the_job(bench: Bench) -> None:
    def smaller(low: float) -> float:
        return compute_load_steps(ProcessLoads(force=(low, 1000.0)), bench.cases)[0]

    assert [smaller(f) for f in (0.0, 300.0, 900.0)] == [0.2, 0.3, 0.5]


def test_unobservable_effects_of_job_joints_are_reported(bench: Bench) -> None:
    t = bench.turning((0.25, 1.0))
    hidden = replace(t, backlash_information=t.backlash_information * 0.0, cross=t.cross * 0.0)
    torque = np.array([[-1.0, 2.0, -1.0, -1.0, 1.0, 1.0], [1.0, 3.0, 1.0, 1.0, 2.0, 2.0]])
    job = ProcessLoads(force=(200.0, 1500.0), torque=torque)
    output = describe_joint_loads(job, compare_joint_loads(job, bench.design, hidden, (0.25, 1.0)), 1000.0)
    assert "1500 N is more than any load planned (1000 N)" in output[0]
    assert "at joint 1, 3, 4 would not show" in output[1]  # the torques of the other joints keep their sign in the job
    assert "The job turns them round" in output[1]
    unknown = ProcessLoads(force=(200.0, 800.0))
    (one,) = describe_joint_loads(unknown, compare_joint_loads(unknown, bench.design, hidden, (0.25, 1.0)), 1000.0)
    assert "joint 1, 2, 3, 4, 5, 6" in one


def plan_poses(out: Path, **more: Any) -> PlanPosesResult:
    usual: dict[str, Any] = {"candidates": 200, "starts": 1, "poses": 6, "target_percent": None, "no_collision": True}
    return run_plan_poses(PosesRequest(cell=CELL, out=out, pull_N=(500.0, 1000.0), **(usual | more)))


def test_force_range_gives_two_rows_per_cycle(tmp_path: Path) -> None:
    done = plan_poses(tmp_path / "out", force_N=(250.0, 800.0))
    message = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert message["job"]["steps"] == [0.25, 1.0]
    assert message["readings"] == 6 * 2 * 2 * 2
    assert [j["job_Nm"] for j in message["job"]["joints"]] == [None] * 6
    rows = list(csv.DictReader((tmp_path / "out" / "recording_template" / "data.csv").read_text().splitlines()))
    assert len(rows) == message["readings"]
    size = np.array([np.hypot(float(r["fx_N"]), float(r["fy_N"])) for r in rows]).reshape(-1, 2)
    np.testing.assert_allclose(size[:, 0] / size[:, 1], 0.25, rtol=1e-4)
    assert all(a["pose"] == b["pose"] and a["cycle"] == b["cycle"] for a, b in zip(rows[::2], rows[1::2], strict=True))
    assert "Loads like the job" in done.report.read_text()


@pytest.mark.parametrize(("force", "sizes"), [(None, 1), ((250.0, 800.0), 2)])
def test_both_sizes_count_as_readings_and_only_full_loads_are_compared(
    tmp_path: Path, force: tuple[float, float] | None, sizes: int
) -> None:
    done = plan_poses(tmp_path / "out", force_N=force, target_percent=10.0)
    message = json.loads((tmp_path / "out" / "plan.json").read_text())
    page = done.report.read_text()
    rows = list(csv.DictReader((tmp_path / "out" / "poses.csv").read_text().splitlines()))
    at_each = {sum(r["pose"] == str(pose) for r in rows) for pose in range(1, 7)}
    assert at_each == {4 * sizes}  # two loads, each repeated
    assert f"{4 * sizes} at each pose" in page
    needed = message["target"]["poses"]
    assert message["target"]["readings"] == needed * 4 * sizes
    assert f">{needed * 4 * sizes}<" in page
    assert f"readings ({needed} poses)" in page
    (drawn,) = re.findall(r'"id": ?"p-curve".*?"x": ?\[([^]]*)\]', page)
    assert [float(x) for x in drawn.split(",")] == [n * 4 * sizes for n in message["curve"]["poses"]]
    least = min(message["heuristics"], key=lambda h: h["readings_for_the_same"])
    assert least["readings_for_the_same"] == pytest.approx((least["rms_10_50_90"][1] / message["design"]["rms"]) ** 2)
    of = " of full loads" if sizes > 1 else ""
    assert f"needs {least['readings_for_the_same']:.1f} times the readings{of}." in done.message
    assert f"6 poses, {len(rows)} readings{' (24 of full loads)' if sizes > 1 else ''}: " in done.message
    assert ("Full loads for the same" in page, "Readings for the same" in page) == (sizes > 1, sizes == 1)


@pytest.mark.slow
def test_toolpath_gives_the_torque_reversals_of_the_job(tmp_path: Path) -> None:
    quick = ("collision=false", "rotation_step_deg=30")
    plan_poses(tmp_path / "out", toolpath=ROOT / "toolpaths" / "panel_holes.csv", overrides=quick)
    message = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert message["job"]["force_N"] == pytest.approx([250.0, 250.0])  # from the plan of the cell
    joints = message["job"]["joints"]
    assert all(j["job_Nm"][0] < j["job_Nm"][1] for j in joints)
    assert all(j["turns_round"] is (j["job_Nm"][0] < 0.0 < j["job_Nm"][1]) for j in joints)
    assert "panel_holes.csv" in (tmp_path / "out" / "manifest.json").read_text()


def test_single_size_of_a_load_is_reported(tmp_path: Path) -> None:
    done = plan_poses(tmp_path / "out")
    assert any("--force-N" in w for w in done.result.warnings)
    assert not any("at one size" in w for w in plan_poses(tmp_path / "two", force_N=(200.0,)).result.warnings)


def test_invalid_request_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="least and the largest process force"):
        plan_poses(tmp_path / "out", force_N=(-1.0, 5.0))
    free = ("force_N={travel: 0, normal: 0, axial: 0}",)
    with pytest.raises(InputError, match="no process force"):
        plan_poses(tmp_path / "out", toolpath=ROOT / "toolpaths" / "panel_holes.csv", overrides=free)
    with pytest.raises(InputError, match="which loads are needed"):
        plan_poses(tmp_path / "out", force_N=(200.0,), discriminate=tmp_path)

"""Arms without stated masses: the effect of weight in a load test is a free unknown."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import test_diagnose_tcp_poses as poses
from simulated_hidden_effects import (
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    compute_displacements,
    load_tests,
    plan_load_tests,
)

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.kinematics.robot import RobotMasses
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.diagnosis_pipeline import (
    diagnose_static_recording,
    read_load_test_masses,
    read_stated_masses,
)
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import load_test_channel, unknown_link_masses
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment

CELL = "kr240_drilling"
DOWN = np.array([0.0, 0.0, -9.80665])


@cache
def heavy():  # type: ignore[no-untyped-def]
    """Return an arm, its springs, a load plan, and the robot model of the file."""
    a = arm(CELL)
    cell = load_cell(CELLS / CELL)
    plan = plan_load_tests(a, np.random.default_rng(4), poses=20, loads=2)
    return a, 0.5 * a.nominal, plan, load_robot(cell), cell.tool.T_flange_tcp, load_masses(cell)


def test_weight_columns_equal_the_nonlinear_equilibrium() -> None:
    """Reference: the contribution of weight to every displacement, from the nonlinear equilibrium."""
    a, k, plan, robot, T, _ = heavy()
    bare = replace(a, mass=0.0 * a.mass)
    own = compute_displacements(a, HiddenEffects(k), plan) - compute_displacements(bare, HiddenEffects(k), plan)
    r = load_tests(a, HiddenEffects(k), plan, np.random.default_rng(0), NoiseLevels(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    readings = load_test_channel.build_load_test_readings(
        r, build_load_test_experiment(r, robot, T), robot, T, None, 1.0 / k
    )
    columns, unknowns = unknown_link_masses.build_link_moment_columns(readings, DOWN)
    assert {u.location for u in unknowns} == {"link:2", "link:3"}
    A = columns.reshape(own.size, -1)
    x = np.linalg.lstsq(A, own.ravel(), rcond=1e-8)[0]
    left = own.ravel() - A @ x
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(own**2))  # wrist masses and second-order terms
    upper_arm = np.linalg.norm(x[[n for n, u in enumerate(unknowns) if u.location == "link:2"]])
    borne = a.mass[2:].sum() * 1.05 + a.mass[1] * 0.5  # kg·m; the upper arm is 1.05 m long
    assert 0.5 * borne < upper_arm < 2.0 * borne


def test_unknown_weight_is_not_named_a_compensator() -> None:
    a, k, plan, robot, T, masses = heavy()
    quiet = NoiseLevels(2e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    r = load_tests(a, HiddenEffects(k), plan, np.random.default_rng(1), quiet)
    tests = build_load_test_experiment(r, robot, T)

    def found(down: np.ndarray | None) -> tuple[list[str], list[str], float]:
        problem, tried, _readings = load_test_channel.build_load_test_problem(r, tests, robot, T, None, down=down)

        def again(x: np.ndarray, _: object, __: object):  # type: ignore[no-untyped-def]
            return load_test_channel.build_load_test_problem(
                r, tests, robot, T, None, np.maximum(x[:6], 0.0), down=down
            )[:2]

        d = selection_pipeline.diagnose_problem(
            problem, tried, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0), again
        )
        return [f.effect for f in d.findings], [u.effect for u in tried.untestable], d.heldout_after

    effects, untestable, left = found(DOWN)
    assert "gravity_compensator" in untestable
    assert set(effects) <= {"geometric_stiffness"}
    assert left < 0.5 * found(None)[2]  # the effect described by the columns repeats in all replicates
    known = load_test_channel.build_load_test_problem(r, tests, robot, T, masses)
    assert any(h.effect == "gravity_compensator" for h in known[1].hypotheses)


def test_tool_mass_alone_gives_no_arm_weight(tmp_path) -> None:  # type: ignore[no-untyped-def]
    bare = tmp_path / "cell"
    shutil.copytree(CELLS / CELL, bare, ignore=shutil.ignore_patterns("recordings"))
    urdf = (bare / "robot.urdf").read_text(encoding="utf-8")
    (bare / "robot.urdf").write_text(re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL), encoding="utf-8")
    assert read_load_test_masses(load_cell(bare)) is None
    assert read_load_test_masses(load_cell(CELLS / CELL)) is not None


def without_mass(name: str, at: Path, *links: int) -> Cell:
    """Return a cell whose URDF states no mass of these links."""
    bare = at / f"{name}_{links}"
    shutil.copytree(CELLS / name, bare, ignore=shutil.ignore_patterns("recordings"))
    urdf = (bare / "robot.urdf").read_text(encoding="utf-8")
    for link in links:
        found = re.search(rf'<link name="[^"]*link_?{link}".*?</link>', urdf, re.DOTALL)
        assert found is not None
        lighter = re.sub(r"<inertial>.*?</inertial>", "", found[0], flags=re.DOTALL)
        assert lighter != found[0]
        urdf = urdf.replace(found[0], lighter)
    (bare / "robot.urdf").write_text(urdf, encoding="utf-8")
    return load_cell(bare)


@pytest.mark.parametrize("links", [(2,), (2, 3)])
def test_poses_use_the_stated_weight(tmp_path: Path, links: tuple[int, ...]) -> None:
    """An arm that really has no mass in these links is consistent: the weight of all other links and the tool still
    deflects it."""
    cell = without_mass(poses.CELL.name, tmp_path, *links)
    stated = read_stated_masses(cell)
    assert stated is not None
    assert unknown_link_masses.list_links_without_mass(stated) == links
    r = poses.measure(noise=15e-6, masses=stated)
    d = diagnose_static_recording(
        cell, r, selection_pipeline.DiagnosisOptions(max_effects=3), [], accept=(), seed=0
    ).diagnosis
    assert (d.verdict, d.findings) == ("consistent", ())
    assert d.heldout_after < 0.02  # mm; 4.6 mm if all weight is dropped with link 3
    named = f"link{'s' if len(links) > 1 else ''} {' and '.join(map(str, links))}"
    assert [n for n in d.notes if "no mass of" in n] == [
        f"the URDF has no mass of {named}, whose own weight is not modelled; all that is stated is"
    ]
    assert not [n for n in d.notes if "no masses" in n]
    # the masses of wrist and tool alone are not enough for these effects, also in poses
    for effect in ("gravity_compensator", "payload"):
        why = [u.reason for u in d.untestable if u.effect == effect]
        assert any(named in w for w in why) == (links == (2, 3)), (effect, why)


@pytest.mark.parametrize(("links", "opened"), [((2,), {"link:2"}), ((3,), {"link:2", "link:3"})])
def test_load_tests_leave_link_weight_open(tmp_path: Path, links: tuple[int, ...], opened: set[str]) -> None:
    a, k, plan, robot, T, masses = heavy()
    cell = without_mass(CELL, tmp_path, *links)
    known = read_load_test_masses(cell)
    assert known is not None
    assert set(known.body.tolist()) == {1, 2, 3, 4, 5, 6} - set(links)
    r = load_tests(a, HiddenEffects(k), plan, np.random.default_rng(1), NoiseLevels(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    tests = build_load_test_experiment(r, robot, T)

    def built(m: RobotMasses | None, down: np.ndarray | None) -> tuple[set[str], float, list[str]]:
        """Return the links with free weight, the least-squares residual (m), and the reason why no balancer is
        tested."""
        problem, tried, _ = load_test_channel.build_load_test_problem(r, tests, robot, T, m, 1.0 / k, down=down)
        size = np.array([u.prior or 1.0 for u in problem.unknowns])
        A = (problem.base * size).reshape(problem.y.size, -1)
        y = problem.y.ravel()
        left = y - A @ np.linalg.lstsq(A, y, rcond=1e-10)[0]
        places = {u.location for u in problem.unknowns if u.location.startswith("link:")}
        return (
            places,
            float(np.sqrt(np.mean(left**2))),
            [u.reason for u in tried.untestable if u.effect == "gravity_compensator"],
        )

    places, left, why = built(known, DOWN)
    assert places == opened
    assert why == [f"the URDF has no mass of link {links[0]}, whose weight stiffens joints like a balancer does"]
    shut, nothing, whole = built(known, None)[1], built(None, DOWN), built(masses, DOWN)
    assert left < 0.5 * shut
    assert left < nothing[1]  # stated masses are more accurate than fitted ones
    assert nothing[2] == ["the URDF has no mass of links 2 and 3, whose weight stiffens joints like a balancer does"]
    assert (whole[0], whole[2]) == (set(), [])

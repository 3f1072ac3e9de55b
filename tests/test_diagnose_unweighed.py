"""Arms whose file tells no masses: what their weight does to a load test is left open, and takes no name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from made_up_loads import CELLS, Dirt, Truth, arm, displaced, load_tests, planned

from machopt.diagnose.resting import deflection, unweighed
from machopt.diagnose.run import known_masses
from machopt.diagnose.search import engine
from machopt.estimate.experiment import experiment
from machopt.formats.cell import load_cell
from machopt.model.robot import load_masses, load_robot

CELL = "kr240_drilling"
DOWN = np.array([0.0, 0.0, -9.80665])


@cache
def heavy():  # type: ignore[no-untyped-def]
    """An arm, its springs, a plan of loads, and the file's model of it."""
    a = arm(CELL)
    cell = load_cell(CELLS / CELL)
    plan = planned(a, np.random.default_rng(4), poses=20, loads=2)
    return a, 0.5 * a.nominal, plan, load_robot(cell), cell.tool.T_flange_tcp, load_masses(cell)


def test_weight_stiffens_and_sags_as_its_columns_say() -> None:
    """The weight's own part of every displacement, by an arm that stands where it really stands."""
    a, k, plan, robot, T, _ = heavy()
    bare = replace(a, mass=0.0 * a.mass)
    own = displaced(a, Truth(k), plan) - displaced(bare, Truth(k), plan)
    r = load_tests(a, Truth(k), plan, np.random.default_rng(0), Dirt(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    readings = deflection.readings_of(r, experiment(r, robot, T), robot, T, None, 1.0 / k)
    columns, unknowns = unweighed.columns(readings, DOWN)
    assert {u.location for u in unknowns} == {"link:2", "link:3"}
    A = columns.reshape(own.size, -1)
    x = np.linalg.lstsq(A, own.ravel(), rcond=1e-8)[0]
    left = own.ravel() - A @ x
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(own**2))  # wrist and second order
    upper_arm = np.linalg.norm(x[[n for n, u in enumerate(unknowns) if u.location == "link:2"]])
    borne = a.mass[2:].sum() * 1.05 + a.mass[1] * 0.5  # kg·m, the upper arm is 1.05 m long
    assert 0.5 * borne < upper_arm < 2.0 * borne


def test_no_balancer_is_named_for_weight_that_no_file_tells() -> None:
    a, k, plan, robot, T, masses = heavy()
    quiet = Dirt(2e-6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    r = load_tests(a, Truth(k), plan, np.random.default_rng(1), quiet)
    tests = experiment(r, robot, T)

    def found(down: np.ndarray | None) -> tuple[list[str], list[str], float]:
        problem, tried, _readings = deflection.build(r, tests, robot, T, None, down=down)

        def again(x: np.ndarray, _: object, __: object):  # type: ignore[no-untyped-def]
            return deflection.build(r, tests, robot, T, None, np.maximum(x[:6], 0.0), down=down)[:2]

        d = engine.diagnose(problem, tried, engine.Options(), np.random.default_rng(0), again)
        return [f.effect for f in d.findings], [u.effect for u in tried.untestable], d.heldout_after

    effects, untestable, left = found(DOWN)
    assert "gravity_compensator" in untestable
    assert set(effects) <= {"geometric_stiffness"}
    assert left < 0.5 * found(None)[2]  # what the columns hold comes back in every repeat
    known = deflection.build(r, tests, robot, T, masses)
    assert any(h.effect == "gravity_compensator" for h in known[1].hypotheses)


def test_a_tool_alone_does_not_make_an_arm_weigh(tmp_path) -> None:  # type: ignore[no-untyped-def]
    import re
    import shutil

    bare = tmp_path / "cell"
    shutil.copytree(CELLS / CELL, bare, ignore=shutil.ignore_patterns("recordings"))
    urdf = (bare / "robot.urdf").read_text(encoding="utf-8")
    (bare / "robot.urdf").write_text(re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.DOTALL), encoding="utf-8")
    assert known_masses(load_cell(bare)) is None
    assert known_masses(load_cell(CELLS / CELL)) is not None

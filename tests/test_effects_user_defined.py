"""User-defined effects: in every channel and in the plan; invalid files are refused."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machopt.batch import request as batch
from machopt.batch.run import run_batch
from machopt.cli import main
from machopt.commands.identify import run
from machopt.commands.identify.run import run_identify
from machopt.commands.plan_poses import run as plan_poses_run
from machopt.commands.plan_poses.run import run_plan_poses
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.effects import parameter_conversion, registry, user_effects
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import LawParameter
from machopt.errors import InputError
from machopt.measurement.diagnosis.effect_columns import user_hypotheses
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.identification.fitting.weighted_fit import fit_stiffness
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import build_fitted_term, list_effects_and_locations

JELLY = '''
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import COMPLIANCE, JOINTS, Effect, JointLawDefaults, LawParameter, Quantity


@dataclass(frozen=True)
class Saturating(JointLawDefaults):
    """phi = a tau0 tanh(tau / tau0)"""

    name = "tanh"
    equation = "phi = c tau + a tau0 tanh(tau/tau0)"
    coefficients = (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0),)
    shape = (LawParameter(key="half_way_Nm", unit="N·m", positive=True),)
    includes_weight = True

    def columns(self, shape, drive):
        return shape * np.tanh(drive.torque[..., None] / shape)

    def tangent(self, shape, drive):
        return np.cosh(drive.torque[..., None] / shape) ** -2.0

    def limit_to_compliance(self, values, room):
        return self

    def sizes(self, values, shape, scale):
        return {"slope": Quantity(1e6 * float(values[0]), "rad/(MN·m)")}

    def grid(self, scale):
        return tuple((s * scale.max_torque,) for s in (0.15, 0.3, 0.6))


JELLY = Effect(
    name="joint_jelly", noun="jelly", sentence="The joint gives as jelly does.", port="twist", places=JOINTS,
    joint_laws=(Saturating(),), is_elastic=True, note="at small torque",
)
EFFECTS = [JELLY]
'''


@pytest.fixture
def jelly(tmp_path: Path) -> Path:
    file = tmp_path / "jelly.py"
    file.write_text(JELLY)
    return file


def test_effect_file_added_at_runtime_enters_diagnosis_and_plan(jelly: Path) -> None:
    from test_effects import load_test

    r, cell = load_test()
    term = StiffnessTerm("joint_jelly", "joint:2", {"extra_rad_per_Nm": 1e-7, "half_way_Nm": 300.0})
    softer = ArmStiffness(joints=cell.joints, terms=(term,))
    loaded = user_effects.run_user_files((jelly,))
    assert user_hypotheses.load_hypothesis_sources(loaded) == []  # no additional laws of a single channel
    with user_effects.activate_user_effects(loaded):
        assert "joint_jelly" in list_effects_and_locations()
        found = {
            h.location
            for h in load_test_channel.build_load_test_catalogue(r, None).hypotheses
            if h.effect == "joint_jelly"
        }
        assert found == set(r.list_places(registry.EFFECTS["joint_jelly"].places))
        along = [
            ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses)
            .evaluate(r.state.q)
            .compute_compliance_along(np.eye(3)[[2]])
            for s in (softer, ArmStiffness(joints=cell.joints))
        ]
        assert (along[0] > along[1]).any()  # m/N
        with user_effects.activate_user_effects(loaded):  # a second activation adds no second effect
            assert "joint_jelly" in list_effects_and_locations()
    assert "joint_jelly" not in list_effects_and_locations()
    with pytest.raises(InputError, match=r"'joint_jelly' is not known.*--effects"):
        ArmElasticity(r.robot, r.T_flange_tcp, softer, None, r.masses)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("EFFECTS = [JELLY]", "EFFECTS = JELLY", "a list of Effect objects would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = []", "a list of Effect objects would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = [Saturating()]", "holds Saturating"),
        ("EFFECTS = [JELLY]", "EFFECTS = [JELLY, JELLY]", "is given twice"),
        ('name="joint_jelly"', 'name="joint_creep"', "'joint_creep' is the name of another effect; another name"),
        ("laws=(Saturating(),)", "laws=()", "an elastic effect with laws"),
        ("places=JOINTS", 'places=("base",)', "joint:1 … joint:6 would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = [1 / 0]", "does not run: ZeroDivisionError"),
        ("EFFECTS = [JELLY]", "(", "does not run: SyntaxError"),
        ("EFFECTS = [JELLY]", "import sys; sys.exit(0)", "does not run: SystemExit"),
        ("EFFECTS = [JELLY]", "class E(Exception): pass\nraise E('no')", "does not run: E: no"),
        ("places=JOINTS", "places=()", "joint:1 … joint:6 would work"),
        (
            'name="joint_jelly"',
            'name="jelly", word="transmission_error"',
            "'transmission_error' is the name of another",
        ),
        ("return shape * np.tanh", "return np.nan * np.tanh", "law 'tanh': columns under -500, 1, 800 N·m"),
        ("/ shape) ** -2.0", "/ shape)[..., 0]", "law 'tanh': tangent under -500, 1, 800 N·m have the shape (3,)"),
        ("return shape * np.tanh", "raise ValueError('oops')  #", "law 'tanh' does not run: ValueError: oops"),
        ("laws=(Saturating(),)", "laws=(3,)", "law 'int' does not run: AttributeError"),
    ],
)
def test_invalid_effect_file_is_answered_with_what_is_accepted(jelly: Path, old: str, new: str, said: str) -> None:
    assert old in JELLY
    jelly.write_text(JELLY.replace(old, new))
    before = registry.EFFECTS
    with pytest.raises(InputError) as caught, user_effects.activate_user_effects(user_effects.run_user_files((jelly,))):
        pass
    assert said in str(caught.value)
    assert "jelly.py" in str(caught.value)
    assert registry.EFFECTS is before


def test_file_without_laws_is_refused(jelly: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        user_effects.run_user_files((jelly.with_name("none.py"),))
    jelly.write_text("x = 1\n")
    with pytest.raises(InputError, match=r"no function hypotheses\(readings\).*EFFECTS"):
        user_hypotheses.load_hypothesis_sources(user_effects.run_user_files((jelly,)))
    with (
        pytest.raises(InputError, match="has no EFFECTS"),
        user_effects.activate_user_effects(user_effects.load_effect_files((jelly,))),
    ):
        pass


def test_catalogue_laws_pass_the_checks_of_user_laws() -> None:
    for effect in registry.select_joint_torque_effects():
        for law in effect.joint_laws:
            user_effects._try_joint_law(effect, law, "the catalogue")


def test_package_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for group in (user_effects.GROUP, user_hypotheses.GROUP):
        broken = EntryPoint("x", "nothere.at_all:EFFECTS", group)
        monkeypatch.setattr(
            user_effects,
            "_list_entry_points",
            lambda group, _path, broken=broken: [broken] if broken.group == group else [],
        )
        with pytest.raises(InputError, match=r"nothere.at_all.*does not load: ModuleNotFoundError"):
            user_effects.find_entry_points(group)
    with pytest.raises(InputError, match="does not load"):
        user_hypotheses.load_hypothesis_sources()


def test_law_parameters_survive_a_file_in_any_order() -> None:
    """A list before a single number was read and written by different rules."""
    law = SimpleNamespace(
        word="",
        coefficients=(LawParameter(key="b", unit="", is_list=True), LawParameter(key="a", unit="")),
        shape=(),
        has_memory=False,
    )
    stated = {"a": 5.0, "b": [1.0, 2.0]}
    values, shape, _ = parameter_conversion.read_law_parameters(law, ParameterReader(stated, "x"))
    assert parameter_conversion.write_law_parameters(law, values, shape) == stated
    assert [name for name, *_ in parameter_conversion.list_coefficient_names(law, 3)] == ["a", "b[0]", "b[1]"]


@pytest.mark.parametrize(
    ("words", "runs"),
    [
        (["identify", "cell", "rec"], "machopt.commands.identify.run.run_identify"),
        (["plan-poses", "cell"], "machopt.commands.plan_poses.run.run_plan_poses"),
        (["map", "cell"], "machopt.commands.map.run.run_map"),
        (["batch", "parts"], "machopt.batch.run.run_batch"),
    ],
    ids=lambda w: w[0] if isinstance(w, list) else "",
)
def test_commands_forward_effect_files_and_report_their_execution(
    words: list[str], runs: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    requested: list[Any] = []

    def noted(request: Any, _: object) -> None:
        requested.append(request)
        raise InputError("far enough")

    module, _, name = runs.rpartition(".")
    # by path, because functions with the same name hide packages
    monkeypatch.setattr(import_module(module), name, noted)
    assert main([*words, "-o", "out", "--effects", "a.py", "--effects", "b.py"]) == 2
    assert requested[0].effects == (Path("a.py"), Path("b.py"))
    assert "--effects runs the code in a.py with your rights" in capsys.readouterr().err


def test_missing_effect_file_is_refused_first(tmp_path: Path) -> None:
    gone, none = (tmp_path / "none.py",), tmp_path / "no cell"
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_identify(run.IdentifyRequest(cell=none, recordings=(none,), out=tmp_path / "out", effects=gone))
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_plan_poses(plan_poses_run.PosesRequest(cell=none, out=tmp_path / "out", effects=gone))
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_batch(batch.BatchRequest(jobs=("parts",), out=tmp_path / "out", effects=gone))


def test_identify_fits_a_user_law_with_a_stated_shape(jelly: Path) -> None:
    """For one joint with a given shape and no noise, the fit returns the coefficient that was used to simulate the
    readings."""
    from simulated_load_tests import TRUE_K, cell, draw_load_tests

    e = draw_load_tests(np.random.default_rng(1), rotations=True, noise=0.0)
    _, robot, tool = cell()
    with user_effects.activate_user_effects(user_effects.run_user_files((jelly,))):
        term = build_fitted_term("joint_jelly", "joint:2", robot, tool, half_way_Nm=300.0)
        more = (term.compute_response(e.state, e.wrench) @ np.array([2e-7]))[:, : e.dimensions]
        J = e.state.J[:, : e.dimensions]
        measured = np.einsum("nci,ni->nc", J, np.einsum("nci,nc->ni", e.state.J, e.wrench) / TRUE_K) + more
        found = fit_stiffness(replace(e, measured=measured), terms=(term,))
    np.testing.assert_allclose(found.x[6], 2e-7, rtol=1e-6)

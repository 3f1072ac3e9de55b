"""Effects of a user's own: a file that offers one, in every channel and in the plan, and files that are refused."""

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
from machopt.diagnose.laws import userterms
from machopt.diagnose.resting import deflection
from machopt.domain.stiffness import Stiffness, Term
from machopt.effects import files, own, registry
from machopt.effects.given import Parameters
from machopt.effects.protocol import Parameter
from machopt.errors import InputError
from machopt.identify.fit import fit
from machopt.model.elastic import ArmElasticity
from machopt.model.terms import term_of, vocabulary
from machopt.services import identify, poses
from machopt.services.identify import run_identify
from machopt.services.poses import run_plan_poses

JELLY = '''
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import COMPLIANCE, JOINTS, Effect, Parameter, Quantity, Settled


@dataclass(frozen=True)
class Saturating(Settled):
    """phi = a tau0 tanh(tau / tau0)"""

    name = "tanh"
    equation = "phi = c tau + a tau0 tanh(tau/tau0)"
    coefficients = (Parameter(key="extra_rad_per_Nm", unit=COMPLIANCE, least=0.0),)
    shape = (Parameter(key="half_way_Nm", unit="N·m", positive=True),)
    weighs = True

    def columns(self, shape, drive):
        return shape * np.tanh(drive.torque[..., None] / shape)

    def tangent(self, shape, drive):
        return np.cosh(drive.torque[..., None] / shape) ** -2.0

    def within(self, values, room):
        return self

    def sizes(self, values, shape, scale):
        return {"slope": Quantity(1e6 * float(values[0]), "rad/(MN·m)")}

    def grid(self, scale):
        return tuple((s * scale.reach,) for s in (0.15, 0.3, 0.6))


JELLY = Effect(
    name="joint_jelly", noun="jelly", sentence="The joint gives as jelly does.", port="twist", places=JOINTS,
    laws=(Saturating(),), elastic=True, note="at small torque",
)
EFFECTS = [JELLY]
'''


@pytest.fixture
def jelly(tmp_path: Path) -> Path:
    file = tmp_path / "jelly.py"
    file.write_text(JELLY)
    return file


def test_a_file_adds_an_effect_to_diagnosis_and_plan_while_it_is_in_use(jelly: Path) -> None:
    from test_effects import load_test

    r, cell = load_test()
    term = Term("joint_jelly", "joint:2", {"extra_rad_per_Nm": 1e-7, "half_way_Nm": 300.0})
    softer = Stiffness(joints=cell.joints, terms=(term,))
    loaded = own.run((jelly,))
    assert userterms.load(loaded) == []  # no laws of one channel beside it
    with own.in_use(loaded):
        assert "joint_jelly" in vocabulary()
        found = {h.location for h in deflection.catalogue(r, None).hypotheses if h.effect == "joint_jelly"}
        assert found == set(registry.EFFECTS["joint_jelly"].places)
        along = [
            ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses).at(r.state.q).along(np.eye(3)[[2]])
            for s in (softer, Stiffness(joints=cell.joints))
        ]
        assert (along[0] > along[1]).any()  # m/N
        with own.in_use(loaded):  # once more is no second effect
            assert "joint_jelly" in vocabulary()
    assert "joint_jelly" not in vocabulary()
    with pytest.raises(InputError, match=r"'joint_jelly' is not known.*--effects"):
        ArmElasticity(r.robot, r.T_flange_tcp, softer, None, r.masses)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("EFFECTS = [JELLY]", "EFFECTS = JELLY", "a list of Effect objects would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = []", "a list of Effect objects would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = [Saturating()]", "holds Saturating"),
        ("EFFECTS = [JELLY]", "EFFECTS = [JELLY, JELLY]", "stands twice"),
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
def test_a_file_that_will_not_do_says_what_would(jelly: Path, old: str, new: str, said: str) -> None:
    assert old in JELLY
    jelly.write_text(JELLY.replace(old, new))
    before = registry.EFFECTS
    with pytest.raises(InputError) as caught, own.in_use(own.run((jelly,))):
        pass
    assert said in str(caught.value)
    assert "jelly.py" in str(caught.value)
    assert registry.EFFECTS is before


def test_a_file_without_laws_is_refused(jelly: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        own.run((jelly.with_name("none.py"),))
    jelly.write_text("x = 1\n")
    with pytest.raises(InputError, match=r"no function hypotheses\(readings\).*EFFECTS"):
        userterms.load(own.run((jelly,)))
    with pytest.raises(InputError, match="has no EFFECTS"), own.in_use(own.with_effects((jelly,))):
        pass


def test_laws_of_the_catalogue_answer_as_a_users_must() -> None:
    for effect in registry.of_joint_torque():
        for law in effect.laws:
            own._try(effect, law, "the catalogue")


def test_a_package_that_does_not_load_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, group in ((own, own.GROUP), (own, userterms.GROUP)):
        broken = EntryPoint("x", "nothere.at_all:EFFECTS", group)
        monkeypatch.setattr(
            module, "entry_points", lambda group, broken=broken: [broken] if broken.group == group else []
        )
        with pytest.raises(InputError, match=r"nothere.at_all.*does not load: ModuleNotFoundError"):
            own.installed(group)
    with pytest.raises(InputError, match="does not load"):
        userterms.load()


def test_numbers_of_a_law_go_to_a_file_and_back_in_any_order() -> None:
    """A list before a single number was read and written by different rules."""
    law = SimpleNamespace(
        word="",
        coefficients=(Parameter(key="b", unit="", many=True), Parameter(key="a", unit="")),
        shape=(),
        remembers=False,
    )
    stated = {"a": 5.0, "b": [1.0, 2.0]}
    values, shape, _ = files.read(law, Parameters(stated, "x"))
    assert files.write(law, values, shape) == stated
    assert [name for name, *_ in files.named(law, 3)] == ["a", "b[0]", "b[1]"]


@pytest.mark.parametrize(
    ("words", "runs"),
    [
        (["identify", "cell", "rec"], "machopt.services.identify.run_identify"),
        (["plan-poses", "cell"], "machopt.services.poses.run_plan_poses"),
        (["map", "cell"], "machopt.services.map.run_map"),
        (["batch", "parts"], "machopt.batch.run.run_batch"),
    ],
    ids=lambda w: w[0] if isinstance(w, list) else "",
)
def test_commands_hand_on_files_with_effects_and_say_that_they_run_them(
    words: list[str], runs: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []

    def noted(request: Any, _: object) -> None:
        asked.append(request)
        raise InputError("far enough")

    module, _, name = runs.rpartition(".")
    monkeypatch.setattr(import_module(module), name, noted)  # by path: functions of like names hide packages
    assert main([*words, "-o", "out", "--effects", "a.py", "--effects", "b.py"]) == 2
    assert asked[0].effects == (Path("a.py"), Path("b.py"))
    assert "--effects runs the code in a.py with your rights" in capsys.readouterr().err


def test_a_missing_file_is_refused_before_anything_else_is_read(tmp_path: Path) -> None:
    gone, none = (tmp_path / "none.py",), tmp_path / "no cell"
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_identify(identify.IdentifyRequest(cell=none, recordings=(none,), out=tmp_path / "out", effects=gone))
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_plan_poses(poses.PosesRequest(cell=none, out=tmp_path / "out", effects=gone))
    with pytest.raises(InputError, match="no such file; a Python file"):
        run_batch(batch.BatchRequest(jobs=("parts",), out=tmp_path / "out", effects=gone))


def test_identify_fits_a_law_of_the_users_and_its_shape_is_stated(jelly: Path) -> None:
    """At one joint with its bend given, without noise: the number that made the readings."""
    from made_up_load_tests import TRUE_K, cell, draw

    e = draw(np.random.default_rng(1), rotations=True, noise=0.0)
    _, robot, tool = cell()
    with own.in_use(own.run((jelly,))):
        term = term_of("joint_jelly", "joint:2", robot, tool, half_way_Nm=300.0)
        more = (term.response(e.state, e.wrench) @ np.array([2e-7]))[:, : e.dimensions]
        J = e.state.J[:, : e.dimensions]
        measured = np.einsum("nci,ni->nc", J, np.einsum("nci,nc->ni", e.state.J, e.wrench) / TRUE_K) + more
        found = fit(replace(e, measured=measured), terms=(term,))
    np.testing.assert_allclose(found.x[6], 2e-7, rtol=1e-6)

"""Effects of a user's own: a file that offers one, in every channel and in the plan, and files that are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.diagnose import deflection, userterms
from machopt.domain.stiffness import Stiffness, Term
from machopt.effects import own, registry
from machopt.errors import InputError
from machopt.model.elastic import ArmElasticity
from machopt.model.terms import vocabulary

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
        return tuple((s * scale.reach,) for s in (0.2, 0.5))


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
    softer = Stiffness(cell.joints, terms=(term,))
    loaded = own.run((jelly,))
    assert userterms.load(loaded) == []  # no laws of one channel beside it
    with own.in_use(loaded):
        assert "joint_jelly" in vocabulary()
        found = {h.location for h in deflection.catalogue(r, None).hypotheses if h.effect == "joint_jelly"}
        assert found == set(registry.EFFECTS["joint_jelly"].places)
        along = [
            ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses).at(r.state.q).along(np.eye(3)[[2]])
            for s in (softer, Stiffness(cell.joints))
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
        ('name="joint_jelly"', 'name="joint_creep"', "'joint_creep' stands twice; another name"),
        ("laws=(Saturating(),)", "laws=()", "an elastic effect with laws"),
        ("places=JOINTS", 'places=("base",)', "joint:1 … joint:6 would work"),
        ("EFFECTS = [JELLY]", "EFFECTS = [1 / 0]", "does not run: ZeroDivisionError"),
        ("EFFECTS = [JELLY]", "(", "does not run: SyntaxError"),
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

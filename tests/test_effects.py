"""The contract of every law in the registry, and an effect that is added by one file and one line."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from machopt.arrays import Array
from machopt.diagnose.laws import at_joint
from machopt.diagnose.nouns.history import history
from machopt.diagnose.nouns.problem import Catalogue, Family, Problem, Unknown
from machopt.diagnose.nouns.readings import Readings
from machopt.diagnose.resting import deflection
from machopt.diagnose.search import engine
from machopt.diagnose.verdict.words import sentence
from machopt.domain.kinematics import Kinematics
from machopt.domain.location import joint_at, joints_of
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Stiffness, Term
from machopt.effects import coupling, creep, files, hysteresis, registry
from machopt.effects.corrections import entry, extended
from machopt.effects.given import Parameters
from machopt.effects.protocol import (
    COMPLIANCE,
    JOINTS,
    MEMORIES,
    Beside,
    Drive,
    Effect,
    Law,
    Parameter,
    Quantity,
    Scale,
    Settled,
    Unloaded,
)
from machopt.effects.words import named
from machopt.formats.cell import load_cell
from machopt.formats.kinematics import load_kinematics, write_kinematics
from machopt.formats.stiffness import load_stiffness, write_stiffness
from machopt.model.correction import correction_of
from machopt.model.elastic import ArmElasticity
from machopt.model.robot import load_masses, load_robot
from machopt.model.terms import term_of, vocabulary
from machopt.verify import springs
from machopt.verify.encoder import true_angles

ROOT = Path(__file__).resolve().parent.parent
SCALE = Scale(reach=1000.0, compliance=1e-6, low=-1.0, high=2.0)
SAMPLED = replace(SCALE, sampled=True)  # of a motion: some laws are offered there alone
TORQUES = np.linspace(-990.0, 990.0, 36)  # off the corners of all curves that are tried
ANGLES = np.linspace(-0.9, 1.9, 36)
OWN, PAIRED = (
    [pytest.param(e, law, id=f"{e.name} {law.name}") for e in some for law in e.laws]
    for some in (registry.of_joint_torque(), registry.of_joint_pairs())
)
LAWS = [*OWN, *PAIRED]


def made(law: Law, sign: float = 1.0) -> tuple[Array, Array]:
    """Coefficients that make twists of about 0.1 mrad, and a shape of the law's own grid."""
    shape = np.array((law.grid(SCALE) or law.grid(SAMPLED))[-1])
    size = np.abs(law.columns(shape, Drive(TORQUES, ANGLES))).max(axis=0)
    return sign * 1e-4 / size * np.arange(1.0, len(size) + 1.0), shape


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_tangent_is_the_difference(effect: Effect, law: Law) -> None:
    """Central differences; of what remembers far out, where the slope no longer grows."""
    _, shape = made(law)
    at = 1e5 * np.sign(TORQUES) + TORQUES if law.remembers else TORQUES
    step = 1e-3
    up, down = (law.columns(shape, Drive(at + s * step, ANGLES)) for s in (1.0, -1.0))
    tangent = law.tangent(shape, Drive(at, ANGLES))
    # rounding of a difference of columns over a step of 1e-3 N·m
    np.testing.assert_allclose(tangent, (up - down) / (2 * step), rtol=1e-6, atol=1e-6 * np.abs(tangent).max())


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_many_states_are_single_ones_and_histories_can_be_cut(effect: Effect, law: Law) -> None:
    """A state by itself, in a row of others, and as the first of a history that has settled: the same number."""
    _, shape = made(law)
    whole = law.columns(shape, Drive(TORQUES, ANGLES))
    for n in range(0, len(TORQUES), 9):
        assert law.columns(shape, Drive(TORQUES[n : n + 1], ANGLES[n : n + 1]))[0] == pytest.approx(whole[n], rel=1e-15)
    each = np.ones(len(TORQUES), np.int64)
    settled = law.columns(shape, Drive(TORQUES, ANGLES, np.full(len(TORQUES), np.inf), each))
    np.testing.assert_allclose(settled, whole, rtol=1e-15)
    lead = law.columns(shape, Drive(TORQUES.reshape(4, 9), ANGLES.reshape(4, 9)))
    np.testing.assert_array_equal(lead.reshape(36, -1), whole)


def test_a_path_in_pieces_is_the_same_path() -> None:
    """Up, back past zero and up again, with points between or without, whatever the drag does on the way."""
    corners = np.array([0.0, 900.0, -300.0, -250.0, 1000.0, 0.0])
    fine = np.concatenate([np.linspace(a, b, 8)[:-1] for a, b in itertools.pairwise(corners)] + [corners[-1:]])
    for beta in (0.3, 0.5, 0.65, 1.0):
        few, many = (hysteresis.drag(x, np.array([1] + [0] * (len(x) - 1)), 200.0, beta) for x in (corners, fine))
        np.testing.assert_allclose(many[::7], few, rtol=1e-12)
        assert np.abs(many).max() < 1.0


def test_play_that_is_used_up_parts_once_however_large_the_load() -> None:
    """Beyond the threshold the branches run side by side; a play's own part the further the more is loaded."""
    law = hysteresis.UsedUp()
    shape = np.array([80.0, 150.0])
    opened = []
    for largest in (1000.0, 2000.0):
        up = np.linspace(-largest, largest, 401)
        path = np.concatenate([up[200:], up[::-1], up])
        first = np.zeros(len(path), np.int64)
        first[0] = 1
        twist = law.columns(shape, Drive(path, first=first))[:, 0]
        down, rising = twist[201:602][::-1], twist[602:]
        opened.append(down[200] - rising[200])
        assert np.abs(down - rising)[[0, -1]].max() < 1e-6
    assert opened[0] == pytest.approx(2.0 * np.tanh(80.0 / 150.0), rel=1e-9)
    assert opened[1] == pytest.approx(opened[0], rel=1e-9)
    width = law.sizes(np.array([1e-4]), shape, Scale(reach=2000.0))["width"].value
    assert width * np.pi / 10800.0 == pytest.approx(1e-4 * opened[0], rel=1e-9)
    # a motion has other laws for it
    assert not law.grid(Scale(reach=1000.0, sampled=True))


def test_what_is_late_has_come_before_a_session_and_fades_by_the_clock_alone() -> None:
    """An arm that stood under its weight moves no more when a test begins; no cycle starts it afresh."""
    r, _ = load_test()
    r = replace(r, recording=replace(r.recording, time=np.cumsum(np.full(len(r), 20.0))))
    for session in range(2):
        drive = history(r, "session").drive(1, r.state.q[:, 1])
        start = history(r, "session").start[r.session == session][0]
        late = creep.lag(drive.torque, drive.gap, drive.first, 50.0)  # type: ignore[arg-type]
        assert late[start] == drive.torque[start] != 0.0
    for k, effect in enumerate((creep.EFFECT, hysteresis.EFFECT)):
        found, _ = at_joint.hypotheses(r, 1, effect)
        kept = [n for n, m in enumerate(MEMORIES) if k or m not in ("cycle", "approach")]
        assert {int(shape[-1]) for h in found for shape in h.shapes} == set(kept)


def test_a_gear_that_is_come_to_anew_for_every_cycle_is_wound_up_by_weight_each_time() -> None:
    """As on arrival, but before every cycle; where a visit is one cycle the two are one and tried once."""
    r, _ = load_test()
    each, arrival = history(r, "approach"), history(r, "arrival")
    assert np.array_equal(np.flatnonzero(each.first), np.unique(each.start))
    assert arrival.first.sum() == len(np.unique(r.visit)) < each.first.sum() == len(r.cycles)
    assert np.array_equal(each.torque, arrival.torque)
    once = replace(r, cycle=r.visit, recording=replace(r.recording, cycle=r.visit), memo={})
    found, _ = at_joint.hypotheses(once, 1, hysteresis.EFFECT)
    assert MEMORIES.index("approach") not in {int(shape[-1]) for h in found for shape in h.shapes}


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_sizes_grow_with_the_coefficients(effect: Effect, law: Law) -> None:
    values, shape = made(law)
    for scale in (SCALE, Scale(reach=1000.0, compliance=None, low=-1.0, high=2.0, sampled=True)):
        if scale.sampled and not law.grid(scale):
            continue  # not offered there
        one, two = (next(iter(law.sizes(k * values, shape, scale).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
        assert one.value > 0.0
        assert one.unit


@pytest.mark.parametrize(("effect", "law"), OWN)
def test_a_law_takes_no_more_than_it_says(effect: Effect, law: Law) -> None:
    """Its slope, of either sign of its coefficients where a file may have both; and what it says is reached."""
    for sign in (1.0, -1.0):
        if sign < 0.0 and all(p.least >= 0.0 for p in law.coefficients):
            continue
        values, shape = made(law, sign)
        least, _ = law.steepest(values, shape, SCALE.low, SCALE.high)
        if np.isneginf(least):
            held = law.within(values, 1e-6)
            assert held.steepest(values, shape, SCALE.low, SCALE.high)[0] == pytest.approx(-0.9e-6)
            continue
        tau, q = np.meshgrid(np.r_[TORQUES, 0.0, 1e5], np.linspace(SCALE.low, SCALE.high, 3001))
        slopes = law.tangent(shape, Drive(tau, q)) @ values
        if law.remembers:  # a rising load meets less than a lasting one
            up, down = (law.columns(shape, Drive(tau + s, q)) @ values for s in (5e-4, -5e-4))
            slopes = np.minimum(slopes, (up - down) / 1e-3)
        # 1e-5: the least lies between the angles that are looked at, there and here
        assert min(0.0, slopes.min()) == pytest.approx(least, abs=1e-5 * np.abs(slopes).max())


@pytest.mark.parametrize(("effect", "law"), LAWS)
@pytest.mark.parametrize("zero", [False, True])
def test_files_keep_everything(effect: Effect, law: Law, zero: bool, tmp_path: Path) -> None:
    """Through stiffness.yaml: law, coefficients (zeros too), shape, and what the gear remembers."""
    values, shape = made(law)
    values = 0.0 * values if zero else values
    memory = "arrival" if law.remembers else ""
    term = Term(effect.called, effect.places[1], files.write(law, values, shape, memory))
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, Stiffness(joints=np.full(6, 1e6), terms=(term,)))
    given = Parameters(load_stiffness(file).terms[0].parameters, "terms[0]")
    again = files.law_of(effect, given)
    found, form, said = files.read(again, given)
    given.finish()
    assert type(again) is type(law)
    assert again.word == law.word
    np.testing.assert_allclose(found, values, rtol=1e-14)
    np.testing.assert_allclose(form, shape, rtol=1e-14)
    assert said == memory
    assert set(files.write(again, found, form, said)) == set(term.parameters)


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_verify_has_the_same_law_in_its_own_writing(effect: Effect, law: Law) -> None:
    values, shape = made(law)
    term = Term(effect.called, "joint:3-5" if effect.paired else "joint:3", files.write(law, values, shape))
    mine = law.columns(shape, Drive(TORQUES, ANGLES)) @ values
    curved = springs.curves([term], np.full((1, 6), 1e6), np.full(6, -1.0), np.full(6, 2.0))
    if curved:
        theirs = curved[0].turn(TORQUES)
    else:
        q = np.zeros((len(ANGLES), 6))
        q[:, 2] = ANGLES
        C = springs.joint_compliance([term], q)
        theirs = C[:, 2, 4 if effect.paired else 2] * TORQUES
        np.testing.assert_array_equal(C, C.transpose(0, 2, 1))
    np.testing.assert_allclose(theirs, mine, rtol=1e-12, atol=1e-18)


UNLOADED = [pytest.param(e, law, id=e.name) for e, law in registry.without_load().values()]


def unloaded(law: Unloaded) -> tuple[Array, Array]:
    """Some coefficients of about 0.1 mrad, of two branches where a law has several."""
    shape = np.array([3.0, 40.5][: 2 * len(law.shape)])
    count = law.columns(shape, ANGLES).shape[-1]
    return 1e-4 * np.arange(1.0, count + 1.0), shape


@pytest.mark.parametrize(("effect", "law"), UNLOADED)
def test_angles_without_load_have_derivatives_and_bounds(effect: Effect, law: Unloaded) -> None:
    """Central differences, order by order; batches are singles; the steepest is met within a wave and never passed."""
    values, shape = unloaded(law)
    step = 1e-4
    for order in range(3):
        up, down = (law.columns(shape, ANGLES + s * step, order) for s in (1.0, -1.0))
        slope = law.columns(shape, ANGLES, order + 1)
        np.testing.assert_allclose((up - down) / (2 * step), slope, atol=1e-5 * max(np.abs(slope).max(), 1.0))
    whole = law.columns(shape, ANGLES)
    np.testing.assert_array_equal(law.columns(shape, ANGLES.reshape(4, 9)).reshape(36, -1), whole)
    np.testing.assert_array_equal(np.stack([law.columns(shape, a) for a in ANGLES]), whole)
    slopes = np.abs(law.columns(shape, np.linspace(-60.0, 60.0, 200001), 1) @ values)
    assert slopes.max() == pytest.approx(law.steepest(values, shape), rel=1e-2)
    assert slopes.max() <= law.steepest(values, shape) * (1.0 + 1e-12)
    one, two = (next(iter(law.sizes(k * values, shape).values())).value for k in (1.0, 2.0))
    assert two == pytest.approx(2.0 * one, rel=1e-12)
    assert one > 0.0


@pytest.mark.parametrize(("effect", "law"), UNLOADED)
@pytest.mark.parametrize("factor", [1.0, 0.0])
def test_kinematics_yaml_keeps_everything_and_verify_agrees(
    effect: Effect, law: Unloaded, factor: float, tmp_path: Path
) -> None:
    values, shape = unloaded(law)
    where = effect.places[2]
    known = Kinematics((entry(effect, where, factor * values, shape),))
    write_kinematics(tmp_path / "k.yaml", known)
    again = load_kinematics(tmp_path / "k.yaml")
    assert again == known
    found, form, _ = files.read(law, Parameters(again.corrections[0].parameters, "corrections[0]"))
    np.testing.assert_allclose(found, factor * values, rtol=1e-14)
    np.testing.assert_allclose(form, shape, rtol=1e-14)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 6))
    ours = correction_of(again)
    assert ours is not None
    by, moved = joints_of(where)
    expected = np.zeros((50, 6))
    expected[:, moved] = law.columns(shape, q[:, by]) @ values * factor
    np.testing.assert_array_equal(ours.delta(q), expected)
    np.testing.assert_allclose(true_angles(again, q) - q, expected, rtol=0.0, atol=2e-15)  # rounding of angles of 2 rad
    twice = extended(again, again.corrections)
    np.testing.assert_allclose(correction_of(twice).delta(q), 2.0 * expected, rtol=1e-12)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("effect", "law"), [pytest.param(e, law, id=law.name) for e in registry.of_beside() for law in e.beside]
)
def test_springs_beside_a_gear_have_their_slope_and_verify_agrees(effect: Effect, law: Beside) -> None:
    """Central differences; batches are singles; of the one that files state, the verifier's stiffness, zeros too."""
    step = 1e-4
    for shape in (np.array(s) for s in law.grid()[:: max(len(law.grid()) // 5, 1)]):
        up, down = (law.torque(shape, ANGLES + s * step) for s in (1.0, -1.0))
        np.testing.assert_allclose((up - down) / (2 * step), law.slope(shape, ANGLES), atol=1e-6)
        np.testing.assert_array_equal(law.torque(shape, ANGLES[3:4])[0], law.torque(shape, ANGLES)[3])
        values = np.array([4e3, 3e4])
        one, two = (next(iter(law.sizes(k * values).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value)
        stated = files.write(law, values, shape)
        found, form, _ = files.read(law, Parameters({k: v for k, v in stated.items() if k != "law"}, "terms[0]"))
        np.testing.assert_allclose(found, values, rtol=1e-14)
        np.testing.assert_allclose(form, shape, rtol=1e-14)
        if law is effect.beside[0]:
            theirs = springs.balancer([Term(effect.called, "joint:2", stated)], ANGLES)
            np.testing.assert_allclose(theirs, -law.slope(shape, ANGLES) @ values, rtol=1e-11, atol=1e-8)


def test_one_word_of_files_may_mean_an_elastic_and_a_kinematic_effect() -> None:
    """Two effects, each in its own file; a third of the same word in the same file is refused."""
    elastic, kinematic = coupling.ELASTIC, coupling.KINEMATIC
    assert elastic.name != kinematic.name
    assert elastic.called == kinematic.called == "joint_coupling"
    assert registry.known("joint_coupling") is elastic
    assert vocabulary()["joint_coupling"] == elastic.places
    assert registry.without_load()["joint_coupling"][0] is kinematic
    with pytest.raises(ValueError, match="'joint_coupling' stands twice"):
        registry.registry((elastic, replace(elastic, name="joint_rubber_coupling")))


def test_words_and_places() -> None:
    assert registry.EFFECTS
    for effect in registry.EFFECTS.values():
        assert effect.noun
        assert effect.sentence.endswith(".")
        assert not effect.elastic or effect.places == vocabulary()[effect.called]
    with pytest.raises(ValueError, match="stands twice"):
        registry.registry((creep.EFFECT, hysteresis.EFFECT, creep.EFFECT))


def test_time_unsaid_is_taken_for_the_time_constant() -> None:
    """A lone reading: what share of the pause its load took nobody knows; here one time constant."""
    first, torque = np.array([1, 0], np.int64), np.array([0.0, 1.0])
    for constant in (2.0, 30.0):
        assert creep.lag(torque, np.array([5.0, np.nan]), first, constant)[1] == pytest.approx(1.0 - np.exp(-1.0))
    x = creep.lag(np.array([1.0, 0.0, 0.0]), np.array([np.inf, -50.0, np.nan]), np.array([1, 0, 0], np.int64), 30.0)
    assert x == pytest.approx([1.0, np.exp(-20.0 / 30.0), np.exp(-50.0 / 30.0)])


# --- a toy --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Saturating(Settled):
    """φ = a τ₀ tanh(τ/τ₀), a law that the catalogue has not."""

    name = "tanh"
    equation = "φ = c τ + a τ₀ tanh(τ/τ₀)"
    coefficients = (Parameter(key="extra_rad_per_Nm", unit=COMPLIANCE, least=0.0),)
    shape = (Parameter(key="half_way_Nm", unit="N·m", positive=True),)
    weighs = True

    def columns(self, shape: Array, drive: Drive) -> Array:
        return np.asarray(shape * np.tanh(drive.torque[..., None] / shape))

    def tangent(self, shape: Array, drive: Drive) -> Array:
        return np.asarray(np.cosh(drive.torque[..., None] / shape) ** -2.0)

    def within(self, values: Array, room: float) -> Law:
        return self

    def sizes(self, values: Array, shape: Array, scale: Scale) -> dict[str, Quantity]:
        return {"slope": Quantity(1e6 * float(values[0]), "rad/(MN·m)")}

    def grid(self, scale: Scale) -> tuple[tuple[float, ...], ...]:
        return tuple((s * scale.reach,) for s in (0.2, 0.5))


TOY = Effect(
    name="joint_jelly",
    noun="jelly",
    sentence="The joint gives as jelly does.",
    port="twist",
    places=JOINTS,
    laws=(Saturating(),),
    elastic=True,
    note="at small torque",
)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Effect:
    monkeypatch.setattr(registry, "EFFECTS", registry.registry((*registry.LISTED, TOY)))
    return TOY


def load_test() -> tuple[Readings, Stiffness]:
    """Twelve poses, four loads at each, two sessions."""
    cell = load_cell(ROOT / "cells" / "kr240_drilling")
    robot, tool, masses = load_robot(cell), cell.tool.T_flange_tcp, load_masses(cell)
    assert cell.stiffness is not None
    rng = np.random.default_rng(0)
    q = np.radians([0, -90, 100, 0, 60, 0]) + rng.uniform(-0.5, 0.5, (12, 6))
    q = np.tile(np.repeat(q, 4, axis=0), (2, 1))
    w = np.tile(np.concatenate([rng.uniform(-900, 900, (48, 3)), rng.uniform(-90, 90, (48, 3))], axis=1), (2, 1))
    rows = np.arange(96)
    pose, session = np.tile(np.repeat(np.arange(12), 4), 2), np.repeat(np.arange(2), 48)
    recording = Recording(
        kind="deflection", source="made up", q=q, pose=pose, cycle=rows, session=session, line=rows, wrench=w
    )
    state, visit = robot.state(q, tool, bodies=True), session * 12 + pose
    c = 1.0 / cell.stiffness.joints
    return Readings(
        recording=recording,
        robot=robot,
        T_flange_tcp=tool,
        masses=masses,
        state=state,
        wrench=w,
        dimensions=6,
        differences=True,
        compliance=c,
        session=session,
        visit=visit,
        cycle=rows,
    ), cell.stiffness


def posed(r: Readings, beyond: Array) -> Problem:
    """The load test with its joints' springs, something beyond them (N, 6) m, rad, and noise of 5 µm and 5 µrad."""
    base = r.state.J * r.load_torque[:, None, :]
    rows = np.arange(1, len(r) + 1)
    return Problem(
        channel="deflection",
        y=base @ r.compliance + beyond + 5e-6 * np.random.default_rng(1).normal(size=beyond.shape),
        base=base,
        unknowns=tuple(
            Unknown(name=f"joint {j}", unit=COMPLIANCE, lower=0.0, location=joint_at(j)) for j in range(1, 7)
        ),
        families=(
            Family(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),
            Family(name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3),
        ),
        group=r.recording.pose,
        visit=r.visit,
        cycle=r.cycle,
        session=r.session,
        replicate=np.tile(np.arange(48), 2),
        line=rows,
        row=rows,
        time=r.recording.time,
    )


def test_what_a_cell_holds_explains_what_diagnose_fitted_whatever_the_gear_remembers() -> None:
    """Every law at a joint that load tests offer, in every memory: finding → file → the same displacement."""
    r, _ = load_test()
    r = replace(r, recording=replace(r.recording, time=np.cumsum(np.linspace(5.0, 40.0, len(r)))))
    seen = set()
    for h in deflection.catalogue(r, None).hypotheses:
        if h.location != "joint:3" or h.effect not in {e.name for e in registry.of_joint_torque() if e.remembers}:
            continue
        for shape in h.shapes[:: max(len(h.shapes) // 8, 1)]:
            columns = h.columns(shape)
            x = 1e-5 / np.abs(columns).max(axis=(0, 1)) * np.arange(1.0, columns.shape[2] + 1.0)
            term = h.correction(x, shape)
            assert isinstance(term, Term)
            other = Term("joint_backlash", "joint:2", {"width_arcmin": 1.0, "transition_Nm": 50.0})
            moved, left = at_joint.lived_through(r, (other, term))
            assert left == (other,)
            np.testing.assert_allclose(moved, columns @ x, rtol=1e-9, atol=1e-16)
            seen.add((h.effect, term.parameters["memory"]))
    at_once = {("joint_creep", m) for m in ("cycle", "approach")}  # what fades by the clock forgets nothing at once
    assert seen == {(e, m) for e in ("joint_hysteresis", "joint_creep") for m in MEMORIES} - at_once
    creep_term = Term("joint_creep", "joint:3", {"extra_rad_per_Nm": 1e-7, "time_constant_s": 9.0, "memory": "visit"})
    timeless = replace(r, recording=replace(r.recording, time=None), memo={})
    assert at_joint.lived_through(timeless, (creep_term,))[1] == (creep_term,)


def test_one_file_and_one_line_add_an_effect(toy: Effect, tmp_path: Path) -> None:
    """Found by diagnose with its limit, written to stiffness.yaml, read by the planner, then nothing is left."""
    r, cell = load_test()
    tried = deflection.catalogue(r, None)
    found = [h for h in tried.hypotheses if h.effect == toy.name]
    assert [h.location for h in found] == list(JOINTS)
    problem = posed(r, 2e-6 * found[2].columns(found[2].shapes[1])[:, :, 0])
    catalogue = Catalogue(tuple(h for h in tried.hypotheses if h.effect in (toy.name, hysteresis.EFFECT.name)))
    d = engine.diagnose(problem, catalogue, engine.Options(), np.random.default_rng(0))
    assert [(f.effect, f.location) for f in d.findings] == [(toy.name, "joint:3")]
    assert "jelly of joint 3" in sentence(d)
    assert named(toy.name, "joint:3") == "jelly of joint 3"
    term = d.findings[0].correction
    assert isinstance(term, Term)
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, Stiffness(joints=cell.joints, terms=(term,)))
    with_toy, without = (
        ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses).at(r.state.q)
        for s in (load_stiffness(file), Stiffness(joints=cell.joints))
    )
    more = with_toy.respond(r.wrench) - without.respond(r.wrench)
    axis = np.tile([0.0, 0.0, 1.0], (len(r), 1))
    assert (with_toy.along(axis) >= without.along(axis)).all()  # what optimize and map weigh
    again = engine.diagnose(replace(problem, y=problem.y - more), catalogue, engine.Options(), np.random.default_rng(0))
    assert again.verdict == "consistent"
    assert {x.location for x in again.limits if x.effect == toy.name} == set(JOINTS)
    assert toy.name in vocabulary()
    fitted = term_of(toy.name, "joint:3", r.robot, r.T_flange_tcp)  # EFFECT@LOCATION of identify and plan-poses
    assert np.isnan(fitted.values).all()

"""Contract of every joint effect in the registry, and an effect added by one file and one line."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.cell.kinematics_file import load_kinematics, write_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.effect_locations import format_joint_location, parse_joint_location
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.effect_wording import format_effect_at_place
from machopt.effects.joint import creep, hysteresis, joint_coupling, play_and_drag_operators
from machopt.effects.kinematic_corrections import build_kinematic_correction, extend_kinematics
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import (
    COMPLIANCE,
    JOINTS,
    MEMORIES,
    Effect,
    JointAngleLaw,
    JointLaw,
    JointLawDefaults,
    JointLoading,
    JointLoadRange,
    LawParameter,
    ParallelTorqueLaw,
    Quantity,
)
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    HypothesisCatalogue,
)
from machopt.measurement.diagnosis.data_types.gear_load_history import build_load_history
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import joint_torque
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.diagnosis.verdict.verdict_text import format_verdict
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import build_fitted_term, list_effects_and_locations
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles
from machopt.verification.motion.stiffness import spring_terms

ROOT = Path(__file__).resolve().parent.parent
SCALE = JointLoadRange(max_torque=1000.0, compliance=1e-6, min_angle=-1.0, max_angle=2.0)
SAMPLED = replace(SCALE, is_motion=True)  # scale of a motion: some laws exist for motions only
TORQUES = np.linspace(-990.0, 990.0, 36)  # avoids the kinks of all tested curves
ANGLES = np.linspace(-0.9, 1.9, 36)
OWN, PAIRED = (
    [pytest.param(e, law, id=f"{e.name} {law.name}") for e in some for law in e.joint_laws]
    for some in (registry.select_joint_torque_effects(), registry.select_joint_pair_effects())
)
LAWS = [*OWN, *PAIRED]


def choose_coefficients(law: JointLaw, sign: float = 1.0) -> tuple[Array, Array]:
    """Return coefficients that give twists of about 0.1 mrad, and a shape from the law's own grid."""
    shape = np.array((law.grid(SCALE) or law.grid(SAMPLED))[-1])
    size = np.abs(law.columns(shape, JointLoading(TORQUES, ANGLES))).max(axis=0)
    return sign * 1e-4 / size * np.arange(1.0, len(size) + 1.0), shape


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_tangent_equals_finite_differences(effect: Effect, law: JointLaw) -> None:
    """Central differences; for laws with memory at large torque, where the slope is constant."""
    _, shape = choose_coefficients(law)
    at = 1e5 * np.sign(TORQUES) + TORQUES if law.has_memory else TORQUES
    step = 1e-3
    up, down = (law.columns(shape, JointLoading(at + s * step, ANGLES)) for s in (1.0, -1.0))
    tangent = law.tangent(shape, JointLoading(at, ANGLES))
    # rounding of a difference of columns over a step of 1e-3 N·m
    np.testing.assert_allclose(tangent, (up - down) / (2 * step), rtol=1e-6, atol=1e-6 * np.abs(tangent).max())


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_batches_equal_single_states_and_histories_can_be_split(effect: Effect, law: JointLaw) -> None:
    """A single state, the same state in an array, and the same state at the start of a settled history give the same
    value."""
    _, shape = choose_coefficients(law)
    whole = law.columns(shape, JointLoading(TORQUES, ANGLES))
    for n in range(0, len(TORQUES), 9):
        assert law.columns(shape, JointLoading(TORQUES[n : n + 1], ANGLES[n : n + 1]))[0] == pytest.approx(
            whole[n], rel=1e-15
        )
    each = np.ones(len(TORQUES), np.int64)
    settled = law.columns(shape, JointLoading(TORQUES, ANGLES, np.full(len(TORQUES), np.inf), each))
    np.testing.assert_allclose(settled, whole, rtol=1e-15)
    lead = law.columns(shape, JointLoading(TORQUES.reshape(4, 9), ANGLES.reshape(4, 9)))
    np.testing.assert_array_equal(lead.reshape(36, -1), whole)


def test_path_in_pieces_equals_the_whole_path() -> None:
    """Loading, unloading past zero and reloading, with and without intermediate points, for several values of β."""
    corners = np.array([0.0, 900.0, -300.0, -250.0, 1000.0, 0.0])
    fine = np.concatenate([np.linspace(a, b, 8)[:-1] for a, b in itertools.pairwise(corners)] + [corners[-1:]])
    for beta in (0.3, 0.5, 0.65, 1.0):
        few, many = (
            play_and_drag_operators.compute_drag(x, np.array([1] + [0] * (len(x) - 1)), 200.0, beta)
            for x in (corners, fine)
        )
        np.testing.assert_allclose(many[::7], few, rtol=1e-12)
        assert np.abs(many).max() < 1.0


def test_closed_backlash_does_not_grow_with_the_load() -> None:
    """Above the threshold the branches are parallel; those of a play operator keep separating with the load."""
    law = hysteresis.SaturatedPlay()
    shape = np.array([80.0, 150.0])
    opened = []
    for largest in (1000.0, 2000.0):
        up = np.linspace(-largest, largest, 401)
        path = np.concatenate([up[200:], up[::-1], up])
        first = np.zeros(len(path), np.int64)
        first[0] = 1
        twist = law.columns(shape, JointLoading(path, segment_start=first))[:, 0]
        down, rising = twist[201:602][::-1], twist[602:]
        opened.append(down[200] - rising[200])
        assert np.abs(down - rising)[[0, -1]].max() < 1e-6
    assert opened[0] == pytest.approx(2.0 * np.tanh(80.0 / 150.0), rel=1e-9)
    assert opened[1] == pytest.approx(opened[0], rel=1e-9)
    width = law.sizes(np.array([1e-4]), shape, JointLoadRange(max_torque=2000.0))["width"].value
    assert width * np.pi / 10800.0 == pytest.approx(1e-4 * opened[0], rel=1e-9)
    # motions use other laws for this
    assert not law.grid(JointLoadRange(max_torque=1000.0, is_motion=True))


def test_creep_before_a_session_is_complete_and_later_depends_on_time_only() -> None:
    """An arm that rested under its weight no longer creeps when a test starts; a new cycle does not reset the creep."""
    r, _ = load_test()
    r = replace(r, recording=replace(r.recording, time=np.cumsum(np.full(len(r), 20.0))))
    for session in range(2):
        drive = build_load_history(r, "session").select_joint(1, r.state.q[:, 1])
        start = build_load_history(r, "session").unloaded_states[r.session == session][0]
        late = creep.filter_first_order(drive.torque, drive.time_gap, drive.segment_start, 50.0)  # type: ignore[arg-type]
        assert late[start] == drive.torque[start] != 0.0
    for k, effect in enumerate((creep.EFFECT, hysteresis.EFFECT)):
        found, _ = joint_torque.build_joint_hypotheses(r, 1, effect)
        retained = [n for n, m in enumerate(MEMORIES) if k or m not in ("cycle", "approach")]
        assert {int(shape[-1]) for h in found for shape in h.shapes} == set(retained)


def test_reset_memory_is_preloaded_by_weight_in_each_cycle() -> None:
    """Same as memory "arrival", but before every cycle; if each visit is one cycle, both are equal and only one is
    tried."""
    r, _ = load_test()
    each, arrival = build_load_history(r, "approach"), build_load_history(r, "arrival")
    assert np.array_equal(np.flatnonzero(each.segment_start), np.unique(each.unloaded_states))
    assert arrival.segment_start.sum() == len(np.unique(r.visit)) < each.segment_start.sum() == len(r.cycles)
    assert np.array_equal(each.torque, arrival.torque)
    once = replace(r, cycle=r.visit, recording=replace(r.recording, cycle=r.visit), histories={})
    found, _ = joint_torque.build_joint_hypotheses(once, 1, hysteresis.EFFECT)
    assert MEMORIES.index("approach") not in {int(shape[-1]) for h in found for shape in h.shapes}


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_sizes_grow_with_the_coefficients(effect: Effect, law: JointLaw) -> None:
    values, shape = choose_coefficients(law)
    for scale in (
        SCALE,
        JointLoadRange(max_torque=1000.0, compliance=None, min_angle=-1.0, max_angle=2.0, is_motion=True),
    ):
        if scale.is_motion and not law.grid(scale):
            continue  # not offered for motions
        one, two = (next(iter(law.sizes(k * values, shape, scale).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
        assert one.value > 0.0
        assert one.unit


@pytest.mark.parametrize(("effect", "law"), OWN)
def test_law_stays_within_its_stated_bounds(effect: Effect, law: JointLaw) -> None:
    """The slope stays within the stated bounds, with either sign of the coefficients where a file allows both, and
    reaches them."""
    for sign in (1.0, -1.0):
        if sign < 0.0 and all(p.lower_limit >= 0.0 for p in law.coefficients):
            continue
        values, shape = choose_coefficients(law, sign)
        least, _ = law.compute_max_slope(values, shape, SCALE.min_angle, SCALE.max_angle)
        if np.isneginf(least):
            fixed = law.limit_to_compliance(values, 1e-6)
            assert fixed.compute_max_slope(values, shape, SCALE.min_angle, SCALE.max_angle)[0] == pytest.approx(-0.9e-6)
            continue
        tau, q = np.meshgrid(np.r_[TORQUES, 0.0, 1e5], np.linspace(SCALE.min_angle, SCALE.max_angle, 3001))
        slopes = law.tangent(shape, JointLoading(tau, q)) @ values
        if law.has_memory:  # an increasing load has a lower slope than a constant one
            up, down = (law.columns(shape, JointLoading(tau + s, q)) @ values for s in (5e-4, -5e-4))
            slopes = np.minimum(slopes, (up - down) / 1e-3)
        # 1e-5: the minimum lies between the sampled angles, in both calculations
        assert min(0.0, slopes.min()) == pytest.approx(least, abs=1e-5 * np.abs(slopes).max())


@pytest.mark.parametrize(("effect", "law"), LAWS)
@pytest.mark.parametrize("zero", [False, True])
def test_files_preserve_law_coefficients_shape_and_memory(
    effect: Effect, law: JointLaw, zero: bool, tmp_path: Path
) -> None:
    """stiffness.yaml preserves law, coefficients (also zeros), shape and memory."""
    values, shape = choose_coefficients(law)
    values = 0.0 * values if zero else values
    memory = "arrival" if law.has_memory else ""
    term = StiffnessTerm(
        effect.file_word, effect.places[1], parameter_conversion.write_law_parameters(law, values, shape, memory)
    )
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, ArmStiffness(joints=np.full(6, 1e6), terms=(term,)))
    given = ParameterReader(load_stiffness(file).terms[0].parameters, "terms[0]")
    again = parameter_conversion.find_law(effect, given)
    found, form, output = parameter_conversion.read_law_parameters(again, given)
    given.refuse_unread_keys()
    assert type(again) is type(law)
    assert again.word == law.word
    np.testing.assert_allclose(found, values, rtol=1e-14)
    np.testing.assert_allclose(form, shape, rtol=1e-14)
    assert output == memory
    assert set(parameter_conversion.write_law_parameters(again, found, form, output)) == set(term.parameters)


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_verifier_has_its_own_implementation_of_the_law(effect: Effect, law: JointLaw) -> None:
    values, shape = choose_coefficients(law)
    term = StiffnessTerm(
        effect.file_word,
        "joint:3-5" if effect.is_joint_pair else "joint:3",
        parameter_conversion.write_law_parameters(law, values, shape),
    )
    mine = law.columns(shape, JointLoading(TORQUES, ANGLES)) @ values
    curved = spring_terms.build_torque_curves([term], np.full((1, 6), 1e6), np.full(6, -1.0), np.full(6, 2.0))
    if curved:
        theirs = curved[0].compute_rotation(TORQUES)
    else:
        q = np.zeros((len(ANGLES), 6))
        q[:, 2] = ANGLES
        C = spring_terms.compute_joint_compliance([term], q)
        theirs = C[:, 2, 4 if effect.is_joint_pair else 2] * TORQUES
        np.testing.assert_array_equal(C, C.transpose(0, 2, 1))
    np.testing.assert_allclose(theirs, mine, rtol=1e-12, atol=1e-18)


UNLOADED = [pytest.param(e, law, id=e.name) for e, law in registry.list_angle_effects_by_word().values()]


def choose_branch_coefficients(law: JointAngleLaw) -> tuple[Array, Array]:
    """Return coefficients of about 0.1 mrad, with two branches where a law has several."""
    shape = np.array([3.0, 40.5][: 2 * len(law.shape)])
    count = law.columns(shape, ANGLES).shape[-1]
    return 1e-4 * np.arange(1.0, count + 1.0), shape


@pytest.mark.parametrize(("effect", "law"), UNLOADED)
def test_joint_angle_errors_have_derivatives_and_bounds(effect: Effect, law: JointAngleLaw) -> None:
    """Derivatives equal central differences; batches equal single values; the maximum slope is reached within a wave
    and never exceeded."""
    values, shape = choose_branch_coefficients(law)
    step = 1e-4
    for order in range(3):
        up, down = (law.columns(shape, ANGLES + s * step, order) for s in (1.0, -1.0))
        slope = law.columns(shape, ANGLES, order + 1)
        np.testing.assert_allclose((up - down) / (2 * step), slope, atol=1e-5 * max(np.abs(slope).max(), 1.0))
    whole = law.columns(shape, ANGLES)
    np.testing.assert_array_equal(law.columns(shape, ANGLES.reshape(4, 9)).reshape(36, -1), whole)
    np.testing.assert_array_equal(np.stack([law.columns(shape, a) for a in ANGLES]), whole)
    slopes = np.abs(law.columns(shape, np.linspace(-60.0, 60.0, 200001), 1) @ values)
    assert slopes.max() == pytest.approx(law.compute_max_slope(values, shape), rel=1e-2)
    assert slopes.max() <= law.compute_max_slope(values, shape) * (1.0 + 1e-12)
    one, two = (next(iter(law.sizes(k * values, shape).values())).value for k in (1.0, 2.0))
    assert two == pytest.approx(2.0 * one, rel=1e-12)
    assert one > 0.0


@pytest.mark.parametrize(("effect", "law"), UNLOADED)
@pytest.mark.parametrize("factor", [1.0, 0.0])
def test_kinematics_yaml_preserves_everything_and_verify_agrees(
    effect: Effect, law: JointAngleLaw, factor: float, tmp_path: Path
) -> None:
    values, shape = choose_branch_coefficients(law)
    where = effect.places[2]
    known = KinematicCorrections((build_kinematic_correction(effect, where, factor * values, shape),))
    write_kinematics(tmp_path / "k.yaml", known)
    again = load_kinematics(tmp_path / "k.yaml")
    assert again == known
    found, form, _ = parameter_conversion.read_law_parameters(
        law, ParameterReader(again.corrections[0].parameters, "corrections[0]")
    )
    np.testing.assert_allclose(found, factor * values, rtol=1e-14)
    np.testing.assert_allclose(form, shape, rtol=1e-14)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (50, 6))
    ours = build_encoder_correction(again)
    assert ours is not None
    by, moved = parse_joint_location(where)
    expected = np.zeros((50, 6))
    expected[:, moved] = law.columns(shape, q[:, by]) @ values * factor
    np.testing.assert_array_equal(ours.compute_correction(q), expected)
    np.testing.assert_allclose(
        compute_true_angles(again, q) - q, expected, rtol=0.0, atol=2e-15
    )  # rounding of angles of 2 rad
    twice = extend_kinematics(again, again.corrections)
    np.testing.assert_allclose(build_encoder_correction(twice).compute_correction(q), 2.0 * expected, rtol=1e-12)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        pytest.param(e, law, id=law.name)
        for e in registry.select_parallel_torque_effects()
        for law in e.parallel_torque_laws
    ],
)
def test_parallel_springs_have_their_slope_and_verify_agrees(effect: Effect, law: ParallelTorqueLaw) -> None:
    """Slopes equal central differences; batches equal single values; for the law that files contain, the verifier's
    stiffness agrees, also with zeros."""
    step = 1e-4
    for shape in (np.array(s) for s in law.grid()[:: max(len(law.grid()) // 5, 1)]):
        up, down = (law.torque(shape, ANGLES + s * step) for s in (1.0, -1.0))
        np.testing.assert_allclose((up - down) / (2 * step), law.slope(shape, ANGLES), atol=1e-6)
        np.testing.assert_array_equal(law.torque(shape, ANGLES[3:4])[0], law.torque(shape, ANGLES)[3])
        values = np.array([4e3, 3e4])
        one, two = (next(iter(law.sizes(k * values).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value)
        stated = parameter_conversion.write_law_parameters(law, values, shape)
        found, form, _ = parameter_conversion.read_law_parameters(
            law, ParameterReader({k: v for k, v in stated.items() if k != "law"}, "terms[0]")
        )
        np.testing.assert_allclose(found, values, rtol=1e-14)
        np.testing.assert_allclose(form, shape, rtol=1e-14)
        if law is effect.parallel_torque_laws[0]:
            theirs = spring_terms.compute_balancer_stiffness(
                [StiffnessTerm(effect.file_word, "joint:2", stated)], ANGLES
            )
            np.testing.assert_allclose(theirs, -law.slope(shape, ANGLES) @ values, rtol=1e-11, atol=1e-8)


def test_one_word_may_mean_an_elastic_and_a_kinematic_effect() -> None:
    """Two effects with the same word in different files; a third one with the same word in the same file is refused."""
    elastic, kinematic = joint_coupling.ELASTIC, joint_coupling.KINEMATIC
    assert elastic.name != kinematic.name
    assert elastic.file_word == kinematic.file_word == "joint_coupling"
    assert registry.find_effect("joint_coupling") is elastic
    assert list_effects_and_locations()["joint_coupling"] == elastic.places
    assert registry.list_angle_effects_by_word()["joint_coupling"][0] is kinematic
    with pytest.raises(ValueError, match="'joint_coupling' is given twice"):
        registry.build_registry((elastic, replace(elastic, name="joint_rubber_coupling")))


def test_words_and_places_are_valid() -> None:
    assert registry.EFFECTS
    for effect in registry.EFFECTS.values():
        assert effect.noun
        assert effect.sentence.endswith(".")
        assert not effect.is_elastic or effect.places == list_effects_and_locations()[effect.file_word]
    with pytest.raises(ValueError, match="is given twice"):
        registry.build_registry((creep.EFFECT, hysteresis.EFFECT, creep.EFFECT))


def test_unknown_time_is_assumed_as_the_time_constant() -> None:
    """A single reading: the duration of its load relative to the pause is unknown; one time constant is assumed."""
    first, torque = np.array([1, 0], np.int64), np.array([0.0, 1.0])
    for constant in (2.0, 30.0):
        assert creep.filter_first_order(torque, np.array([5.0, np.nan]), first, constant)[1] == pytest.approx(
            1.0 - np.exp(-1.0)
        )
    x = creep.filter_first_order(
        np.array([1.0, 0.0, 0.0]), np.array([np.inf, -50.0, np.nan]), np.array([1, 0, 0], np.int64), 30.0
    )
    assert x == pytest.approx([1.0, np.exp(-20.0 / 30.0), np.exp(-50.0 / 30.0)])


# --- example effect -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Saturating(JointLawDefaults):
    """φ = a τ₀ tanh(τ/τ₀), a law that is not in the catalogue."""

    name = "tanh"
    equation = "φ = c τ + a τ₀ tanh(τ/τ₀)"
    coefficients = (LawParameter(key="extra_rad_per_Nm", unit=COMPLIANCE, lower_limit=0.0),)
    shape = (LawParameter(key="half_way_Nm", unit="N·m", positive=True),)
    includes_weight = True

    def columns(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(shape * np.tanh(drive.torque[..., None] / shape))

    def tangent(self, shape: Array, drive: JointLoading) -> Array:
        return np.asarray(np.cosh(drive.torque[..., None] / shape) ** -2.0)

    def limit_to_compliance(self, values: Array, room: float) -> JointLaw:
        return self

    def sizes(self, values: Array, shape: Array, scale: JointLoadRange) -> dict[str, Quantity]:
        return {"slope": Quantity(1e6 * float(values[0]), "rad/(MN·m)")}

    def grid(self, scale: JointLoadRange) -> tuple[tuple[float, ...], ...]:
        return tuple((s * scale.max_torque,) for s in (0.2, 0.5))


TOY = Effect(
    name="joint_jelly",
    noun="jelly",
    sentence="The joint gives as jelly does.",
    port="twist",
    places=JOINTS,
    joint_laws=(Saturating(),),
    is_elastic=True,
    note="at small torque",
)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> Effect:
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, TOY)))
    return TOY


def load_test() -> tuple[StaticReadings, ArmStiffness]:
    """Twelve poses with four loads each, in two sessions."""
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
    state, visit = robot.compute_state(q, tool, bodies=True), session * 12 + pose
    c = 1.0 / cell.stiffness.joints
    return StaticReadings(
        recording=recording,
        robot=robot,
        T_flange_tcp=tool,
        masses=masses,
        state=state,
        wrench=w,
        dimensions=6,
        is_difference=True,
        compliance=c,
        session=session,
        visit=visit,
        cycle=rows,
    ), cell.stiffness


def build_posed_problem(r: StaticReadings, beyond: Array) -> DiagnosisProblem:
    """Build the load test with joint springs, an additional displacement ``beyond`` (N, 6) m, rad, and noise of 5 µm
    and 5 µrad."""
    base = r.state.J * r.load_torque[:, None, :]
    rows = np.arange(1, len(r) + 1)
    return DiagnosisProblem(
        channel="deflection",
        y=base @ r.compliance + beyond + 5e-6 * np.random.default_rng(1).normal(size=beyond.shape),
        base=base,
        unknowns=tuple(
            BaseUnknown(name=f"joint {j}", unit=COMPLIANCE, lower=0.0, location=format_joint_location(j))
            for j in range(1, 7)
        ),
        families=(
            CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),
            CoordinateFamily(name="rotation", columns=(3, 4, 5), unit="mrad", factor=1e3),
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


def test_written_law_explains_what_diagnose_fitted_for_every_memory() -> None:
    """For every law of a joint in load tests and every memory, the written finding gives the same displacement as
    the fit."""
    r, _ = load_test()
    r = replace(r, recording=replace(r.recording, time=np.cumsum(np.linspace(5.0, 40.0, len(r)))))
    observed = set()
    for h in load_test_channel.build_load_test_catalogue(r, None).hypotheses:
        if h.location != "joint:3" or h.effect not in {
            e.name for e in registry.select_joint_torque_effects() if e.has_memory
        }:
            continue
        for shape in h.shapes[:: max(len(h.shapes) // 8, 1)]:
            columns = h.columns(shape)
            x = 1e-5 / np.abs(columns).max(axis=(0, 1)) * np.arange(1.0, columns.shape[2] + 1.0)
            term = h.correction(x, shape)
            assert isinstance(term, StiffnessTerm)
            other = StiffnessTerm("joint_backlash", "joint:2", {"width_arcmin": 1.0, "transition_Nm": 50.0})
            moved, left = joint_torque.compute_memory_term_displacement(r, (other, term))
            assert left == (other,)
            np.testing.assert_allclose(moved, columns @ x, rtol=1e-9, atol=1e-16)
            observed.add((h.effect, term.parameters["memory"]))
    at_once = {("joint_creep", m) for m in ("cycle", "approach")}  # creep decays with time and is not reset by a cycle
    assert observed == {(e, m) for e in ("joint_hysteresis", "joint_creep") for m in MEMORIES} - at_once
    creep_term = StiffnessTerm(
        "joint_creep", "joint:3", {"extra_rad_per_Nm": 1e-7, "time_constant_s": 9.0, "memory": "visit"}
    )
    timeless = replace(r, recording=replace(r.recording, time=None), histories={})
    assert joint_torque.compute_memory_term_displacement(timeless, (creep_term,))[1] == (creep_term,)


def test_effect_is_added_by_one_file_and_one_line(toy: Effect, tmp_path: Path) -> None:
    """The effect is found by diagnose with its detection limit, written to stiffness.yaml and read by the planner;
    then nothing is left."""
    r, cell = load_test()
    tried = load_test_channel.build_load_test_catalogue(r, None)
    found = [h for h in tried.hypotheses if h.effect == toy.name]
    assert [h.location for h in found] == list(JOINTS[: r.joint_count])
    problem = build_posed_problem(r, 2e-6 * found[2].columns(found[2].shapes[1])[:, :, 0])
    catalogue = HypothesisCatalogue(
        tuple(h for h in tried.hypotheses if h.effect in (toy.name, hysteresis.EFFECT.name))
    )
    d = selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert [(f.effect, f.location) for f in d.findings] == [(toy.name, "joint:3")]
    assert "jelly of joint 3" in format_verdict(d)
    assert format_effect_at_place(toy.name, "joint:3") == "jelly of joint 3"
    term = d.findings[0].correction
    assert isinstance(term, StiffnessTerm)
    file = tmp_path / "stiffness.yaml"
    write_stiffness(file, ArmStiffness(joints=cell.joints, terms=(term,)))
    with_toy, without = (
        ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses).evaluate(r.state.q)
        for s in (load_stiffness(file), ArmStiffness(joints=cell.joints))
    )
    more = with_toy.compute_twist(r.wrench) - without.compute_twist(r.wrench)
    axis = np.tile([0.0, 0.0, 1.0], (len(r), 1))
    assert (
        with_toy.compute_compliance_along(axis) >= without.compute_compliance_along(axis)
    ).all()  # value used by optimize and map
    again = selection_pipeline.diagnose_problem(
        replace(problem, y=problem.y - more), catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert again.verdict == "consistent"
    assert {x.location for x in again.limits if x.effect == toy.name} == set(JOINTS[: r.joint_count])
    assert toy.name in list_effects_and_locations()
    fitted = build_fitted_term(
        toy.name, "joint:3", r.robot, r.T_flange_tcp
    )  # EFFECT@LOCATION of identify and plan-poses
    assert np.isnan(fitted.values).all()

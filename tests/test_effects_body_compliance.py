"""Contract of every body effect, and a body effect added by one file and one line."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from test_effects import build_posed_problem, load_test

from machopt.cell.cell_reader import load_cell
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.effect_locations import is_on_arm
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.effects import registry, user_effects
from machopt.effects.compliance_matrices import body_compliance_laws, tapered_tube, uniform_beam_law
from machopt.effects.compliance_matrices.semidefinite_projection import find_nearest_semidefinite
from machopt.effects.effect_wording import format_effect_at_place
from machopt.effects.protocol import BodyLaw, CompliantBody, Effect, LawParameter, Quantity
from machopt.errors import EffectDefinitionError
from machopt.kinematics.robot import ArmState, Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import HypothesisCatalogue
from machopt.measurement.diagnosis.effect_columns import structural_compliance
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import skew_matrix
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.terms import build_fitted_term, list_effects_and_locations
from machopt.stiffness.terms.body_spring import BodySpring, build_spring, locate_spring
from machopt.verification.motion.stiffness import spring_terms

ROOT = Path(__file__).resolve().parent.parent
NONE = np.empty(0)
CELLS = ("kr240_drilling", "cutting_cobot")  # with a spherical wrist and without
LAWS = [pytest.param(e, law, id=f"{e.name} {law.name}") for e in registry.select_body_effects() for law in e.body_laws]


def arm(cell: str = CELLS[0]) -> tuple[Robot, Array, ArmState, Array]:
    """Return robot, tool, seven postures and a wrench at each."""
    loaded = load_cell(ROOT / "cells" / cell)
    robot, tool = load_robot(loaded), loaded.tool.T_flange_tcp
    rng = np.random.default_rng(0)
    return (
        robot,
        tool,
        robot.compute_state(rng.uniform(-1.0, 1.0, (7, 6)), tool, bodies=True),
        rng.normal(size=(7, 6)) * 100.0,
    )


def build_body_spring(robot: Robot, tool: Array, effect: Effect, law: BodyLaw, where: str) -> BodySpring | None:
    """Build a law at a location with coefficients of typical size; None if the law does not exist for this body."""
    place = locate_spring(robot, tool, where)
    grid = law.grid(place.shape)
    if not grid:
        return None
    shape = np.array(grid[-1])
    C = law.matrices(shape, place.shape)
    values = 1e-8 * np.arange(1.0, len(C) + 1.0) / np.abs(C).max(axis=(1, 2))
    if not law.bounded:  # a positive definite matrix
        A = np.random.default_rng(1).normal(size=(6, 6))
        values = 1e-9 * np.array([(A @ A.T)[i, j] for i, j in getattr(law, "pairs", body_compliance_laws.ALL_ENTRIES)])
    elif len(values) > 2 and law.coefficients[2].key == "both":
        values[2] *= 0.1  # the coupling of shift and tilt is smaller than either
    return build_spring(effect.file_word, place, law, values, shape)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_law_is_symmetric_and_batches_equal_single_states(effect: Effect, law: BodyLaw, cell: str) -> None:
    """The matrices are symmetric (Maxwell), single states equal batches, and the twist is linear in the wrench."""
    robot, tool, state, wrench = arm(cell)
    observed = 0
    for where in (place for place in effect.places if is_on_arm(place, 6)):
        one = build_body_spring(robot, tool, effect, law, where)
        if one is None:
            continue
        # m², relative to a lever of 1 m
        np.testing.assert_allclose(one.basis, one.basis.transpose(0, 2, 1), atol=1e-15)
        whole = one.compute_response(state, wrench)
        lone = robot.compute_state(state.q[3:4], tool, bodies=True)
        np.testing.assert_allclose(one.compute_response(lone, wrench[3:4])[0], whole[3], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(one.compute_response(state, -2.0 * wrench), -2.0 * whole, rtol=1e-12)
        np.testing.assert_allclose(
            one.combine_coefficients().compute_response(state, wrench)[..., 0], whole @ one.values, rtol=1e-9
        )
        observed += 1
    assert observed or law.name.startswith("bends about")  # the TCP lies on the tool's axis


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_sizes_grow_with_the_coefficients(effect: Effect, law: BodyLaw) -> None:
    values = np.arange(1.0, len(law.coefficients) + 1.0) * 1e-8
    one, two = (next(iter(law.sizes(k * values, NONE).values())) for k in (1.0, 2.0))
    assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
    assert one.value > 0.0
    assert one.unit
    assert law.equation


@pytest.mark.parametrize("zero", [False, True])
@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_files_preserve_everything_and_the_verifier_agrees(
    effect: Effect, law: BodyLaw, zero: bool, tmp_path: Path
) -> None:
    """Written to stiffness.yaml and read, the planner's and the verifier's laws give the same twist; zeros remain
    zeros."""
    robot, tool, state, wrench = arm()
    one = next(
        (m for where in effect.places if (m := build_body_spring(robot, tool, effect, law, where)) is not None), None
    )
    if one is None:
        pytest.skip("the TCP lies on the tool's axis")
    values = 0.0 * one.values if zero else one.values
    term = one.with_values(values).to_file()
    write_stiffness(tmp_path / "s.yaml", ArmStiffness(joints=np.full(6, 1e6), terms=(term,)))
    read = load_stiffness(tmp_path / "s.yaml").terms[0]
    again = build_fitted_term(read.effect, read.location, robot, tool, **dict(read.parameters))
    assert np.isfinite(again.values).all()
    moved = one.compute_response(state, wrench) @ values
    np.testing.assert_allclose(again.compute_response(state, wrench) @ again.values, moved, rtol=1e-9, atol=1e-18)
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    ((body, S, C),) = spring_terms.build_body_springs([read], robot.point, robot.T_base_flange_zero, tool)
    for n in range(len(wrench)):  # the verifier's matrix, transformed explicitly here
        R, p = state.R_bodies[n, body], state.p_bodies[n, body]
        G = np.eye(6)
        G[:3, 3:] = -skew_matrix(state.T_base_tool[n, :3, 3] - R @ S[:3, 3] - p)
        carried = G @ np.kron(np.eye(2), R @ S[:3, :3])
        np.testing.assert_allclose(carried @ C @ carried.T @ wrench[n], moved[n], rtol=1e-8, atol=1e-16)
    if np.all(values):
        assert again.to_file().parameters.keys() == term.parameters.keys()


def test_distributed_weight_counts_where_the_law_requires() -> None:
    """A beam bends under its own distributed weight; other bodies only under point weights at their end."""
    robot, tool, state, _ = arm()
    own_weight = [(np.array([0.0, 0.0, -500.0]), 0.5)]
    for effect in registry.select_body_effects():
        for law in effect.body_laws:
            one = build_body_spring(robot, tool, effect, law, effect.places[0])
            if one is None:
                continue
            sag = one.compute_weight_sag(state, own_weight)
            assert (sag is not None) == isinstance(law, uniform_beam_law.UniformBeamLaw)
            assert sag is None or sag.shape == (7, 6, len(one.values))


def test_two_equal_bending_planes_are_one_beam() -> None:
    body = CompliantBody(axes=np.eye(3), length=0.7)
    alike = uniform_beam_law.TWO_PLANES.matrices(NONE, body)
    np.testing.assert_array_equal(alike[0] + alike[1], uniform_beam_law.UniformBeamLaw().matrices(NONE, body)[0])


def test_beam_by_sections_agrees_with_published_tables() -> None:
    """Load at the end and beyond it: transformed matrices; own weight W only: W L³/8EI and W L²/6EI."""
    L, (x, y, z) = 0.8, np.eye(3)
    body = CompliantBody(axes=np.eye(3), length=L)
    axes = [np.tile(n, (7, 1)) for n in (z, -y, x)]
    wrench = np.random.default_rng(0).normal(size=(7, 6))
    at_end = uniform_beam_law.compute_section_deflection(axes, L, np.tile(L * x, (7, 1)), wrench)
    expected = np.einsum("pij,nj->nip", uniform_beam_law.TWO_PLANES.matrices(NONE, body), wrench)
    np.testing.assert_allclose(at_end, expected, rtol=1e-12, atol=1e-15)
    beyond = np.array([0.3, -0.2, 0.5])
    G = np.eye(6)
    G[:3, 3:] = -skew_matrix(beyond)
    carried = np.einsum("ij,pjk,lk,nl->nip", G, uniform_beam_law.TWO_PLANES.matrices(NONE, body), G, wrench)
    np.testing.assert_allclose(
        uniform_beam_law.compute_section_deflection(axes, L, np.tile(L * x + beyond, (7, 1)), wrench),
        carried,
        rtol=1e-12,
        atol=1e-14,
    )
    sag = uniform_beam_law.compute_section_deflection(
        axes, L, np.tile(L * x, (7, 1)), np.zeros((7, 6)), [(-50.0 * y, L)]
    )[0]
    np.testing.assert_allclose(sag[:, 0], [0.0, -50.0 * L**3 / 8.0, 0.0, 0.0, 0.0, -50.0 * L**2 / 6.0], atol=1e-12)
    np.testing.assert_allclose(sag[:, 1:], 0.0, atol=1e-12)


def test_uniform_tube_without_shear_is_a_beam() -> None:
    body, even = CompliantBody(axes=np.eye(3), length=0.7), np.array(tapered_tube.UNIFORM)
    own = [(np.array([[3.0, -50.0, 20.0]]), 0.9)]
    np.testing.assert_allclose(
        tapered_tube.TAPERED.matrices(even, body), uniform_beam_law.TWO_PLANES.matrices(NONE, body), atol=1e-15
    )
    sags = [
        law.compute_own_weight_deflection(shape, body, own)
        for law, shape in ((tapered_tube.TAPERED, even), (uniform_beam_law.TWO_PLANES, NONE))
    ]
    assert sags[0] is not None
    assert sags[1] is not None
    np.testing.assert_allclose(sags[0], sags[1], rtol=3e-3, atol=1e-12)  # the weight ends between two sections
    # also for a file without the two shape numbers
    assert np.isfinite(tapered_tube.TAPERED.matrices(np.full(2, np.nan), body)).all()


def test_tube_bending_and_shear_agree_with_closed_forms() -> None:
    """Radius 1.5 at the root and 0.75 at the end: ∫ u^k (r_mid/r)³ du in closed form; the own weight W adds a shear
    deflection of Φ L²/EI · W L/2."""
    L, root, end, middle = 0.8, 1.5, 0.75, 1.125
    body, slope = CompliantBody(axes=np.eye(3), length=L), (root - end) / L
    about_z, about_y, twisted = tapered_tube.TAPERED.matrices(np.array([end / root, 0.0]), body)
    turned = middle**3 / (2.0 * slope) * (end**-2 - root**-2)
    coupled = middle**3 / slope**2 * ((1 / end - 1 / root) - end / 2.0 * (end**-2 - root**-2))
    lifted = (
        middle**3
        / slope**3
        * (np.log(root / end) - 2.0 * end * (1 / end - 1 / root) + end**2 / 2.0 * (end**-2 - root**-2))
    )
    np.testing.assert_allclose(about_z[np.ix_((1, 5), (1, 5))], [[lifted, coupled], [coupled, turned]], rtol=1e-10)
    np.testing.assert_allclose(about_y[np.ix_((2, 4), (2, 4))], [[lifted, -coupled], [-coupled, turned]], rtol=1e-10)
    assert twisted[3, 3] == pytest.approx(turned, rel=1e-10)
    shears = tapered_tube.TAPERED.matrices(np.array([end / root, 0.2]), body)[0, 1, 1] - lifted
    assert shears == pytest.approx(0.2 * L**2 * middle / slope * np.log(root / end), rel=1e-10)
    own = [(np.array([[0.0, -50.0, 0.0]]), L)]
    sags = [tapered_tube.TAPERED.compute_own_weight_deflection(np.array([1.0, s]), body, own) for s in (0.2, 0.0)]
    assert sags[0] is not None
    assert sags[1] is not None
    assert sags[0][0, 1, 0] - sags[1][0, 1, 0] == pytest.approx(-50.0 * L / 2.0 * 0.2 * L**2, rel=1e-10)


def test_link_shapes_include_a_tapered_casting() -> None:
    """For the tapered, shear-compliant and asymmetric link of the energy benchmark, uniform beams leave several
    times the residual of tapered ones."""
    sys.path.append(str(ROOT / "benchmarks" / "diagnosis_energy_benchmark"))
    import body_compliance as foreign

    L = 1.1
    truth = foreign.beam(np.array([L, 0.0, 0.0]), 2e6, 0.7, flat=1.3)
    scale = np.array([1.0, 1.0, 1.0, L, L, L])

    def left(law: BodyLaw, shape: Array) -> float:
        size = np.outer(scale, scale)
        X = (law.matrices(shape, CompliantBody(axes=np.eye(3), length=L)) * size).reshape(len(law.coefficients), -1).T
        y = (truth * size)[np.ix_(range(6), range(6))]
        y[0, 0] = 0.0  # no law here has axial compliance
        rest = y.ravel() - X @ np.linalg.lstsq(X, y.ravel(), rcond=None)[0]
        return float(np.linalg.norm(rest) / np.linalg.norm(y))

    grid = [np.array(s) for s in tapered_tube.TAPERED.grid(CompliantBody(axes=np.eye(3), length=L))]
    assert 4.0 * min(left(tapered_tube.TAPERED, s) for s in grid) < left(uniform_beam_law.TWO_PLANES, NONE)


# --- example effect -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sheared(uniform_beam_law.BodyLawDefaults):
    """The far end of a body translates with the lateral force and does not rotate."""

    name = "shears"
    equation = "d = c (I − x xᵀ) f, x along the body"
    coefficients = (LawParameter(key="shear_mm_per_kN", unit="m/N", factor=1e-6, lower_limit=0.0),)

    def axes(self, body: CompliantBody) -> Array:
        return body.axes

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        return np.diag([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])[None]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"shear": Quantity(1e6 * float(values[0]), "mm/kN")}


TOY = Effect(
    name="link_rubber",
    noun="rubber",
    sentence="The link ends in rubber.",
    port="body",
    places=("link:2", "link:3", "link:4"),
    body_laws=(Sheared(),),
    is_elastic=True,
)


def test_body_effect_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The effect is found by diagnose with its detection limit, written to stiffness.yaml and read by the planner;
    then nothing is left."""
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, TOY)))
    r, cell = load_test()
    found = [h for h in structural_compliance.build_structure_hypotheses(r) if h.effect == TOY.name]
    assert [h.location for h in found] == list(TOY.places)
    tried = [
        h
        for h in load_test_channel.build_load_test_catalogue(r, None).hypotheses
        if h.effect in (TOY.name, "link_compliance")
    ]
    problem = build_posed_problem(r, 2e-7 * found[1].columns(())[:, :, 0])
    d = selection_pipeline.diagnose_problem(
        problem, HypothesisCatalogue(tuple(tried)), selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert [(f.effect, f.location) for f in d.findings] == [(TOY.name, "link:3")]
    assert format_effect_at_place(TOY.name, "link:3") == "rubber of link 3"
    term = d.findings[0].correction
    assert isinstance(term, StiffnessTerm)
    assert term.parameters["shear_mm_per_kN"] == pytest.approx(0.2, rel=0.05)  # noise 5 µm, twists of 0.2 mm
    write_stiffness(tmp_path / "s.yaml", ArmStiffness(joints=cell.joints, terms=(term,)))
    with_toy, without = (
        ArmElasticity(r.robot, r.T_flange_tcp, s, None, r.masses).evaluate(r.state.q)
        for s in (load_stiffness(tmp_path / "s.yaml"), ArmStiffness(joints=cell.joints))
    )
    more = with_toy.compute_twist(r.wrench) - without.compute_twist(r.wrench)
    np.testing.assert_allclose(structural_compliance.compute_term_displacement(r, term), more, rtol=1e-9, atol=1e-15)
    axis = np.tile([0.0, 0.0, 1.0], (len(r), 1))
    assert (
        with_toy.compute_compliance_along(axis) >= without.compute_compliance_along(axis)
    ).all()  # value used by optimize and map
    again = selection_pipeline.diagnose_problem(
        replace(problem, y=problem.y - more),
        HypothesisCatalogue(tuple(tried)),
        selection_pipeline.DiagnosisOptions(),
        np.random.default_rng(0),
    )
    assert again.verdict == "consistent"
    assert {x.location for x in again.limits if x.effect == TOY.name} == set(TOY.places)
    assert list_effects_and_locations()[TOY.name] == TOY.places
    assert np.isnan(
        build_fitted_term(TOY.name, "link:2", r.robot, r.T_flange_tcp).values
    ).all()  # EFFECT@LOCATION of identify
    assert TOY.name not in spring_terms.KNOWN_EFFECTS  # so the verifier reports that it did not check it


def test_user_defined_body_is_accepted_and_an_invalid_one_named() -> None:
    user_effects._check_effects([TOY], "mine.py")
    for bad, output in (
        (replace(TOY, places=("wall",)), "port body and places link:1 … link:6, base, tool"),
        (replace(TOY, body_laws=(Flat(),)), r"law 'shears': matrices have the shape"),
        (replace(TOY, body_laws=(Broken(),)), r"does not run: ZeroDivisionError"),
    ):
        with pytest.raises(EffectDefinitionError, match=output):
            user_effects._check_effects([bad], "mine.py")


class Flat(Sheared):
    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        return np.eye(6)


class Broken(Sheared):
    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        return np.eye(6)[None] / (1 // 0)


def test_nearest_valid_body_uses_the_metric_of_the_readings() -> None:
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    rng = np.random.default_rng(5)
    C = np.diag([2e-8, 3e-8, -1e-8])  # negative compliance along z
    C[0, 1] = C[1, 0] = 1e-8
    values = np.array([C[i, j] for i, j in pairs])
    shown = rng.normal(size=(40, 6)) * [1.0, 1.0, 30.0, 1.0, 1.0, 1.0]  # the coupling of x with z is observed best
    metric = shown.T @ shown

    def cost(x: Array) -> float:
        return float((x - values) @ metric @ (x - values))

    def matrix(x: Array) -> Array:
        made = np.zeros((3, 3))
        for v, (i, j) in zip(x, pairs, strict=True):
            made[i, j] = made[j, i] = v
        return made

    near = find_nearest_semidefinite(values, pairs, metric)
    assert np.linalg.eigvalsh(matrix(near)).min() > -1e-12 * np.abs(near).max()
    w, V = np.linalg.eigh(C)
    plain = (V * np.maximum(w, 0.0)) @ V.T
    assert cost(near) <= cost(np.array([plain[i, j] for i, j in pairs]))
    for _ in range(50):  # no matrix in the neighbourhood is closer
        L = np.linalg.cholesky(matrix(near) + 1e-12 * np.eye(3)) + 1e-6 * rng.normal(size=(3, 3))
        assert cost(np.array([(L @ L.T)[i, j] for i, j in pairs])) > cost(near) * (1 - 1e-6)
    possible = np.array([3e-8, 0.0, 0.0, 2e-8, 0.0, 1e-8])
    np.testing.assert_array_equal(find_nearest_semidefinite(possible, pairs, metric), possible)


@pytest.mark.parametrize("readings", [1.0, 1e10, 1e20, 1e40])
def test_nearest_valid_body_does_not_depend_on_the_scale_of_the_readings(readings: float) -> None:
    """For [[1, 5], [5, 1]] all entries of the result are 7/3; the squared distance exceeded the range of
    floating-point numbers."""
    pairs = ((0, 0), (0, 1), (1, 1))
    near = find_nearest_semidefinite(np.array([1.0, 5.0, 1.0]), pairs, readings * np.eye(3))
    np.testing.assert_allclose(near, 7.0 / 3.0, rtol=1e-8)


def test_unobserved_directions_get_the_minimum_compliance_of_their_coupling() -> None:
    """A tool pulled at its tip shows the shift and its coupled tilt, never a tilt caused by a moment."""
    pairs, metric = ((0, 0), (1, 1), (0, 1)), np.diag([2e15, 3e-18, 2e14])
    shift, both = 4e-7, 6e-6
    for tilt in (0.0, 9e8):  # any tilt fits the readings
        near = find_nearest_semidefinite(np.array([shift, tilt, both]), pairs, metric)
        np.testing.assert_allclose(near[[0, 2]], [shift, both], rtol=1e-6)
        assert near[1] == pytest.approx(both**2 / shift, rel=1e-3)

"""Tilting main bearing: reported at its joint, and not as base, link or backlash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_diagnose_load_test_drift import build_timed_readings
from test_effects import build_posed_problem

from machopt.effects.joint import backlash, nonlinear_stiffness
from machopt.effects.structure import base_compliance
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import joint_torque, sensor_errors, structural_compliance
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import bearing_tilt
from machopt.numerics.array_types import Array


def form(r: StaticReadings, joint: int, law: str, which: int = 0) -> EffectHypothesis:
    """Return bearing hypothesis ``which`` of a joint (1-based) with this law; forms with axes fixed in the preceding
    body come first."""
    return [h for h in bearing_tilt.build_bearing_hypotheses(r) if (h.location, h.law) == (f"joint:{joint}", law)][
        which
    ]


def diagnose_forms(
    r: StaticReadings, moved: Array, *, forms: bool, placed: StaticReadings | None = None
) -> DiagnosisResult:
    known = [*structural_compliance.build_structure_hypotheses(r), *sensor_errors.build_load_test_sensor_hypotheses(r)]
    for j in range(3):
        known += [
            *joint_torque.build_joint_hypotheses(r, j, backlash.EFFECT)[0],
            *joint_torque.build_joint_hypotheses(r, j, nonlinear_stiffness.EFFECT)[0],
        ]
    tried = HypothesisCatalogue(
        tuple(known), uncatalogued_hypotheses=tuple(bearing_tilt.build_bearing_hypotheses(placed or r)) if forms else ()
    )
    return selection_pipeline.diagnose_problem(
        build_posed_problem(r, moved), tried, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )


def compute_tilt_displacement(r: StaticReadings, joint: int, about: Array, play: float = 0.0) -> Array:
    """Return the displacement (N, 6) m, rad of the TCP when the arm rotates rigidly about an axis (N, 3) through a
    joint (0-based).

    Without play the angle is proportional to the moment about the axis, at most 0.1 mrad. With ``play`` (rad, to either
    side) the bearing reaches its end position at a twentieth of the largest moment of the load; the weight that the
    joint carries acts, too.
    """
    state = r.state
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    assert r.masses is not None
    at = state.R_bodies[:, joint] @ r.robot.point[joint] + state.p_bodies[:, joint]
    lever = state.T_base_tool[:, :3, 3] - at

    def moment(wrench: Array) -> Array:
        return np.asarray(np.sum((wrench[:, 3:] + np.cross(lever, wrench[:, :3])) * about, axis=1))

    load, weight = moment(r.wrench), moment(structural_compliance.compute_weight_wrench(r, r.masses.body > joint))
    largest = np.abs(load).max()
    angle = 1e-4 * load / largest
    if play:
        ends = np.clip(np.stack([load + weight, weight]) / (0.05 * largest), -1.0, 1.0)
        angle = play * (ends[0] - ends[1])
    turn = Rotation.from_rotvec(angle[:, None] * about)
    return np.concatenate([turn.apply(lever) - lever, angle[:, None] * about], axis=1)


def compute_transverse_axis(r: StaticReadings, joint: int, way: float) -> Array:
    """Return the axis (N, 3) perpendicular to the axis of a joint (0-based), at angle ``way`` (rad) from the first
    transverse axis in the preceding body."""
    b = bearing_tilt._build_bearing_load(r, joint, joint)
    assert np.abs(np.einsum("nwc,nc->nw", b.across, r.state.J[:, 3:, joint])).max() < 1e-9
    return np.asarray(np.cos(way) * b.across[:, 0] + np.sin(way) * b.across[:, 1])


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_bearing_tilt_columns_equal_a_rigid_rotation_of_the_arm(joint: int) -> None:
    r, _, _ = build_timed_readings()
    for way in (0.4, 2.0):
        true = compute_tilt_displacement(r, joint, compute_transverse_axis(r, joint, way))
        seat = form(r, joint + 1, bearing_tilt.ELASTIC_TILT_LAW).columns(())
        x = np.linalg.lstsq(seat.reshape(-1, 3), true.reshape(-1), rcond=None)[0]
        assert np.abs(seat @ x - true).max() < 1e-3 * np.abs(true).max()
        C = np.array([[x[0], x[1]], [x[1], x[2]]])
        axis = np.array([np.cos(way), np.sin(way)])
        np.testing.assert_allclose(C, np.trace(C) * np.outer(axis, axis), atol=2e-3 * np.trace(C))


def test_bearing_play_closes_under_small_moments_and_hides_under_weight() -> None:
    r, _, _ = build_timed_readings()
    way = float(bearing_tilt.TILT_DIRECTIONS[2])
    true = compute_tilt_displacement(r, 0, compute_transverse_axis(r, 0, way), play=1e-4)
    rocks = form(r, 1, bearing_tilt.BACKLASH_TILT_LAW)
    moment = np.linalg.norm(
        bearing_tilt._project_across_axis(b := bearing_tilt._build_bearing_load(r, 0, 0), b.load), axis=1
    )
    own = np.abs(np.sum(b.load * compute_transverse_axis(r, 0, way), axis=1)).max()
    shares = np.array([s for s, w in rocks.shapes if w == way]) * np.quantile(moment, 0.98) / own
    near = [s for s, w in rocks.shapes if w == way][int(np.argmin(np.abs(shares - 0.05)))]
    given = rocks.columns((near, way))[:, :, 0]
    alike = np.sum(given * true) / (np.linalg.norm(given) * np.linalg.norm(true))
    assert alike > 0.9
    heavy = np.abs(true).max(axis=1) < 1e-12
    assert np.abs(given[heavy]).max(initial=0.0) < 0.5 * np.abs(given).max()


@pytest.mark.parametrize(("joint", "way"), [(0, 0.7), (1, 0.4)])
def test_soft_bearing_is_located_at_its_joint_without_a_name(joint: int, way: float) -> None:
    """Joint 2 tilts about an axis about which the preceding link does not bend in the same way."""
    r, _, _ = build_timed_readings()
    moved = compute_tilt_displacement(r, joint, compute_transverse_axis(r, joint, way))
    # without bearing forms, the nearest law of the catalogue is named
    assert diagnose_forms(r, moved, forms=False).findings
    found = diagnose_forms(r, moved, forms=True)
    assert (found.findings, found.verdict) == ((), "unexplained")
    assert [n for n in found.notes if f"something at joint:{joint + 1} " in n and "across" in n]


def test_loose_bearing_is_found_where_loads_unseat_it() -> None:
    r, _, _ = build_timed_readings()
    found = diagnose_forms(
        r, compute_tilt_displacement(r, 1, compute_transverse_axis(r, 1, 0.7), play=8e-5), forms=True
    )
    assert (found.findings, found.verdict) == ((), "unexplained")
    assert [n for n in found.notes if "something at joint:2 tilts across the axis" in n]
    seated = diagnose_forms(
        r, compute_tilt_displacement(r, 0, compute_transverse_axis(r, 0, 0.7), play=8e-5), forms=True
    )
    assert (seated.findings, seated.verdict) == ((), "consistent")


@pytest.mark.parametrize("height", [None, 0.0])
def test_base_and_backlash_keep_their_names_beside_bearings(height: float | None) -> None:
    """With the origin of joint 1 at that of base_link (height 0), its bearing tilts exactly as a base does."""
    r, _, _ = build_timed_readings()
    point = r.robot.point.copy()
    point[0] = point[0] if height is None else height
    low = replace(r, robot=replace(r.robot, point=point))
    plate = np.zeros((6, 6))  # four bolts at the corners of a square, one of them with 70 % stiffness
    for x, y, soft in ((1, 1, 1 / 0.7), (1, -1, 1), (-1, 1, 1), (-1, -1, 1)):
        give = np.array([0, 0, 1, y * 0.2, -x * 0.2, 0])
        plate += np.outer(give, give) / soft
    sinks = np.ix_((2, 3, 4), (2, 3, 4))
    plate[sinks] = np.linalg.inv(plate[sinks])
    for h in (
        *(h for h in structural_compliance.build_structure_hypotheses(r) if h.effect == "base_compliance"),
        "bolts",
    ):
        if isinstance(h, str):
            law = next(h for h in structural_compliance.build_structure_hypotheses(r) if h.law == "tilts and sinks")
            moved = law.columns(law.shapes[0]) @ np.array([plate[i, j] for i, j in base_compliance.SETTLEMENT_ENTRIES])
        else:
            X = h.columns(h.shapes[0])
            moved = X @ definite(h.law, X.shape[2])
        found = diagnose_forms(r, moved * 1e-4 / np.abs(moved[:, :3]).max(), forms=True, placed=low)
        assert [f.effect for f in found.findings] == ["base_compliance"], h
    play = joint_torque.build_joint_hypotheses(r, 1, backlash.EFFECT)[0][0]
    moved = play.columns(play.shapes[0]).sum(axis=2)
    found = diagnose_forms(r, moved * 1e-4 / np.abs(moved[:, :3]).max(), forms=True, placed=low)
    assert [f.effect for f in found.findings] == [play.effect]


def definite(law: str, numbers: int) -> Array:
    """Return the entries of a positive definite base compliance matrix, with coupling terms if the law has them (SI
    units)."""
    tilt = [1.0, 0.6, 0.9]
    coupled = [0.1, 0.02, -0.02, *tilt] if law == "tilts and sinks" else [0.1, 0.1, 0.1, *tilt]
    return np.array({2: [1.0, 0.6], 3: tilt, 6: coupled}[numbers])

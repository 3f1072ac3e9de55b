"""Inclinometer on a link: equations against an independent simulation, and their benefit in measured poses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from test_diagnose_tcp_poses import SOFTER, arm, measure, poses

from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.errors import InputError
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, EffectHypothesis
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import inclinometer_equations, measured_pose_channel
from machopt.numerics.rigid_transforms import convert_to_rotation_vector, convert_vector_to_rotation

Array = NDArray[np.float64]
LINK = 1
ROCKS = 1e-8  # rad/(N·m), tilt compliance of the base about x and y
LEVEL = np.array([[1e-3, -2e-3], [4e-4, 3e-4], [-5e-4, 1e-4]])  # rad, level error in each session


@cache
def simulate_recording(
    rocks: float = 0.0,
    zero: float = 0.0,
    noise: float = 0.0,
    tilt_noise: float = 0.0,
    link: int = LINK,
    seed: int = 1,
) -> Recording:
    """Simulate joint springs under weight, a base that tilts under the moment of all weight, and an offset ``zero`` of
    joint 2, with finite rotations.

    The inclination is the rotation of the link axes relative to those of an ideal arm at the encoder angles.
    """
    cell, robot, masses = arm()
    assert cell.stiffness is not None
    q, c, T = poses(), SOFTER / cell.stiffness.joints, cell.tool.T_flange_tcp
    theta = q.copy()
    off = np.array([0.0, zero, 0.0, 0.0, 0.0, 0.0])
    for _ in range(12):
        state = robot.compute_state(theta, T, bodies=True)
        theta = q + off + c * compute_gravity_torque(robot, masses, state)[0]
    state, plain = robot.compute_state(theta, T, bodies=True), robot.compute_state(q, T, bodies=True)
    assert state.R_bodies is not None
    assert state.p_bodies is not None
    assert plain.R_bodies is not None
    b = masses.body
    at = np.einsum("nbij,bj->nbi", state.R_bodies[:, b], masses.com) + state.p_bodies[:, b]
    moment = np.cross(at, masses.mass[:, None] * masses.gravity).sum(axis=1)
    Q = convert_vector_to_rotation(rocks * moment * np.array([1.0, 1.0, 0.0]))
    p = np.einsum("nij,nj->ni", Q, state.T_base_tool[:, :3, 3])
    turned = Q @ (state.R_bodies[:, link] @ np.swapaxes(plain.R_bodies[:, link], 1, 2) if link else np.eye(3))
    rng = np.random.default_rng(seed)
    like = measure()
    tilt = convert_to_rotation_vector(np.broadcast_to(turned, (len(q), 3, 3)))[:, :2] + LEVEL[like.session]
    return replace(
        like,
        position=p + noise * rng.normal(size=p.shape),
        tilt=tilt + tilt_noise * rng.normal(size=tilt.shape),
        tilt_link=str(link),
        time=None,
        temperature=None,
    )


def problem_of(recording: Recording) -> tuple[DiagnosisProblem, tuple[EffectHypothesis, ...]]:
    cell, robot, masses = arm()
    problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(
        recording, cell, robot, masses, np.random.default_rng(0)
    )
    return problem, catalogue.hypotheses


def left_over(problem: DiagnosisProblem, more: Array | None = None) -> Array:
    """Return the largest residual of each coordinate (D,) after a least-squares fit of all columns."""
    A = problem.base if more is None else np.concatenate([problem.base, more], axis=2)
    flat = A.reshape(-1, A.shape[2])
    size = np.linalg.norm(flat, axis=0)
    x = np.linalg.lstsq(flat / size, problem.y.reshape(-1), rcond=1e-12)[0] / size
    return np.asarray(np.abs(problem.y - A @ x).max(axis=0))


@pytest.mark.parametrize("link", [0, 2, 3, 6])
def test_intact_arm_shows_springs_and_tilts_only(link: int) -> None:
    problem, _ = problem_of(simulate_recording(link=link))
    assert problem.dimensions == 5
    assert left_over(problem).max() < 1e-9  # m, rad; deflections by weight are up to 1e-2


def test_rocking_base_has_its_law_in_both_channels() -> None:
    problem, offered = problem_of(simulate_recording(rocks=ROCKS))
    law = next(h for h in offered if h.effect == "base_compliance" and h.law == "tilts")
    alone = left_over(problem)
    assert alone[3:].max() > 1e-5
    assert left_over(problem, law.columns(())).max() < 0.1 * alone[3:].max()


def test_bodies_behind_the_link_do_not_tilt_it() -> None:
    _, offered = problem_of(simulate_recording(link=3))
    tilted = {h.name: float(np.abs(h.columns(h.shapes[0])[:, 3:]).max()) for h in offered}
    behind = {("geometry", f"joint:{j}") for j in (4, 5, 6)} | {("link_compliance", f"link:{j}") for j in (4, 5)}
    behind |= {("joint_zero_offset", f"joint:{j}") for j in (4, 5)}
    before = {("geometry", "joint:3"), ("link_compliance", "link:2"), ("joint_zero_offset", "joint:2")}
    assert behind | before <= set(tilted)
    assert all(tilted[name] == 0.0 for name in behind)
    assert all(tilted[name] > 0.0 for name in before)


def test_inclinometer_sharpens_the_base_estimate() -> None:
    """Standard error of the base tilt compliance, with all other unknowns refitted, without and with the two
    inclinometer equations."""
    problem, offered = problem_of(simulate_recording(rocks=ROCKS))
    law = next(h for h in offered if h.effect == "base_compliance" and h.law == "tilts")
    A = np.concatenate([problem.base, law.columns(())], axis=2) / np.array([2e-5] * 3 + [1e-5] * 2)[:, None]
    sigma = []
    for D in (3, 5):
        flat = A[:, :D].reshape(-1, A.shape[2])
        size = np.linalg.norm(flat, axis=0)
        flat, size = flat[:, size > 0], size[size > 0]
        sigma.append(np.sqrt(np.diag(np.linalg.pinv((flat / size).T @ (flat / size))))[-1] / size[-1])
    assert sigma[1] < 0.65 * sigma[0]


@cache
def diagnose_simulated(rocks: float, *, tilts: bool = True, some: bool = False) -> DiagnosisResult:
    recording = simulate_recording(rocks=rocks, noise=3e-5, tilt_noise=1e-5)
    if not tilts:
        recording = replace(recording, tilt=None, tilt_link="")
    if some:
        assert recording.tilt is not None
        recording = replace(recording, tilt=np.where(recording.pose[:, None] % 3 > 0, recording.tilt, np.nan))
    return diagnosis(recording)


def diagnosis(recording: Recording) -> DiagnosisResult:
    cell, robot, masses = arm()
    problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(
        recording, cell, robot, masses, np.random.default_rng(0)
    )
    return selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )


def test_null_case_remains_a_null_case() -> None:
    d = diagnose_simulated(0.0)
    assert d.verdict == "consistent"
    assert not d.findings


@pytest.mark.parametrize("some", [False, True])
def test_rocking_base_is_named_in_its_own_family(some: bool) -> None:
    d = diagnose_simulated(ROCKS, some=some)
    assert [(f.effect, f.location) for f in d.findings] == [("base_compliance", "base")]
    assert d.verdict == "explained"
    output = next(n for n in d.notes if n.startswith("tilt,"))
    before, after, noise = (float(part.split(" mrad")[0].split()[-1]) for part in output.split(", ")[1:])
    assert before > 2.5 * after
    assert after < 1.3 * noise
    assert np.isnan(d.errors.final[:, 3:]).any() == some  # a missing reading is not a residual of zero


def test_inclinometer_alone_separates_a_small_base_tilt_from_its_rivals() -> None:
    with_it, without = diagnose_simulated(0.3 * ROCKS), diagnose_simulated(0.3 * ROCKS, tilts=False)
    assert [f.one_of for f in with_it.findings] == [(("base_compliance", "base"),)]
    assert [len(f.one_of) > 3 for f in without.findings] == [True]


def test_inclinometer_drift_is_reported_and_not_attributed_to_the_arm() -> None:
    recording = simulate_recording(noise=3e-5, tilt_noise=1e-5)
    assert recording.tilt is not None
    strange = 2e-4 * np.sin(7.0 * recording.q[:, [4, 5]])  # repeatable, but no law describes it
    d = diagnosis(replace(recording, tilt=recording.tilt + strange))
    assert not d.findings
    assert d.verdict == "unexplained"


@pytest.mark.parametrize("fault", ["exchanged", "reversed", "axes of the link", "degrees"])
def test_invalid_columns_are_refused(fault: str) -> None:
    _, robot, _ = arm()
    recording = simulate_recording(link=3, noise=3e-5, tilt_noise=1e-5)
    tilt = recording.tilt
    assert tilt is not None
    if fault == "exchanged":
        tilt = tilt[:, ::-1]
    elif fault == "reversed":
        tilt = tilt * [1.0, -1.0]
    elif fault == "degrees":
        tilt = tilt * np.degrees(1.0) / 1e3
    else:
        R = robot.compute_state(recording.q, arm()[0].tool.T_flange_tcp, bodies=True).R_bodies
        assert R is not None
        tilt = np.einsum("nji,nj->ni", R[:, 3], np.column_stack([tilt, np.zeros(len(tilt))]))[:, :2]
    with pytest.raises(InputError, match=fault):
        problem_of(replace(recording, tilt=tilt))


def test_link_is_given_by_name_or_number_and_a_wrong_one_is_refused() -> None:
    cell = arm()[0]
    assert [
        inclinometer_equations.find_inclinometer_link(n, cell)
        for n in ("0", "3", "link:2", cell.base_link, cell.flange_link)
    ] == [
        0,
        3,
        2,
        0,
        6,
    ]
    with pytest.raises(InputError, match="nowhere"):
        inclinometer_equations.find_inclinometer_link("nowhere", cell)

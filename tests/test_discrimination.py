"""Discrimination between rival explanations: search, laws at other poses, command."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from independent_poses_reader import read_poses_csv
from scipy import stats

from machopt.cell.cell_reader import load_cell
from machopt.commands.plan_poses.diagnosis_input import read_diagnosis
from machopt.commands.plan_poses.run import PlanPosesResult, PosesRequest, run_plan_poses
from machopt.data_types.cell import Cell
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.design.load_cases import LoadCases, LoadCriteria, build_load_cases
from machopt.measurement.design.load_methods import build_load_method_combinations
from machopt.measurement.design.maximin_discrimination import (
    ModelContest,
    compute_contest_noncentrality,
    compute_noncentrality_by_pose,
    compute_required_noncentrality,
    compute_total_noncentrality,
    select_maximin_readings,
)
from machopt.measurement.design.measurement_plan import MeasurementPlanSize
from machopt.measurement.design.pose_candidates import PoseScreen, sample_poses
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.diagnosis.discrimination.discrimination_plan import _build_contests, _select_rival_laws
from machopt.measurement.diagnosis.discrimination.open_hypotheses import (
    MAX_HIDDEN_EFFECTS,
    MAX_LOCATIONS,
    MAX_RIVALS,
    NO_EFFECT,
    CandidateLaw,
    OpenDiagnosis,
    RivalLawSet,
)
from machopt.measurement.diagnosis.discrimination.planning_noise import (
    DiscriminationOptions,
    compute_planning_noise,
    select_planning_compliance,
)
from machopt.measurement.diagnosis.discrimination.predicted_signals import (
    DiagnosedArm,
    PredictedCases,
    compute_case_noise,
    predict_law,
    predict_load_tests,
    select_load_steps,
)
from machopt.measurement.diagnosis.discrimination.required_measurements import (
    MOST_POSES,
    combine_required_rounds,
    compute_rounds_to_exclude,
    select_poses_for_exclusion,
)
from machopt.measurement.diagnosis.discrimination.separation_advice import advise_on_separation, format_hypothesis_name
from machopt.stiffness.arm_stiffness import ArmElasticity

CELL = Path(__file__).resolve().parents[1] / "cells" / "kr240_drilling"
COMPLIANCE = 1.0 / np.array([1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 3.80e5])
LINK_3 = CandidateLaw(
    effect="link_compliance", location="link:3", law="bends", coefficients=(6e-8,), shape=(), correction=None
)
LINK_4 = CandidateLaw(
    effect="link_compliance", location="link:4", law="bends", coefficients=(8e-8,), shape=(), correction=None
)
TWIST_4 = CandidateLaw(
    effect="link_compliance", location="link:4", law="twists", coefficients=(2e-7,), shape=(), correction=None
)


def build_small_contests(rng: np.random.Generator) -> tuple[list[ModelContest], np.ndarray, np.ndarray, np.ndarray]:
    """Return six poses with two readings each, and three competing laws."""
    N, R, P = 12, 3, 2
    base = rng.normal(size=(N, R, P))
    laws = [rng.normal(size=(N, R, 1)) for _ in range(3)]
    contests = [
        ModelContest(t, r, np.concatenate([base, laws[r]], axis=2), 3.0 * laws[t][:, :, 0])
        for t, r in product(range(3), repeat=2)
        if t != r
    ]
    return contests, np.broadcast_to(np.eye(R), (N, R, R)), np.zeros((R, R)), np.repeat(np.arange(6), 2)


def test_required_noncentrality_equals_the_textbook_value() -> None:
    # (2.576 + 1.282)²: two-sided 1 %, power 90 %; tables of Pearson & Hartley: 14.88
    assert compute_required_noncentrality() == pytest.approx(14.88, abs=0.005)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_minimum_separation_is_near_the_best_of_all_designs(seed: int) -> None:
    contests, own, shared, pose = build_small_contests(np.random.default_rng(seed))

    def least(blocks: Any) -> float:
        return min(compute_contest_noncentrality(c, own, shared, pose, blocks) for c in contests)

    def blocks_of(chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
        return [(2 * p, 2 * p + 1) for p in chosen]

    best = max(least(blocks_of(chosen)) for chosen in combinations(range(6), 3))
    found = select_maximin_readings(contests, own, shared, pose, 3, 2, np.random.default_rng(0), starts=6)
    assert sorted(len(b) for b in found) == [2, 2, 2]
    # exchanges of single readings may end slightly below the best of all designs
    assert least(found) >= 0.9 * best


def test_noncentrality_equals_the_mean_residual_of_the_rival() -> None:
    rng = np.random.default_rng(7)
    contests, own, shared, _ = build_small_contests(rng)
    pose = np.arange(12)
    c, blocks = contests[0], [(n,) for n in range(12)]
    A, s = c.columns.reshape(36, -1), c.signal.reshape(-1)
    keep = np.eye(36) - A @ np.linalg.pinv(A)
    noisy = s + rng.normal(size=(4000, 36))
    left = np.einsum("ki,ij,kj->k", noisy, keep, noisy).mean() - (36 - A.shape[1])
    expected = compute_contest_noncentrality(c, own, shared, pose, blocks)
    assert left == pytest.approx(expected, abs=4 * np.sqrt((2 * 33 + 4 * expected) / 4000))  # four standard errors
    assert compute_noncentrality_by_pose(c, own, blocks).sum() == pytest.approx(expected, rel=1e-9)
    assert compute_total_noncentrality(c, own)[0] == pytest.approx(expected, rel=1e-9)


def share_excluded(rounds: int, size: float) -> float:
    """Return the share of draws in which diagnose's test excludes the rival; ``size`` of the true law in sigmas."""
    rng, poses, draws = np.random.default_rng(3), 20, 300
    contest, _, _ = build_even_contest(size, poses)
    A, s = contest.columns.reshape(3 * poses, -1), contest.signal.reshape(-1)
    B = np.concatenate([A[:, :2], s[:, None]], axis=1)  # base and the law itself
    hits = 0
    for _ in range(draws):
        y = s + rng.normal(size=len(s)) / np.sqrt(rounds)
        rest = [(y - X @ np.linalg.lstsq(X, y, rcond=None)[0]).reshape(poses, 3) for X in (A, B)]
        d = rounds * (np.sum(rest[0] ** 2, axis=1) - np.sum(rest[1] ** 2, axis=1))
        t = d.mean() / (d.std(ddof=1) / np.sqrt(poses))
        hits += d.sum() >= 9.0 and stats.t.sf(t, poses - 1) <= 0.005
    return hits / draws


def build_even_contest(size: float, poses: int) -> tuple[ModelContest, np.ndarray, tuple[tuple[int, ...], ...]]:
    """Return a law that a rival reproduces for the most part, equally at every pose."""
    rng = np.random.default_rng(2)
    base, rival = rng.normal(size=(poses, 3, 2)), rng.normal(size=(poses, 3, 1))
    signal = size * (3.0 * rival[:, :, 0] + rng.choice([-1.0, 1.0], (poses, 3)))
    contest = ModelContest(0, 1, np.concatenate([base, rival], axis=2), signal)
    return contest, np.broadcast_to(np.eye(3), (poses, 3, 3)), tuple((n,) for n in range(poses))


@pytest.mark.parametrize("size", [0.35, 0.6])
def test_number_of_rounds_agrees_with_a_simulation(size: float) -> None:
    contest, own, blocks = build_even_contest(size, 20)
    rounds = compute_rounds_to_exclude([contest], own, blocks, contest.columns[:, :, :2])
    assert rounds is not None
    assert share_excluded(rounds, size) >= 0.85  # nominal 90 %, estimated from 300 draws
    assert rounds == 1 or share_excluded(max(rounds // 2, 1), size) < 0.85


def test_rival_seen_in_few_poses_is_not_excluded_by_repetition() -> None:
    contest, own, blocks = build_even_contest(1.0, 20)
    alone = contest.signal.copy()
    alone[2:] = 3.0 * contest.columns[2:, :, 2]
    assert compute_rounds_to_exclude([replace(contest, signal=alone)], own, blocks, contest.columns[:, :, :2]) is None
    # a pair that diagnose's test never excludes counts by noncentrality
    assert combine_required_rounds([1, 3], [None, 4]) == 4
    assert combine_required_rounds([None, None], [None, 7]) == 1  # no number of rounds suffices by noncentrality
    assert combine_required_rounds([12], [None]) == 10


def test_plan_has_more_poses_where_the_test_requires_them() -> None:
    contest, own, _ = build_even_contest(0.35, 60)
    base, none = contest.columns[:, :, :2], np.zeros((3, 3))
    size = MeasurementPlanSize(poses=4, loads=1, candidates=60, starts=1)
    found = select_poses_for_exclusion([[contest]], base, own, none, np.arange(60), size, np.random.default_rng(0))
    assert 4 < len(found) <= MOST_POSES
    assert compute_rounds_to_exclude([contest], own, found, base) is not None


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell(CELL)


@pytest.fixture(scope="module")
def tests(cell: Cell) -> tuple[LoadCases, np.ndarray]:
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    limits = cell.limits.lower[:6], cell.limits.upper[:6]
    pool = sample_poses(
        PoseScreen(robot=robot, T_flange_tcp=T, T_world_base=cell.T_world_base, length=1.0, criteria=_no_criteria()),
        limits,
        cell.home,
        40,
        0,
    )
    prior = ArmElasticity(robot, T, ArmStiffness(joints=1.0 / COMPLIANCE))
    ways = build_load_method_combinations((50.0,), (300.0, 1500.0), 3, np.zeros((0, 3)), (0.0,), np.eye(3))
    cases = build_load_cases(pool, ways, prior, (), LoadCriteria(), ReadingNoise(displacement=1e-5))
    return cases, pool.q[cases.pose]


def _no_criteria() -> Any:
    from machopt.measurement.design.pose_candidates import PoseCriteria

    return PoseCriteria()


def open_(*stands: CandidateLaw, pairs: tuple[tuple[int, int], ...] = ((0, 1),)) -> OpenDiagnosis:
    dispute = RivalLawSet("made up", stands, pairs)
    return OpenDiagnosis(
        channel="deflection",
        verdict="explained",
        coordinates=3,
        wrench_frame="base",
        displacement_frame="base",
        registration="fixed",
        scatter=(2e-5, 1e-5),
        turn=None,
        compliance={},
        rival_sets=(dispute,),
        notes=(),
    )


def predict_cases(cell: Cell, cases: LoadCases, q: np.ndarray, steps: tuple[float, ...]) -> PredictedCases:
    robot = load_robot(cell)
    arm = DiagnosedArm(found=open_(), cell=cell, robot=robot, masses=load_masses(cell), compliance=COMPLIANCE)
    return predict_load_tests(arm, cases, q, steps, 3)


def fewer(cases: LoadCases, keep: np.ndarray) -> LoadCases:
    parts = {k: v[keep] for k, v in vars(cases).items() if isinstance(v, np.ndarray)}
    return replace(cases, **parts)


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        ("joint_nonlinear_stiffness", "two slopes"),
        ("joint_nonlinear_stiffness", "three slopes"),
        ("joint_nonlinear_stiffness", "cubic"),
        ("joint_hysteresis", "play"),
        ("joint_hysteresis", "two plays"),
        ("joint_creep", "one time constant"),
        ("joint_pose_dependent_stiffness", "soft sector"),
    ],
)
def test_law_is_the_same_in_other_readings(
    cell: Cell, tests: tuple[LoadCases, np.ndarray], effect: str, law: str
) -> None:
    cases, q = tests
    steps = select_load_steps([CandidateLaw(effect=effect, location="joint:3")])
    # suspended weights: their largest torques differ from those of all loads
    light = np.flatnonzero(cases.magnitude < 600.0)
    few = predict_cases(cell, fewer(cases, light), q[light], steps)
    h = next(h for h in few.hypotheses if h.name == (effect, "joint:3") and h.law == law)
    shape = h.shapes[0]
    x = np.full(h.columns(shape).shape[2], 2e-7)
    made = h.correction(x, shape)
    stand = CandidateLaw(
        effect=effect,
        location="joint:3",
        law=law,
        coefficients=tuple(x),
        shape=shape,
        correction=None if made is None else dict(made.parameters),
    )  # type: ignore[union-attr]
    everywhere = predict_law(stand, predict_cases(cell, cases, q, steps), 1.0)
    alone = predict_law(stand, few, 1.0)
    assert everywhere is not None
    assert alone is not None
    assert np.abs(alone.signal).max() > 1e-6  # the law has an effect
    # the same twist at the same reading; thresholds are transferred with an error of 1e-3
    np.testing.assert_allclose(everywhere.signal[light], alone.signal, atol=2e-3 * np.abs(alone.signal).max())


def test_forearm_twist_equals_joint_4_in_every_experiment(cell: Cell, tests: tuple[LoadCases, np.ndarray]) -> None:
    cases, q = tests
    at = predict_cases(cell, cases, q, (1.0,))
    own, shared = compute_case_noise(cases, ReadingNoise(displacement=1e-5), (1.0,))
    possible, impossible, _ = _build_contests(open_(TWIST_4, NO_EFFECT), at, own + shared, 3)
    assert not possible
    assert "second target" in impossible[0].advice or "larger loads" in impossible[0].advice
    possible, impossible, _ = _build_contests(open_(LINK_3, LINK_4), at, own + shared, 3)
    assert len(possible) == 1
    assert not impossible


def test_plan_noise_comes_from_the_diagnosis_or_the_option() -> None:
    typed = ReadingNoise(displacement=3e-5, targets=0.4)
    requested = DiscriminationOptions(typed, has_stated_noise=False, targets=0.2)
    three, six = open_(), replace(open_(), coordinates=6, turn=1e-4)
    observed = compute_planning_noise(requested, three, 4)
    # the common error of a visit is new in each of the four rounds
    assert observed.shared()[0, 0] ** 0.5 == pytest.approx(0.5e-5)
    assert observed.targets is None
    assert compute_planning_noise(requested, six, 1).targets == pytest.approx(0.2)  # 20 µm and 100 µrad
    assert compute_planning_noise(requested, replace(six, turn=None), 1).targets == requested.targets
    for found in (replace(requested, has_stated_noise=True), requested):
        by = replace(six, scatter=None) if found is requested else six
        assert compute_planning_noise(found, by, 2) == replace(typed, cycles=2)
        assert compute_planning_noise(found, replace(by, coordinates=3), 2).targets is None


def test_experiment_advice_follows_from_the_laws() -> None:
    for one, two, output in (
        ("force_sensor_gain", "link_compliance", "second force sensor"),
        ("displacement_frame", "base_compliance", "register the displacement's axes"),
        ("joint_zero_offset", "geometry", "the same poses without load"),
        ("thermal_drift", "geometry", "the same poses without load"),
        ("link_compliance", "base_compliance", "a second target on the arm between here and there"),
    ):
        assert output in advise_on_separation(
            CandidateLaw(effect=one, location="here"), CandidateLaw(effect=two, location="there")
        )
    assert "larger loads" in advise_on_separation(NO_EFFECT, CandidateLaw(effect="link_compliance", location="link:3"))
    assert format_hypothesis_name(CandidateLaw(effect="", location="link:3")) == "something at link:3"


def test_law_with_only_a_size_moves_the_tool_by_it(cell: Cell, tests: tuple[LoadCases, np.ndarray]) -> None:
    cases, q = tests
    at = predict_cases(cell, cases, q, (1.0,))
    unsized = CandidateLaw(effect="link_compliance", location="link:3")
    assert predict_law(unsized, at, 1.0) is None
    assert predict_law(CandidateLaw(effect="no_such_effect", location="link:3"), at, 1.0) is None
    h = next(h for h in at.hypotheses if h.name == unsized.name)
    one, two = (predict_law(replace(unsized, size=s), at, 1.0) for s in (1.0, 2.0))
    assert one is not None
    assert two is not None
    np.testing.assert_allclose(two.signal, 2.0 * one.signal)
    x, *_ = np.linalg.lstsq(one.columns[0].reshape(-1, one.columns[0].shape[2]), one.signal.reshape(-1), rcond=None)
    assert abs(next(iter(h.quantities(x, h.shapes[len(h.shapes) // 2]).values())).value) == pytest.approx(1.0)
    moved = predict_law(CandidateLaw(effect="", location="link:3", rms=1e-4), at, 1.0)
    assert moved is not None
    assert np.sqrt(np.mean(moved.signal**2)) == pytest.approx(1e-4)
    nothing = predict_law(NO_EFFECT, at, 1.0)
    assert nothing is not None
    assert not nothing.signal.any()
    still = replace(at, hypotheses=tuple(replace(h, columns=lambda s, h=h: 0.0 * h.columns(s)) for h in at.hypotheses))
    assert predict_law(replace(unsized, size=1.0), still, 1.0) is None  # no effect in these poses


def test_only_the_nearest_of_many_laws_are_separated(cell: Cell, tests: tuple[LoadCases, np.ndarray]) -> None:
    cases, q = tests
    at = predict_cases(cell, cases, q, (1.0,))
    own, shared = compute_case_noise(cases, ReadingNoise(displacement=1e-5), (1.0,))
    names = list(dict.fromkeys(h.name for h in at.hypotheses))[: MAX_RIVALS + 2]
    assert len(names) == MAX_RIVALS + 2
    gone = CandidateLaw(effect="link_compliance", location="link:9", law="bends", coefficients=(1e-8,))
    known = []
    for effect, where in names:
        h = next(h for h in at.hypotheses if h.name == (effect, where))
        shape = h.shapes[0]
        known.append(
            CandidateLaw(
                effect=effect,
                location=where,
                law=h.law,
                coefficients=tuple(np.full(h.columns(shape).shape[2], 1e-9)),
                shape=shape,
            )
        )
    notes: list[str] = []
    laws, _ = _select_rival_laws(RivalLawSet("many", (*known, gone), ()), at, own + shared, 1.0, notes)
    assert len(laws) == MAX_RIVALS
    assert sum("at most" in n for n in notes) == 2
    assert any("cannot be predicted at these poses" in n for n in notes)
    sized = tuple(CandidateLaw(effect=e, location=w, size=1.0) for e, w in names)
    laws, _ = _select_rival_laws(RivalLawSet("hidden", (NO_EFFECT, *sized), ()), at, own + shared, 1.0, notes)
    assert len(laws) == min(MAX_HIDDEN_EFFECTS, len(sized)) + 1
    places = tuple(
        CandidateLaw(effect="", location=w, rms=1e-4) for w in ("link:1", "link:2", "link:3", "link:4", "base", "tool")
    )
    laws, _ = _select_rival_laws(RivalLawSet("places", places, ()), at, own + shared, 1.0, notes)
    assert len(laws) == MAX_LOCATIONS


def diagnosis(folder: Path, findings: list[dict[str, Any]], **changes: Any) -> Path:
    folder.mkdir(parents=True)
    data = {
        "machopt_diagnosis": 1,
        "verdict": "explained",
        "channel": "deflection",
        "rmse_unit": "mm",
        "baseline": {
            "heldout_rmse": 0.06,
            "noise_floor": 0.02,
            "measured_noise": 0.02,
            "repeatable_rmse": 0.05,
            "p_value": 0.01,
        },
        "final": {"rmse": 0.02, "heldout_rmse": 0.02, "explained_share": 0.9, "repeatable_rmse": None},
        "version": "1",
        "cell": "c",
        "recording": "r",
        "sentence": "",
        "predicted": "load tests",
        "unnamed_corrections": [],
        "not_testable": [],
        "model": None,
        "kinematics": None,
        "readings": 60,
        "outliers": None,
        "proof": None,
        "tried": 9,
        "notes": [],
        "warnings": [],
        "effect_on_job": None,
        "options": {},
        "inputs": {},
        "findings": findings,
        "mismatch": [],
        "detection_limits": [],
        "next_experiment": "measure again",
        "coefficients": [
            {
                "name": f"joint {j + 1}",
                "location": f"joint:{j + 1}",
                "unit": "rad/(N·m)",
                "before": None,
                "value": float(c),
                "sigma": 0.01 * float(c),
                "key": asdict(build_joint_spring_key(j + 1)),
            }
            for j, c in enumerate(COMPLIANCE)
        ],
        "recorded": {
            "kind": "deflection",
            "coordinates": 3,
            "wrench_frame": "base",
            "displacement_frame": "base",
            "registration": "fixed",
            "scatter_m": {"own": 1.7e-5, "visit": 1e-5},
        },
    } | changes
    (folder / "diagnosis.json").write_text(json.dumps(data))
    return folder


def finding(own: CandidateLaw, *rivals: CandidateLaw, open_too: bool = True) -> dict[str, Any]:
    def as_fitted(s: CandidateLaw) -> dict[str, Any]:
        fit = {"coefficients": list(s.coefficients), "shape": list(s.shape), "correction": None}
        return {"effect": s.effect, "location": s.location, "law": s.law, "fit": fit}

    names = [list(s.name) for s in (own, *(rivals if open_too else ()))]
    rest = {"closed_share": 0.9, "standing": "not excluded", "p_value": 0.3, "placebo": False}
    message = {
        "parameters": {},
        "heldout_rmse_before": 0.06,
        "heldout_rmse_after": 0.02,
        "p_value": 0.001,
        "equation": "",
        "note": "",
        "of_the_record": False,
        "correction": None,
    }
    return as_fitted(own) | message | {"one_of": names, "rivals": [as_fitted(r) | rest for r in rivals]}


def test_open_rivals_are_read_from_the_diagnosis(tmp_path: Path) -> None:
    sets = read_diagnosis(diagnosis(tmp_path / "a", [finding(LINK_4, LINK_3, TWIST_4)]))
    assert sets.rival_sets[0].pairs == ((0, 1), (0, 2), (1, 2))
    assert sets.scatter == (1.7e-5, 1e-5)
    alone = read_diagnosis(diagnosis(tmp_path / "b", [finding(LINK_4, LINK_3, open_too=False)]))
    assert alone.rival_sets[0].candidate_laws == (LINK_4, LINK_3, NO_EFFECT)
    limit = {
        "effect": "joint_backlash",
        "location": "joint:2",
        "value": 0.2,
        "unit": "arcmin",
        "standing": "testable",
        "one_of": [],
    }
    quiet = read_diagnosis(diagnosis(tmp_path / "c", [], verdict="consistent", detection_limits=[limit]))
    assert quiet.rival_sets[0].candidate_laws == (
        NO_EFFECT,
        CandidateLaw(effect="joint_backlash", location="joint:2", size=0.2),
    )
    share = [{"axis": a, "share": s, "note": "", "kind": "machine"} for a, s in (("link:2", 0.2), ("joint:3", 0.7))]
    lost = read_diagnosis(diagnosis(tmp_path / "d", [], verdict="unexplained", mismatch=share))
    assert [s.location for s in lost.rival_sets[0].candidate_laws] == ["joint:3", "link:2"]
    assert lost.rival_sets[0].candidate_laws[0].rms == pytest.approx(5e-5)


def test_unobserved_spring_comes_from_the_cell(tmp_path: Path) -> None:
    folder = diagnosis(tmp_path / "a", [finding(LINK_4, LINK_3, TWIST_4)])
    data = json.loads((folder / "diagnosis.json").read_text())
    data["coefficients"][2] |= {"value": -5e-8, "sigma": 5e-8}  # a negative compliance is impossible
    data["coefficients"][5] |= {"value": 4e-7, "sigma": 3e-7}
    (folder / "diagnosis.json").write_text(json.dumps(data))
    found = read_diagnosis(folder)
    assert set(found.compliance) == {1, 2, 4, 5}
    stiffness = np.full(6, 2e6)
    assert select_planning_compliance(found, stiffness)[[2, 5]] == pytest.approx(5e-7)
    assert select_planning_compliance(found, stiffness)[0] == pytest.approx(COMPLIANCE[0])


def test_unplannable_rivals_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="diagnosis of a motion"):
        read_diagnosis(diagnosis(tmp_path / "m", [], channel="torque"))
    with pytest.raises(InputError, match="machopt diagnose wrote"):
        read_diagnosis(tmp_path / "nowhere")
    old = diagnosis(tmp_path / "old", [])
    data = json.loads((old / "diagnosis.json").read_text())
    del data["recorded"]
    (old / "diagnosis.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match="fresh machopt diagnose"):
        read_diagnosis(old)
    with pytest.raises(InputError, match="no explanations"):
        run_plan_poses(
            PosesRequest(
                cell=CELL, out=tmp_path / "out", discriminate=diagnosis(tmp_path / "n", [], verdict="consistent")
            )
        )


def plan(folder: Path, *stands: CandidateLaw) -> PlanPosesResult:
    found = diagnosis(folder / "diagnosis", [finding(*stands)])
    request = PosesRequest(
        cell=CELL,
        out=folder / "out",
        discriminate=found,
        candidates=200,
        poses=6,
        cycles=1,
        starts=1,
        weights_kg=(50.0, 100.0),
        pull_N=(500.0, 1000.0),
        max_load_N=2000.0,
        no_collision=True,
    )
    return run_plan_poses(request)


@pytest.mark.proof
def test_command_plans_the_separation_of_two_links(tmp_path: Path) -> None:
    done = plan(tmp_path, LINK_4, LINK_3)
    folder = done.report.parent
    assert sorted(p.name for p in folder.iterdir()) == [
        "manifest.json",
        "plan.json",
        "poses.csv",
        "recording_template",
        "report.html",
    ]
    message = json.loads((folder / "plan.json").read_text())["discriminate"]
    (pair,) = message["pairs"]
    assert {pair["one"]["location"], pair["two"]["location"]} == {"link:3", "link:4"}
    assert pair["told_apart"]
    assert pair["noncentrality_planned"] >= message["noncentrality_needed"]
    # otherwise the search has no benefit
    assert pair["noncentrality_per_cycle"] > 2.0 * pair["random_noncentrality_per_cycle"]
    assert message["cycles"] >= pair["cycles_for_power"]
    table = read_poses_csv(folder / "poses.csv")
    # by diagnose's own test, which six poses do not pass
    assert pair["cycles_until_diagnose_excludes"] <= message["cycles"]
    assert 6 < len(np.unique(table.pose)) <= MOST_POSES
    assert "Explanations it separates" in (folder / "report.html").read_text()
    assert "1 of 1 pairs" in done.message


def test_load_cycles_have_steps_where_a_law_has_memory(tmp_path: Path) -> None:
    play = CandidateLaw(
        effect="joint_hysteresis", location="joint:3", law="play", coefficients=(1.5e-7,), shape=(0.3, 0.0)
    )
    late = CandidateLaw(
        effect="joint_creep", location="joint:3", law="one time constant", coefficients=(1.5e-7,), shape=(20.0, 0.0)
    )
    done = plan(tmp_path, play, late)
    folder = done.report.parent
    message = done.result.to_json_types()["discriminate"]
    assert isinstance(message, dict)
    assert message["steps"] == [0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]
    table = read_poses_csv(folder / "poses.csv")
    first = np.linalg.norm(table.wrench[:8, :3], axis=1)
    np.testing.assert_allclose(first, first[3] * np.array(message["steps"]), atol=1e-3)  # N, with the printed digits
    with (folder / "recording_template" / "data.csv").open(encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    assert [r["branch"] for r in rows[:8]] == ["load"] * 4 + ["unload"] * 4
    assert float(rows[1]["time_s"]) - float(rows[0]["time_s"]) == pytest.approx(10.0)


def test_measured_poses_are_planned_too(tmp_path: Path) -> None:
    zero = CandidateLaw(effect="joint_zero_offset", location="joint:2", law="constant angle", coefficients=(5e-5,))
    heavy = CandidateLaw(
        effect="payload", location="tool", law="another mass at the stated centre", coefficients=(12.0,)
    )
    recorded = {
        "kind": "absolute",
        "coordinates": 3,
        "wrench_frame": "base",
        "displacement_frame": "base",
        "registration": "fit",
        "scatter_m": {"own": 3e-5, "visit": 0.0},
    }
    found = diagnosis(tmp_path / "d", [finding(zero, heavy)], channel="position", recorded=recorded)
    request = PosesRequest(
        cell=CELL,
        out=tmp_path / "out",
        discriminate=found,
        candidates=200,
        poses=8,
        starts=1,
        weights_kg=(80.0,),
        no_collision=True,
    )
    message = run_plan_poses(request).result.to_json_types()["discriminate"]
    assert isinstance(message, dict)
    (pair,) = message["pairs"]
    assert pair["noncentrality_per_cycle"] > pair["random_noncentrality_per_cycle"] > 0.0
    assert {"no load"} & set(read_poses_csv(tmp_path / "out" / "poses.csv").load)

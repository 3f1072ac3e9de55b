"""Large effects: location certain although the law is approximate; their readings are not outliers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose_multiple_effects import SIGMA, N, build_hypothesis, model

from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    HypothesisCatalogue,
)
from machopt.measurement.diagnosis.model_selection.attribution import place_certainty
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search import extended_search, search_stages
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_whitened_model
from machopt.measurement.diagnosis.statistics.outlier_rejection import find_repeated_deviations
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.numerics.array_types import Array


def certainty(alike: float, rest: float, seed: int) -> bool:
    """Return whether joint 1 is certain: its law contributes 200 σ, a random residual has ``rest`` times that size,
    and the law of joint 3 has the correlation ``alike``."""
    base, _ = model({}, seed)
    rng = np.random.default_rng([seed, 1])
    own, other, left = rng.normal(size=(3, N, 3, 1))
    near = alike * own + np.sqrt(1.0 - alike**2) * other
    laws = [
        build_hypothesis("joint_backlash", "joint:1", lambda s: own, ((),), "joint"),
        build_hypothesis("joint_backlash", "joint:3", lambda s: near, ((),), "joint"),
    ]
    signal = 200.0 * SIGMA * (own + rest * left)[:, :, 0]
    changed = build_whitened_model(base.w, base.X, base.y + base.w.whiten(signal), base.fold, base.prior, base.rows)
    tried = whiten_hypotheses(changed, laws)
    state = SimpleNamespace(
        base=changed,
        noise=SimpleNamespace(replicated=True),
        whitened_hypotheses=tuple(tried),
        catalogue=SimpleNamespace(uncatalogued_hypotheses=()),
    )
    chosen = [SelectedEffect(score_hypotheses(changed, tried[:1])[0], 0.002)]
    return place_certainty.is_place_certain(state, chosen, 0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("alike", "rest", "expected"),
    [
        (0.3, 0.4, True),  # the law leaves a residual of 80 σ that no other location explains
        (0.9, 0.4, False),  # another location explains three quarters of the signal
        (0.3, 0.9, False),  # nearly half of the mismatch remains
    ],
)
def test_place_is_certain_where_it_explains_most_and_no_other_fits(alike: float, rest: float, expected: bool) -> None:
    assert certainty(alike, rest, 31) is expected


def build_repeated_stays(by_cycle: bool) -> DiagnosisProblem:
    """Build six poses with two load cycles each and eight readings in each cycle."""
    n = np.arange(96)
    pose, cycle = n // 16, n // 8
    return DiagnosisProblem(
        channel="deflection",
        y=np.zeros((96, 3)),
        base=np.zeros((96, 3, 1)),
        unknowns=(BaseUnknown(name="a", unit="m"),),
        families=(CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),),
        group=pose,
        visit=pose,
        cycle=cycle,
        session=np.zeros(96, np.int64),
        replicate=pose * 8 + n % 8,
        line=n,
        row=n,
        repeat=cycle if by_cycle else None,
    )


def test_deviations_repeated_in_the_next_cycle_are_no_outliers() -> None:
    residual = np.zeros((96, 3))
    off = np.zeros(96, bool)
    off[[3, 11]] = True  # the same load in both cycles
    off[40] = True  # in one cycle only
    residual[[3, 11, 40], 0] = 1e-3
    found = find_repeated_deviations(build_repeated_stays(True), residual, off)
    assert found.nonzero()[0].tolist() == [3, 11]
    assert not find_repeated_deviations(build_repeated_stays(False), residual, off).any()


def test_no_offset_is_selected_where_a_body_law_leaves_as_much() -> None:
    """A compliant body of 100 σ whose law has a 10 % error along the direction of a zero offset."""
    base, _ = model({}, 41)
    rng = np.random.default_rng(42)
    body, zero = rng.normal(size=(2, N, 3, 1))

    def made_of(size: float) -> Array:
        return np.asarray(100.0 * SIGMA * (body + size * zero)[:, :, 0])

    laws = [
        build_hypothesis("link_compliance", "link:2", lambda s: body, ((),), "body"),
        replace(build_hypothesis("joint_zero_offset", "joint:2", lambda s: zero, ((),), "kinematic"), is_exact=True),
        build_hypothesis("geometry", "joint:4", lambda s: rng.normal(size=(N, 3, 3)), ((),), "kinematic"),
    ]
    for size, expected in ((0.1, {"link:2"}), (0.6, {"link:2", "joint:2"})):
        y = base.y + base.w.whiten(made_of(size))
        changed = build_whitened_model(base.w, base.X, y, base.fold, base.prior, base.rows)
        _, chosen = search_stages.search_effects(
            changed, whiten_hypotheses(changed, laws), 3, np.random.default_rng(0), 1.0
        )
        assert {c.whitened.hypothesis.location for c in chosen} == expected


def test_better_joint_selection_of_the_second_search_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second search has additional laws when it sums waves; its result was discarded."""
    base, laws = model({("transmission_error", "joint:2"): (2.0,)}, 51)
    wave = next(t for t in laws if t.hypothesis.name == ("transmission_error", "joint:2"))
    good = SelectedEffect(score_hypotheses(base, [wave])[0], 0.002)
    more = next(t.hypothesis for t in laws if t.hypothesis.name == ("geometry", "joint:5"))
    monkeypatch.setattr(search_stages, "search_effects", lambda *_: (tuple(laws), (good,)))
    problem = extended_search.ExtensionProblem(
        base=base,
        catalogue=HypothesisCatalogue(()),
        most=3,
        seed=0,
        noise_variance=1.0,
    )
    found = extended_search._search_again(problem, [more], (tuple(laws), ()), np.random.default_rng(0))
    assert found[1] == (good,)
    retained = extended_search._search_again(problem, [more], (tuple(laws), (good,)), np.random.default_rng(0))
    assert retained[1] == (good,)

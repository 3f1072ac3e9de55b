"""Effects hidden by a larger one are found in addition to the fitted law deviation of the larger one."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnose_multiple_effects import SIGMA, N, build_hypothesis, model

from machopt.measurement.diagnosis.model_selection.search import search_stages
from machopt.measurement.diagnosis.model_selection.search.selected_effect import (
    SelectedEffect,
    add_selected_effects,
    is_law_deviation,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, build_whitened_model
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses

LARGE = 200.0  # σ of the largest effect


def search(
    bent: float, tool: float, unknown: float, fits: float = 1.0, alike: float = 0.0
) -> tuple[WhitenedModel, tuple[SelectedEffect, ...]]:
    """Search with joint 1 deviating from its law by ``bent`` times its effect, a tool effect of ``tool`` σ and an
    unknown effect of ``unknown`` σ."""
    base, _ = model({}, 61)
    own, left, body, none = np.random.default_rng(62).normal(size=(4, N, 3, 1))
    left = alike * own + np.sqrt(1.0 - alike**2) * left
    laws = [
        build_hypothesis("joint_backlash", "joint:1", lambda s: own, ((),), "joint"),
        build_hypothesis("joint_nonlinear_stiffness", "joint:1", lambda s: left, ((),), "joint"),
        build_hypothesis("tool_compliance", "tool", lambda s: body, ((),), "body"),
    ]
    signal = SIGMA * (LARGE * (own + bent * left) + tool * body + unknown * none)[:, :, 0]
    changed = build_whitened_model(base.w, base.X, base.y + base.w.whiten(signal), base.fold, base.prior, base.rows)
    tried = whiten_hypotheses(changed, laws)
    return changed, search_stages.search_effects(changed, tried, 6, np.random.default_rng(0), fits)[1]


@pytest.mark.parametrize(
    ("bent", "tool", "unknown", "fits", "named", "deviates"),
    [
        # 1 % of the gain of joint 1: below its law uncertainty of 6 %
        (0.1, 20.0, 0.0, 1.0, {"joint:1", "tool"}, True),
        # the law of joint 1 is exact, as the zero coefficient of the other law there shows
        (0.0, 20.0, 0.0, 1.0, {"joint:1", "tool"}, False),
        (0.1, 0.0, 0.0, 1.0, {"joint:1"}, False),  # no hidden effect
        (0.1, 20.0, 40.0, 1.0, {"joint:1"}, False),  # no law describes most of the residual
        (0.1, 20.0, 0.0, np.nan, {"joint:1"}, False),  # no replicates, so the noise is unknown
    ],
)
def test_effect_is_found_beside_the_law_deviation_of_a_larger_one(
    bent: float, tool: float, unknown: float, fits: float, named: set[str], deviates: bool
) -> None:
    _, chosen = search(bent, tool, unknown, fits)
    assert {c.whitened.hypothesis.location for c in chosen if not is_law_deviation(c)} == named
    assert [c.whitened.hypothesis.location for c in chosen if is_law_deviation(c)] == ["joint:1"] * deviates
    assert all(c.whitened.hypothesis.is_in_catalogue is not is_law_deviation(c) for c in chosen)


def test_larger_effect_keeps_its_size_beside_its_deviation() -> None:
    changed, chosen = search(0.1, 20.0, 0.0, alike=0.6)
    place = {c.whitened.hypothesis.effect: k for k, c in enumerate(chosen)}
    assert any(is_law_deviation(c) for c in chosen)
    sizes = []
    for some in (chosen, [c for c in chosen if not is_law_deviation(c)]):
        c = some[[o.whitened.hypothesis.effect for o in some].index("joint_backlash")]
        at = changed.count + sum(len(o.scored.x) for o in some[: list(some).index(c)])
        sizes.append(float(add_selected_effects(changed, some).coefficients[at] * c.whitened.unit[0, 0]))
    assert place["joint_backlash"] == 0
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-3)

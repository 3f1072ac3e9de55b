"""Joint search of many effects on synthetic equations: finds the simulated effects, and none in noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    Quantity,
)
from machopt.measurement.diagnosis.model_selection.attribution import uncatalogued_form_guard
from machopt.measurement.diagnosis.model_selection.screening import normal_equation_sums
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import (
    fit_hypotheses,
    score_hypotheses,
)
from machopt.measurement.diagnosis.model_selection.search import (
    description_length,
    search_stages,
    sparse_effect_selection,
)
from machopt.measurement.diagnosis.model_selection.search.forward_selection import prune_joint_effects, select_effects
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics import fold_rows, whitened_hypothesis
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, build_base_model
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import build_whitened_model as grams_model
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis, whiten_hypotheses
from machopt.measurement.diagnosis.statistics.whitening import build_whitening
from machopt.numerics.array_types import Array

POSES, VISITS, ORDERS, SIGMA = 90, 2, tuple((float(n),) for n in range(1, 7)), 1e-5
N = POSES * VISITS
Planted = dict[tuple[str, str], tuple[float, ...]]
MANY: Planted = {
    ("transmission_error", "joint:1"): (3.0,),
    ("transmission_error", "joint:2"): (2.0, 5.0),
    ("transmission_error", "joint:4"): (1.0,),
    ("transmission_error", "joint:6"): (4.0,),
    ("geometry", "joint:3"): (),
    ("geometry", "joint:5"): (),
    ("payload", "tool"): (),
}


def repeat_for_visits(columns: Array) -> Array:
    """Repeat the columns at every visit of a pose."""
    return np.tile(columns, (VISITS, 1, 1))


def hypotheses(rng: np.random.Generator) -> list[EffectHypothesis]:
    q, lever = rng.uniform(-2.5, 2.5, (POSES, 6)), rng.normal(size=(POSES, 3, 6))
    frames = rng.normal(size=(6, POSES, 3, 3))
    mass = rng.normal(size=(POSES, 3, 2))

    def waves(j: int) -> EffectHypothesis:
        def columns(shape: tuple[float, ...]) -> Array:
            parts = [f(n * q[:, None, j]) * lever[:, :, j] for n in shape for f in (np.cos, np.sin)]
            return repeat_for_visits(np.stack(parts, axis=2))

        return replace(
            build_hypothesis("transmission_error", f"joint:{j + 1}", columns, ORDERS, "kinematic"), sum_name="waves"
        )

    found = [waves(j) for j in range(6)]
    found += [
        build_hypothesis("geometry", f"joint:{j + 1}", lambda s, j=j: repeat_for_visits(frames[j]), ((),), "kinematic")
        for j in range(6)
    ]
    return [*found, build_hypothesis("payload", "tool", lambda s: repeat_for_visits(mass), ((),), "body")]


def build_hypothesis(
    effect: str, where: str, columns: object, shapes: tuple[tuple[float, ...], ...], family: str
) -> EffectHypothesis:
    def size(x: Array, shape: tuple[float, ...]) -> dict[str, Quantity]:
        return {"size": Quantity(float(np.linalg.norm(x)), "m")}

    return EffectHypothesis(
        effect=effect,
        location=where,
        law="made up",
        equation="",
        columns=columns,
        quantities=size,
        shapes=shapes,
        family=family,
    )  # type: ignore[arg-type]


def model(planted: Planted, seed: int, size: float = 4.0) -> tuple[WhitenedModel, list[WhitenedHypothesis]]:
    """Build two base unknowns and 540 coordinates; each column of a simulated effect has ``size`` times the noise."""
    rng = np.random.default_rng(seed)
    laws = hypotheses(rng)
    base = repeat_for_visits(rng.normal(size=(POSES, 3, 2)))
    y = SIGMA * rng.normal(size=(N, 3)) + base @ np.array([1e-4, -2e-4])
    for h in laws:
        if h.name in planted:
            columns = h.columns(planted[h.name])
            y = y + columns @ (size * SIGMA * rng.choice([-1.0, 1.0], columns.shape[2]))
    pose, visit = np.tile(np.arange(POSES), VISITS), np.arange(N)
    problem = DiagnosisProblem(
        channel="position",
        y=y,
        base=base,
        unknowns=(BaseUnknown(name="a", unit="m"), BaseUnknown(name="b", unit="m")),
        families=(CoordinateFamily(name="translation", columns=(0, 1, 2), unit="mm", factor=1e3),),
        group=pose,
        visit=visit,
        cycle=visit,
        session=np.repeat(np.arange(VISITS), POSES),
        replicate=pose,
        line=visit + 2,
        row=visit + 1,
    )
    w = build_whitening(
        problem, ReplicateNoise(np.array([SIGMA]), np.zeros(1), np.zeros(1), 0.0, True), np.ones(N, bool)
    )
    found, _ = build_base_model(problem, w, np.random.default_rng(0))
    return found, whiten_hypotheses(found, laws)


def test_exactly_the_planted_effects_are_found() -> None:
    base, laws = model(MANY, 1)
    among, found = search_stages.search_effects(base, laws, 3, np.random.default_rng(0), 1.0)
    assert {c.whitened.hypothesis.name for c in found} == set(MANY)
    for c in found:
        assert tuple(sorted(c.whitened.shapes[c.scored.shape])) == MANY[c.whitened.hypothesis.name]
    assert {t.hypothesis.name for t in among} == {t.hypothesis.name for t in laws}  # alternatives remain


def test_requested_limit_of_effects_is_respected() -> None:
    base, laws = model(MANY, 1)
    assert len(search_stages.search_effects(base, laws, 2, np.random.default_rng(0), 1.0)[1]) == 2


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_noise_and_few_effects_are_left_to_the_stepwise_search(seed: int) -> None:
    base, laws = model({}, seed)
    assert sparse_effect_selection.select_many_effects(base, laws, 1.0) == []
    few = dict(list(MANY.items())[:3])
    assert sparse_effect_selection.select_many_effects(*model(few, seed), 1.0) == []


def test_other_channels_and_small_recordings_are_not_searched() -> None:
    base, laws = model(MANY, 1)
    assert (
        sparse_effect_selection.select_many_effects(base, [t for t in laws if t.hypothesis.effect != "geometry"], 1.0)
        == []
    )
    wide = np.tile(base.X, (1, 10))  # 540 coordinates, 20 unknowns
    assert sparse_effect_selection.select_many_effects(base.with_columns(wide), laws, 1.0) == []


def test_sums_equal_explicit_refits() -> None:
    base, laws = model(MANY, 2)
    found = normal_equation_sums.CachedSums(base, laws).sum_all
    taken, more = found.groups[3], found.groups[10]
    X = np.concatenate([base.X, taken.law.columns_at(taken.shape)], axis=1)
    columns = [*range(found.base), *range(taken.columns.start, taken.columns.stop)]
    whole = np.concatenate([X, more.law.columns_at(more.shape)], axis=1)
    left = [float(np.sum((base.y - A @ np.linalg.lstsq(A, base.y, rcond=None)[0]) ** 2)) for A in (X, whole)]
    left_over = normal_equation_sums.eliminate_columns(found.total, np.array(columns))
    assert left_over[-1, -1] == pytest.approx(left[0], rel=1e-6)
    assert normal_equation_sums.compute_group_gains(left_over, found)[10] == pytest.approx(left[0] - left[1], rel=1e-6)
    unseen = 0.0
    for some in np.array_split(np.arange(base.folds), normal_equation_sums.FOLDS):
        out = np.zeros(len(base.y), bool)
        out[np.concatenate([base.rows[f] for f in some])] = True
        unseen += float(np.sum((base.y[out] - X[out] @ np.linalg.lstsq(X[~out], base.y[~out], rcond=None)[0]) ** 2))
    assert sparse_effect_selection._compute_holdout_squares(found, columns) == pytest.approx(unseen, rel=1e-6)


def test_sums_beside_laws_equal_explicit_products() -> None:
    base, laws = model(MANY, 2)
    first = [(next(t for t in laws if t.hypothesis.name == ("payload", "tool")), 0), (laws[0], len(laws[0].shapes) - 1)]
    found = normal_equation_sums.CachedSums(base, laws).select_groups(
        first, lambda t: t.hypothesis.effect == "geometry"
    )
    assert {g.law.hypothesis.effect for g in found.groups[2:]} == {"geometry"}
    assert [(g.law, g.shape) for g in found.groups[:2]] == first
    A = np.zeros((len(base.y), len(found.total)))
    A[:, : found.base], A[:, -1] = base.X, base.y
    known = np.zeros(len(found.total))
    known[: found.base] = base.prior
    for g in found.groups:
        A[:, g.columns], known[g.columns] = g.law.columns_at(g.shape), g.law.precision(g.shape)
    np.testing.assert_allclose(found.total, A.T @ A + np.diag(known), rtol=1e-9, atol=1e-8)


def test_written_result_is_the_fit_of_the_whole_sum() -> None:
    """Two frames whose columns differ by 0.7 %, 5e-5 in the squares: the difference must not be lost."""
    base, laws = model(MANY, 3)
    one, other = (next(t for t in laws if t.hypothesis.name == ("geometry", f"joint:{j}")) for j in (3, 5))
    columns = one.hypothesis.columns(())
    twin = replace(other.hypothesis, columns=lambda s: columns + 7e-3 * other.hypothesis.columns(()))
    found = prune_joint_effects(base, whiten_hypotheses(base, [one.hypothesis, twin]), laws, np.random.default_rng(0))
    assert len(found) == 2
    whole = add_selected_effects(base, found)
    rest = base.y - sum(c.columns @ c.scored.x for c in found)
    x = np.linalg.lstsq(base.X, rest, rcond=None)[0]
    assert float(np.sum((rest - base.X @ x) ** 2)) == pytest.approx(whole.rss, rel=1e-4)


def test_gains_beside_few_columns_need_no_products_between_groups() -> None:
    """The gains equal those after elimination of the columns from all others, also for absorbed columns."""
    base, laws = model(MANY, 2)
    sums = normal_equation_sums.CachedSums(base, laws).sum_all
    for some in (sums.groups[:0], sums.groups[:1], (sums.groups[3], sums.groups[-1])):
        columns = np.array([c for g in some for c in range(g.columns.start, g.columns.stop)], np.int64)
        whole = normal_equation_sums.eliminate_columns(sums.total, np.array([*range(sums.base), *columns]))
        gains = normal_equation_sums.compute_group_gains(whole, sums)
        assert gains.max() > 0.0
        np.testing.assert_allclose(
            normal_equation_sums.compute_gains_beside(sums, columns), gains, rtol=1e-6, atol=1e-9 * gains.max()
        )


def test_laws_of_weight_without_a_clear_gain_are_not_leading() -> None:
    """As many weight laws as one step considers, each with a small correlation with the signal: 1.2 times the gain
    of the best frame."""
    base, laws = model(MANY, 1)
    among = [t for t in laws if t.hypothesis.family == "kinematic"]
    plain = normal_equation_sums.CachedSums(base, among).sum_all
    additional = normal_equation_sums.eliminate_columns(plain.total, np.arange(plain.base))  # type: ignore[arg-type]  # numbers
    share = 1.2 * normal_equation_sums.compute_group_gains(additional, plain).max() / additional[-1, -1]
    rng, signal = np.random.default_rng(5), base.residual
    crowd = []
    for k in range(sparse_effect_selection.LEADING_GROUPS):
        other = rng.normal(size=len(signal))
        other -= signal * (other @ signal) / (signal @ signal)
        other *= np.linalg.norm(signal) / np.linalg.norm(other) * np.sqrt(1.0 / share - 1.0)
        column = np.zeros((N, 3, 1))
        column[base.w.index, :, 0] = (signal + other).reshape(-1, 3)
        crowd.append(build_hypothesis("base_compliance", f"base:{k}", lambda s, c=column: c, ((),), "body"))
    whole = normal_equation_sums.CachedSums(
        base, whiten_hypotheses(base, [*(t.hypothesis for t in among), *crowd])
    ).sum_all
    found = {g.law.hypothesis.name for g in sparse_effect_selection._select_groups_greedily(whole, 1.0)}
    assert found >= {name for name in MANY if name[0] != "payload"}


def test_in_sample_and_held_out_fits_are_the_same_model() -> None:
    base, laws = model({("geometry", "joint:3"): (), ("transmission_error", "joint:2"): (5.0,)}, 3)
    for alone, whole in zip(fit_hypotheses(base, laws), score_hypotheses(base, laws), strict=True):
        assert (alone.whitened, alone.shape, alone.gain, alone.visible) == (
            whole.whitened,
            whole.shape,
            whole.gain,
            whole.visible,
        )
        np.testing.assert_array_equal(alone.x, whole.x)


def offsets_in_frames(
    seed: int, frames: tuple[int, ...], offsets: tuple[int, ...]
) -> tuple[WhitenedModel, list[WhitenedHypothesis]]:
    """Build frames whose three directions contain the zero offset of their own joint and that of the preceding
    joint."""
    rng = np.random.default_rng(seed)
    base, _ = model({}, seed)
    turns = rng.normal(size=(7, POSES, 3, 1))
    own = [rng.normal(size=(POSES, 3, 1)) for _ in range(6)]
    offered = []
    for j in range(6):
        frame = repeat_for_visits(np.concatenate([turns[j], turns[j + 1], own[j]], axis=2))
        offered.append(build_hypothesis("geometry", f"joint:{j + 1}", lambda s, c=frame: c, ((),), "kinematic"))
        turn = repeat_for_visits(turns[j])
        offered.append(build_hypothesis("joint_zero_offset", f"joint:{j + 1}", lambda s, c=turn: c, ((),), "kinematic"))
    known = whiten_hypotheses(base, offered)
    y = base.y.copy()
    for t in known:
        h = t.hypothesis
        if int(h.location[-1]) in (frames if h.effect == "geometry" else offsets):
            y = y + t.X[:, 0] @ np.full(t.X.shape[2], 2.0)
    planted = grams_model(base.w, base.X, y, base.fold, base.prior, base.rows)
    return planted, whiten_hypotheses(planted, offered)


def test_offsets_within_frame_directions_are_reported_as_offsets() -> None:
    """The frames of joints 2 and 4 contain the offsets 2 to 5 and gain more at each step: six coefficients where
    four suffice."""
    base, laws = offsets_in_frames(7, (), (2, 3, 4, 5))
    greedy = select_effects(base, [t for t in laws if t.hypothesis.effect == "geometry"], 6, np.random.default_rng(0))
    assert {c.whitened.hypothesis.effect for c in greedy} == {"geometry"}
    found = description_length.find_shortest_description(base, greedy, normal_equation_sums.CachedSums(base, laws), 6)
    assert {c.whitened.hypothesis.name for c in found} == {("joint_zero_offset", f"joint:{j}") for j in (2, 3, 4, 5)}
    retained = description_length.find_shortest_description(
        base, greedy, normal_equation_sums.CachedSums(base, laws), 2
    )
    assert len(retained) <= 2  # never more than requested


def test_frame_with_its_own_direction_remains_a_frame() -> None:
    base, laws = offsets_in_frames(8, (3,), (5,))
    found = description_length.find_shortest_description(
        base, select_effects(base, laws, 6, np.random.default_rng(0)), normal_equation_sums.CachedSums(base, laws), 6
    )
    assert {c.whitened.hypothesis.name for c in found} == {("geometry", "joint:3"), ("joint_zero_offset", "joint:5")}


@pytest.mark.parametrize(("varies", "named"), [(0.25, "gravity_compensator"), (0.0, "joint_zero_offset")])
def test_coefficient_is_judged_by_the_noise_not_by_the_effect_size(varies: float, named: str) -> None:
    """A coefficient of five standard deviations was insignificant relative to the model uncertainty of a law with
    ten times the noise."""
    rng = np.random.default_rng(4)
    base, _ = model({}, 4)
    constant, part = (repeat_for_visits(rng.normal(size=(POSES, 3, 1))) for _ in range(2))
    both = np.concatenate([constant, part], axis=2)
    offered = [
        build_hypothesis("joint_zero_offset", "joint:2", lambda s: constant, ((),), "kinematic"),
        build_hypothesis("gravity_compensator", "joint:2", lambda s: both, ((),), "joint"),
    ]
    y = base.y + whiten_hypotheses(base, offered)[1].X[:, 0] @ np.array([3.0, varies])
    loud = grams_model(base.w, base.X, y, base.fold, base.prior, base.rows)
    found = select_effects(loud, whiten_hypotheses(loud, offered), 3, np.random.default_rng(0))
    assert [c.whitened.hypothesis.effect for c in found] == [named]


@pytest.mark.parametrize(("varies", "named"), [(0.6, "gravity_compensator"), (0.2, "joint_zero_offset")])
def test_offset_explained_better_by_a_joint_torque_is_that_torque(varies: float, named: str) -> None:
    rng = np.random.default_rng(4)
    base, _ = model({}, 4)
    constant, part = (repeat_for_visits(rng.normal(size=(POSES, 3, 1))) for _ in range(2))
    both = np.concatenate([constant, part], axis=2)
    offered = [
        build_hypothesis("joint_zero_offset", "joint:2", lambda s: constant, ((),), "kinematic"),
        build_hypothesis("gravity_compensator", "joint:2", lambda s: both, ((),), "joint"),
        build_hypothesis(
            "gravity_compensator", "joint:3", lambda s: both, ((),), "joint"
        ),  # at another joint: not considered
        build_hypothesis("unnamed", "joint:2", lambda s: both, ((),), "unnamed"),  # equal fit, but without a name
    ]
    y = base.y + whiten_hypotheses(base, offered)[1].X[:, 0] @ np.array([3.0, varies])
    loud = grams_model(base.w, base.X, y, base.fold, base.prior, base.rows)
    laws = whiten_hypotheses(loud, offered)
    first, last = laws[0], laws[3]
    found = description_length.exchange_for_weight_laws(
        loud, [SelectedEffect(score_hypotheses(loud, [first])[0], 0.5)], laws, np.random.default_rng(0)
    )
    assert [c.whitened.hypothesis.name for c in found] == [(named, "joint:2")]
    assert found[0].p_value == (0.002 if varies > 0.5 else 0.5)  # p-value of the new law, not of the replaced one
    alone = [SelectedEffect(score_hypotheses(loud, [first])[0], 0.5)]
    retained = description_length.exchange_for_weight_laws(loud, alone, [first, last], np.random.default_rng(0))
    assert [c.whitened for c in retained] == [first]  # an unnamed form does not replace a named effect


def test_unnamed_forms_are_built_once_and_have_few_coefficients(monkeypatch: pytest.MonkeyPatch) -> None:
    base, laws = model({}, 3)
    forms, calls = (
        [build_hypothesis("unnamed", "tool", lambda s, p=p: np.ones((N, 3, p)), ((),), "unnamed") for p in (3, 12)],
        [],
    )
    wide = whiten_hypotheses(
        base, [build_hypothesis("geometry", "joint:3", lambda s: np.ones((N, 3, 6)), ((1.0,),), "kinematic")]
    )
    chosen = tuple(SelectedEffect(score_hypotheses(base, [t])[0], 0.002) for t in (*wide, *wide, laws[-1]))
    monkeypatch.setattr(
        uncatalogued_form_guard,
        "whiten_hypotheses",
        lambda b, some: calls.append(list(some)) or whiten_hypotheses(b, some),
    )
    state = SimpleNamespace(base=base, chosen=chosen, catalogue=SimpleNamespace(uncatalogued_hypotheses=tuple(forms)))
    few = uncatalogued_form_guard._list_comparable_forms(state)  # type: ignore[arg-type]  # what it asks for
    assert calls == [[forms[0]]]
    assert [[t.hypothesis for t in some] for some in few] == [[forms[0]], [forms[0]], []]


def test_sum_of_waves_and_its_groups_keep_their_coefficients() -> None:
    """A sum of waves has the same name as a double wave; when it was excluded for that reason, all following groups
    had wrong coefficients."""
    base, laws = offsets_in_frames(7, (), (2, 3, 4, 5))
    q, lever = np.random.default_rng(9).uniform(-2.5, 2.5, (2, POSES, 1))

    def waves(*orders: float) -> Array:
        return repeat_for_visits(
            np.stack([f(n * q) * lever * np.arange(1.0, 4.0) for n in orders for f in (np.cos, np.sin)], 2)
        )

    name = ("transmission_error", "joint:1")
    double = build_hypothesis(*name, lambda s: waves(s[0], 2.0 * s[0]), ORDERS, "kinematic")
    summed = replace(build_hypothesis(*name, lambda s: waves(*s), ORDERS, "kinematic"), sum_name="waves")
    offered = [double, summed, *(t.hypothesis for t in laws)]
    at_two = whiten_hypotheses(base, [double])[0].columns_at(1)
    base = grams_model(base.w, base.X, base.y + at_two @ np.full(4, 6.0), base.fold, base.prior, base.rows)
    laws = whiten_hypotheses(base, offered)
    frames = [t for t in laws if t.hypothesis.effect == "geometry"]
    greedy = select_effects(base, [laws[0], *frames], 6, np.random.default_rng(0))
    assert greedy[0].whitened.hypothesis.name == name  # first, so that all other groups follow it
    own = [(c.whitened, c.scored.shape) for c in greedy]
    groups = normal_equation_sums.CachedSums(base, laws).select_groups(own, description_length._is_exchangeable).groups
    assert [(g.law, g.shape) for g in groups[: len(own)]] == own
    found = description_length.find_shortest_description(base, greedy, normal_equation_sums.CachedSums(base, laws), 6)
    offsets = {("joint_zero_offset", f"joint:{j}") for j in (2, 3, 4, 5)}
    assert {c.whitened.hypothesis.name for c in found} == {name, *offsets}
    assert next(c for c in found if c.whitened.hypothesis.name == name).whitened is laws[0]


def soft(body: tuple[str, str], other: EffectHypothesis, strength: float, seed: int = 2) -> list[SelectedEffect]:
    """Select a body law whose gain is 400 times the noise variance and another law with gain ``strength`` in its
    residual."""
    rng = np.random.default_rng(seed)
    base, _ = model({}, seed)
    shape, frame = (repeat_for_visits(rng.normal(size=(POSES, 3, p))) for p in (1, 3))
    offered = [
        build_hypothesis(*body, lambda s: shape, ((),), "body"),
        build_hypothesis("geometry", "joint:6", lambda s: frame, ((),), "kinematic"),
        other,
    ]
    known = whiten_hypotheses(base, offered)
    each = [t.X[:, 0, 0] for t in (known[0], known[2])]
    y = base.residual * 1.0
    for x, gain in zip(each, (400.0, strength), strict=True):
        left = x - base.X @ np.linalg.lstsq(base.X, x, rcond=None)[0]
        y = y + left * np.sqrt(gain / float(left @ left))
    planted = grams_model(base.w, base.X, y, base.fold, base.prior, base.rows)
    return select_effects(planted, whiten_hypotheses(planted, offered), 6, np.random.default_rng(0))


LINK, BASE = ("link_compliance", "link:2"), ("base_compliance", "base")


@pytest.mark.parametrize(
    ("body", "effect", "where", "gain", "named"),
    [
        (LINK, "payload", "tool", 50.0, False),  # a tapered link is neither a payload nor a zero offset
        (LINK, "joint_zero_offset", "joint:2", 50.0, False),
        (BASE, "joint_coupling", "joint:2-3", 50.0, False),
        (LINK, "payload", "tool", 110.0, True),
        (LINK, "joint_zero_offset", "joint:5", 50.0, True),
        (BASE, "joint_zero_offset", "joint:4", 50.0, True),
    ],
)
def test_law_error_of_a_soft_body_is_no_second_effect(
    body: tuple[str, str], effect: str, where: str, gain: float, named: bool
) -> None:
    columns = repeat_for_visits(np.random.default_rng(11).normal(size=(POSES, 3, 1)))
    found = soft(body, build_hypothesis(effect, where, lambda s: columns, ((),), "environment"), gain)
    assert body in {c.whitened.hypothesis.name for c in found}
    assert ((effect, where) in {c.whitened.hypothesis.name for c in found}) == named


def test_products_with_a_model_are_computed_once_per_part(monkeypatch: pytest.MonkeyPatch) -> None:
    base, laws = model(MANY, 4)
    laws = whiten_hypotheses(base, [t.hypothesis for t in laws])
    worked: list[int] = []
    plain = whitened_hypothesis.compute_products_by_fold
    monkeypatch.setattr(
        whitened_hypothesis, "compute_products_by_fold", lambda *given: worked.append(1) or plain(*given)
    )
    score_hypotheses(base, laws)
    first = len(worked)
    score_hypotheses(base, laws)
    assert len(worked) == first == len(laws)
    additional = base.with_law(laws[0], 2)
    score_hypotheses(additional, laws)
    assert len(worked) == 2 * first  # products with the additional columns only
    score_hypotheses(base.with_law(laws[0], 2), laws)  # a repeated call
    assert len(worked) == 2 * first
    explicit = base.with_columns(laws[0].columns_at(2))
    for a, b in ((additional.XX, explicit.XX), (additional.Xy, explicit.Xy), (additional.X, explicit.X)):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-9)
    for one, other in zip(score_hypotheses(additional, laws), score_hypotheses(explicit, laws), strict=True):
        assert one.gain == pytest.approx(other.gain, rel=1e-9, abs=1e-6)
        np.testing.assert_allclose(one.heldout, other.heldout, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("lengths", [(7, 7, 7), (8, 7, 6), (30, 1, 2), (5,), (9, 0, 9)])
def test_products_by_fold_equal_those_of_each_fold(lengths: tuple[int, ...]) -> None:
    rng = np.random.default_rng(sum(lengths))
    rows = np.split(rng.permutation(sum(lengths)), np.cumsum(lengths)[:-1])
    x, y = rng.normal(size=(sum(lengths), 3, 2)), rng.normal(size=(sum(lengths), 4))
    folds = fold_rows.FoldRows.of([(r, r) for r in rows])
    found = fold_rows.compute_products_by_fold(x, y, folds)
    expected = np.stack([np.einsum("msi,mp->sip", x[r], y[r]) for r in rows])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)

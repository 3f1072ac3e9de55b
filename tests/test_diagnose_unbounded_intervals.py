"""Unobserved compliances have an interval without an upper end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_shape_refinement import SIGMA, _bump

from machopt.measurement.diagnosis.data_types.diagnosis_problem import Quantity
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue
from machopt.measurement.diagnosis.model_selection.evaluation.finding_estimates import (
    estimate_parameters,
    is_size_significant,
)
from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import score_hypotheses
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect
from machopt.measurement.diagnosis.model_selection.search.shape_refinement import build_two_number_refinement
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import whiten_hypotheses
from machopt.numerics.array_types import Array

GRID = tuple((float(q), w) for q in np.linspace(-1.0, 1.0, 3) for w in (0.2, 0.4))


def estimate_sizes(family: str, share: float, *, nearly: bool = False) -> dict[str, EstimatedValue]:
    """Estimate the sizes of a law with two coefficients, the second of which has ``share`` times the displacement of
    the first.

    ``nearly``: readings that give a second coefficient of almost zero.
    """
    rng = np.random.default_rng(2)
    x = rng.uniform(-1.2, 1.2, 400)
    y = 5.0 * SIGMA * np.exp(-0.5 * (x / 0.4) ** 2) + SIGMA * rng.normal(size=len(x))
    columns = np.stack([np.exp(-0.5 * (x / 0.4) ** 2), share * np.cos(3.0 * x)], axis=1)[:, None, :]
    if nearly:
        y = y - (1.0 - 1e-6) * estimate_law_sizes(x, y, columns, "joint", float)["tilt"].value * columns[:, 0, 1]
    return estimate_law_sizes(x, y, columns, family, abs)


def estimate_law_sizes(
    x: Array, y: Array, columns: Array, family: str, size: Callable[[float], float]
) -> dict[str, EstimatedValue]:
    """Estimate the two coefficients of a law, each converted by ``size``."""
    finer = build_two_number_refinement(GRID)
    assert finer is not None
    base, bump = _bump(x, y, GRID, finer)
    law = replace(
        bump,
        columns=lambda s: columns,
        quantities=lambda c, s: {"shift": Quantity(size(c[0]), "m"), "tilt": Quantity(size(c[1]), "rad")},
        shapes=((),),
        refinement=None,
        family=family,
    )
    found = whiten_hypotheses(base, [law])[0]
    return estimate_parameters(base, [SelectedEffect(score_hypotheses(base, [found])[0], 0.0)], 0, [found])


def test_unobserved_compliance_has_no_upper_bound_and_is_not_negative() -> None:
    sizes = estimate_sizes("body", 1e-9, nearly=True)
    assert np.isfinite(sizes["shift"].ci95).all()
    assert np.isinf(sizes["tilt"].ci95[1])
    assert sizes["shift"].ci95[0] > 0.0
    assert sizes["tilt"].ci95[0] >= 0.0
    assert sizes["tilt"].ci90[0] >= 0.0


def test_observed_compliance_keeps_its_bounds() -> None:
    both = estimate_sizes("body", 1.0)
    assert all(np.isfinite(e.ci95).all() for e in both.values())
    signed = estimate_sizes("joint", 1.0)
    assert signed["shift"].ci95 == both["shift"].ci95


@pytest.mark.parametrize(
    ("constrained", "signal", "named"), [(True, 5.0, True), (False, 5.0, False), (True, 0.0, False)]
)
def test_collinear_compliance_coefficients_are_significant_together(
    constrained: bool, signal: float, named: bool
) -> None:
    """A tool compliance of 390 sigma had intervals around zero for each size, because its coefficients were
    collinear."""
    rng = np.random.default_rng(4)
    x = rng.uniform(-1.2, 1.2, 400)
    y = signal * SIGMA * np.exp(-0.5 * (x / 0.4) ** 2) + SIGMA * rng.normal(size=len(x))
    columns = np.stack([np.exp(-0.5 * (x / 0.4) ** 2), np.cos(9.0 * x)], axis=1)[:, None, :]
    finer = build_two_number_refinement(GRID)
    assert finer is not None
    base, bump = _bump(x, y, GRID, finer)
    law = replace(
        bump,
        columns=lambda s: columns,
        # size from the coefficient that is zero in the data
        quantities=lambda c, s: {"tilt": Quantity(float(c[1]), "rad")},
        shapes=((),),
        refinement=None,
        family="body",
        project_to_plausible=(lambda values, information: values) if constrained else None,
    )
    (whitened,) = whiten_hypotheses(base, [law])
    effect = SelectedEffect(score_hypotheses(base, [whitened])[0], 0.0)
    assert is_size_significant(base, [effect], 0) is named


def test_certain_size_suffices_without_certain_coefficients() -> None:
    """Two nearly collinear columns: the sum of their coefficients is well determined, the coefficients are not."""
    rng = np.random.default_rng(4)
    x = rng.uniform(-1.2, 1.2, 400)
    column, other = np.exp(-0.5 * (x / 0.4) ** 2), 0.03 * np.cos(9.0 * x)
    y = 1.5 * SIGMA * column + SIGMA * rng.normal(size=len(x))
    columns = np.stack([column + other, column - other], axis=1)[:, None, :]
    finer = build_two_number_refinement(GRID)
    assert finer is not None
    base, bump = _bump(x, y, GRID, finer)
    law = replace(
        bump,
        columns=lambda s: columns,
        quantities=lambda c, s: {"tilt": Quantity(float(c[0] + c[1]), "rad")},
        shapes=((),),
        refinement=None,
        family="body",
        project_to_plausible=lambda values, information: values,
    )
    (whitened,) = whiten_hypotheses(base, [law])
    assert is_size_significant(base, [SelectedEffect(score_hypotheses(base, [whitened])[0], 0.0)], 0)

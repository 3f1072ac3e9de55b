"""State of a diagnosis: problem, noise, hypotheses and selected effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.model_selection.search.selected_effect import SelectedEffect, add_selected_effects
from machopt.measurement.diagnosis.statistics.holdout_residuals import FittedModel
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.measurement.diagnosis.statistics.whitening import ErrorWhitening
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SearchState:
    """Problem, noise, hypotheses and selected effects of one iteration."""

    problem: DiagnosisProblem
    catalogue: HypothesisCatalogue
    used_rows: Flags
    noise: ReplicateNoise
    whitening: ErrorWhitening
    base: WhitenedModel
    base_units: Array
    whitened_hypotheses: tuple[WhitenedHypothesis, ...]
    chosen: tuple[SelectedEffect, ...]

    @property
    def catalogue_hypotheses(self) -> tuple[WhitenedHypothesis, ...]:
        """Hypotheses that may become findings."""
        return tuple(t for t in self.whitened_hypotheses if t.hypothesis.is_in_catalogue)

    def fit_effects(self, chosen: Sequence[SelectedEffect]) -> FittedModel:
        """Fit base and effects with columns in SI.

        Args:
            chosen: Effects to include.

        Returns:
            The fitted model.
        """
        columns, unit = [self.problem.base], [self.base_units]
        for c in chosen:
            columns.append(c.whitened.hypothesis.columns(c.whitened.shapes[c.scored.shape]))
            unit.append(c.whitened.unit[c.scored.shape])
        return FittedModel(
            add_selected_effects(self.base, chosen),
            np.concatenate(columns, axis=2),
            np.concatenate(unit),
            self.problem.y,
        )

"""An effect in the selected model, and the model with all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from machopt.measurement.diagnosis.model_selection.screening.hypothesis_screening import ScoredHypothesis
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array

BODY = "body"  # family of compliant bodies
SENSOR = "sensor"  # family of recording errors
LAW_DEVIATION = "deviation from a law"  # name of the form in :mod:`law_deviation`


@dataclass(frozen=True)
class SelectedEffect:
    """One effect of the selected model."""

    scored: ScoredHypothesis  # scored together with the other effects
    p_value: float
    law_error: float | None = None  # gain that the law may leave; None: a share of its own gain

    @property
    def whitened(self) -> WhitenedHypothesis:
        return self.scored.whitened

    @property
    def columns(self) -> Array:
        return self.scored.whitened.columns_at(self.scored.shape)


def add_selected_effects(model: WhitenedModel, chosen: Sequence[SelectedEffect]) -> WhitenedModel:
    """Return the model with the columns of selected effects.

    Args:
        model: Whitened base model.
        chosen: Selected effects, each fitted together with the others.

    Returns:
        The extended model.
    """
    return model.extend_by_laws([(c.whitened, c.scored.shape) for c in chosen])


def is_law_deviation(c: SelectedEffect) -> bool:
    """Return whether a selected form is the fitted deviation of another effect from its law.

    Args:
        c: Selected effect.

    Returns:
        True if so.
    """
    return c.whitened.hypothesis.law == LAW_DEVIATION

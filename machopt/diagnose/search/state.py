"""Where a diagnosis stands: what is measured, how noisy it is, what was tried and what was chosen so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.diagnose.evidence.grams import Model, Tried
from machopt.diagnose.evidence.heldout import Fitted
from machopt.diagnose.evidence.noise import Noise
from machopt.diagnose.evidence.whitening import Whitening
from machopt.diagnose.nouns.problem import Catalogue, Problem
from machopt.diagnose.search.select import Chosen, with_chosen

Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class State:
    """One round of the search."""

    problem: Problem
    catalogue: Catalogue
    used: Flags
    noise: Noise
    w: Whitening
    base: Model
    unit: Array
    tried: tuple[Tried, ...]
    chosen: tuple[Chosen, ...]

    @property
    def named(self) -> tuple[Tried, ...]:
        """What findings are made of."""
        return tuple(t for t in self.tried if t.hypothesis.named)

    def fitted(self, chosen: Sequence[Chosen]) -> Fitted:
        """Base and some effects with their columns in SI."""
        columns, unit = [self.problem.base], [self.unit]
        for c in chosen:
            columns.append(c.tried.hypothesis.columns(c.tried.shapes[c.scored.shape]))
            unit.append(c.tried.unit[c.scored.shape])
        return Fitted(
            with_chosen(self.base, chosen), np.concatenate(columns, axis=2), np.concatenate(unit), self.problem.y
        )

"""Cache of finished searches of one recording, for diagnoses that differ only in what is written."""

from __future__ import annotations

from collections.abc import Hashable

from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis

MAX_CACHED_BYTES = 2**27  # memory of the columns and products of all cached searches


class SearchCache:
    """Finished searches of one recording; the oldest are dropped where all need more than MAX_CACHED_BYTES."""

    def __init__(self) -> None:
        """Begin without any."""
        self._states: dict[Hashable, tuple[SearchState, int]] = {}

    def find_state(self, key: Hashable) -> SearchState | None:
        """Return the state of a search.

        Args:
            key: All that the search depends on.

        Returns:
            The state; None if the search was not run, was too large, or gave way to later ones.
        """
        found = self._states.get(key)
        return None if found is None else found[0]

    def store_state(self, key: Hashable, state: SearchState) -> None:
        """Store the state of a search if it fits.

        Args:
            key: All that the search depends on.
            state: State of the search.
        """
        size = sum(_measure_bytes(law) for law in state.whitened_hypotheses)
        if size > MAX_CACHED_BYTES:
            return
        self._states[key] = state, size
        while sum(size for _, size in self._states.values()) > MAX_CACHED_BYTES:
            del self._states[next(iter(self._states))]

    def clear(self) -> None:
        """Drop all states."""
        self._states.clear()


def _measure_bytes(law: WhitenedHypothesis) -> int:
    """Return the memory of a law's columns and of their cached products with those of models."""
    products = (entry for shapes in law.products.values() for entry in shapes.values())
    return law.X.nbytes + sum(by_fold.nbytes + total.nbytes for _, by_fold, total in products)

"""Finished searches of one recording, kept for diagnoses that differ only in what is written."""

from __future__ import annotations

from collections.abc import Hashable

from machopt.measurement.diagnosis.model_selection.search.search_state import SearchState

MOST_KEPT_BYTES = 2**27  # memory of the columns of a search that is kept


class KeptSearches:
    """Finished searches of one recording, for diagnoses that differ only in what is written."""

    def __init__(self) -> None:
        """Keep none at first."""
        self._states: dict[Hashable, SearchState] = {}

    def find_state(self, key: Hashable) -> SearchState | None:
        """Return the state of a search.

        Args:
            key: All that the search depends on.

        Returns:
            The state; None if the search was not run or is too large to be kept.
        """
        return self._states.get(key)

    def keep_state(self, key: Hashable, state: SearchState) -> None:
        """Keep the state of a search if the columns of its laws need little memory.

        Args:
            key: All that the search depends on.
            state: State of the search.
        """
        if sum(t.X.nbytes for t in state.whitened_hypotheses) <= MOST_KEPT_BYTES:
            self._states[key] = state

"""Limit of unsuccessful searches for rapid moves over a whole job.

The random tree of :mod:`machopt.planning.motion.rapid_moves` finds a path or gives up; it never proves that there is
none. In a cell with free external joints the same blocked move would be searched again for every plan. The extensions
of unsuccessful trees are therefore counted. Once the budget is used up, a tree may only have AFTERWARDS extensions. The
budget counts extensions and not seconds, so that the same job gives the same result on every machine.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass

EXTENSIONS = 4_000  # unsuccessful, per choice of free external joints: two full searches
AFTERWARDS = 40  # extensions of a tree once the budget is used up


@dataclass
class SearchBudget:
    """Number of unsuccessful tree extensions that remain."""

    left: int = EXTENSIONS

    @property
    def used_up(self) -> bool:
        """Whether no extensions remain."""
        return self.left <= 0


_BUDGET: ContextVar[SearchBudget | None] = ContextVar("search_budget", default=None)


@contextlib.contextmanager
def limit_search(budget: SearchBudget) -> Iterator[None]:
    """Count the searches inside the block against a budget.

    Args:
        budget: budget to use; decreased by unsuccessful searches.
    """
    token = _BUDGET.set(budget)
    try:
        yield
    finally:
        _BUDGET.reset(token)


def allow_extensions(requested: int) -> int:
    """Return how many extensions a tree may have.

    Args:
        requested: number without a budget.
    """
    budget = _BUDGET.get()
    return min(requested, AFTERWARDS) if budget is not None and budget.used_up else requested


def count_in_vain(extensions: int) -> None:
    """Count a tree that found no path.

    Args:
        extensions: number of its extensions.
    """
    budget = _BUDGET.get()
    if budget is not None:
        budget.left -= extensions


def is_used_up() -> bool:
    """Return whether a budget is active and used up."""
    budget = _BUDGET.get()
    return budget is not None and budget.used_up

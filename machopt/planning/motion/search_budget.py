"""A bound on what searches for rapid moves may spend in vain over a whole job.

The random tree of :mod:`.rapids` finds a way or gives up; it never proves that there is none. In a cell with free
external joints the same blocked move would be searched again for every plan that is tried. So the extensions of trees
that found nothing are counted, and once the budget is used up a tree may only grow AFTERWARDS extensions. The budget
counts extensions and not seconds, so that the same job gives the same answer on every machine.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass

EXTENSIONS = 4_000  # in vain, of one choice of free external joints: two searches to the end
AFTERWARDS = 40  # extensions of a tree once the budget is used up


@dataclass
class SearchBudget:
    """Tree extensions that may still be spent in vain."""

    left: int = EXTENSIONS

    @property
    def used_up(self) -> bool:
        return self.left <= 0


_BUDGET: ContextVar[SearchBudget | None] = ContextVar("search_budget", default=None)


@contextlib.contextmanager
def limit_search(budget: SearchBudget) -> Iterator[None]:
    """Count the searches made within it against the budget."""
    token = _BUDGET.set(budget)
    try:
        yield
    finally:
        _BUDGET.reset(token)


def allow_extensions(wanted: int) -> int:
    """Return how many extensions a tree may have."""
    budget = _BUDGET.get()
    return min(wanted, AFTERWARDS) if budget is not None and budget.used_up else wanted


def count_in_vain(extensions: int) -> None:
    """Count a tree that found no way."""
    budget = _BUDGET.get()
    if budget is not None:
        budget.left -= extensions


def is_used_up() -> bool:
    """A budget is in force and nothing is left of it."""
    budget = _BUDGET.get()
    return budget is not None and budget.used_up

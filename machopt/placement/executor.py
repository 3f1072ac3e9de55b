"""Who answers what is asked about places: this process, others of the machine, or those of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

A = TypeVar("A")
B = TypeVar("B")


class PlacementExecutor(Protocol):
    """Answers come in the order of the questions, however many are worked on at a time: what is found does not depend
    on how many hands there were."""

    @property
    def worker_count(self) -> int:
        """How many questions are worked on at a time."""
        ...

    def map_items(self, ask: Callable[[Any, A], B], items: Sequence[A]) -> Iterator[B]:
        """``ask`` (a function of a module, so that another process finds it) of the Site and each item, in order.

        Whoever stops reading leaves the rest unasked, as far as nobody has begun with it.
        """
        ...


@dataclass(frozen=True, eq=False)
class InProcessExecutor:
    """This process: one after the other, and none before its answer is wanted."""

    site: Any  # Site

    @property
    def worker_count(self) -> int:
        return 1

    def map_items(self, ask: Callable[[Any, A], B], items: Sequence[A]) -> Iterator[B]:
        return (ask(self.site, item) for item in items)

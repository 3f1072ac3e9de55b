"""Executors of placement tasks: this process, other processes of the machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

A = TypeVar("A")
B = TypeVar("B")


class PlacementExecutor(Protocol):
    """Executor that returns results in the order of the items, so that the result does not depend on the number of
    workers.
    """

    @property
    def worker_count(self) -> int:
        """Number of items processed at a time."""
        ...

    def map_items(self, ask: Callable[[Any, A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the result of a function of the site and each item, in order.

        If the caller stops reading, items that no worker has started are not processed.

        Args:
            ask: function of a module, so that another process can import it.
            items: items to process.
        """
        ...


@dataclass(frozen=True, eq=False)
class InProcessExecutor:
    """Executor in this process: one item after the other, each when its result is read."""

    site: Any  # Site

    @property
    def worker_count(self) -> int:
        return 1

    def map_items(self, ask: Callable[[Any, A], B], items: Sequence[A]) -> Iterator[B]:
        """Yield the result of a function of the site and each item, in order.

        Args:
            ask: function of the site and an item.
            items: items to process.
        """
        return (ask(self.site, item) for item in items)

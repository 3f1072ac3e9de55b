"""Progress messages of a long step: fraction and rate."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

REPORT_INTERVAL = 2.0  # s between two messages


class ProgressRate:
    """Reports progress and rate of a counted step."""

    def __init__(self, say: Callable[[str], None], words: str, of: int, things: str) -> None:
        self._say, self._words, self._of, self._things = say, words, of, things
        self._began = self._last = perf_counter()

    def __call__(self, done: int) -> None:
        now = perf_counter()
        if now - self._last < REPORT_INTERVAL or done <= 0:
            return
        self._last = now
        self._say(f"{self._words}: {done} of {self._of} {self._things}, {done / (now - self._began):.3g} a second")

"""Ctrl-C and SIGTERM while a folder is written."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any


class InterruptSignals:
    """Conversion of SIGTERM into an exception like Ctrl-C's, and deferral of both on request.

    Handlers are process-wide and belong to the main thread: elsewhere, or where the program has its own
    handler, nothing is touched.
    """

    def __init__(self) -> None:
        self._held = False
        self._came: int | None = None
        self._waiting: list[int] = []
        self._former: dict[int, Any] = {}

    def __enter__(self) -> InterruptSignals:
        if threading.current_thread() is threading.main_thread():
            defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
            for number, default in defaults.items():
                if signal.getsignal(number) == default:
                    self._former[number] = signal.signal(number, self._handle_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)
        for number in self._waiting:
            self._raise(number)

    def defer_signals(self) -> None:
        """Defer signals from here to the end of the block."""
        self._held = True

    def raise_pending_signal(self) -> None:
        """Raise for a signal that has arrived already."""
        if self._came is not None:
            self._raise(self._came)

    def _handle_signal(self, number: int, _: FrameType | None) -> None:
        self._came = number
        if self._held:
            self._waiting.append(number)
        else:
            self._raise(number)

    @staticmethod
    def _raise(number: int) -> None:
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + number)

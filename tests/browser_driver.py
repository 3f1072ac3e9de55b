"""Debian's Chromium driven by Playwright: real pointer events, screenshots, stylesheets, console and requests.

The browser is the installed system browser; the Playwright package contains the driver, and nothing is downloaded.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import ConsoleMessage, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DRAWS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL without a graphics card
OURS = ("willReadFrequently", "GPU stall due to ReadPixels")  # browser warnings about tests that read pixels back
TIMEOUT = 90_000.0  # ms, for any single call; a page takes two or three seconds


def program() -> str:
    """Return the path of the browser.

    Raises:
        pytest.skip.Exception: no browser or no Playwright is installed (in CI the test fails instead).
    """
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        skip_without_browser(f"no browser (none of {', '.join(BROWSERS)})")
    try:
        import playwright.sync_api  # noqa: F401 — a development dependency; the other tests go without
    except ImportError:
        skip_without_browser("no Playwright (make test installs it)")
    assert found is not None
    return found


def skip_without_browser(what: str) -> None:
    """Skip the test, or fail it in CI."""
    output = f"{what}: the pages' scripts are not exercised"
    if os.environ.get("CI"):
        pytest.fail(output)
    pytest.skip(output)


class Browser:
    """One page of a browser that is started and stopped with the block; to be used in the thread that started it."""

    page: Page

    def __init__(self, width: int = 1200, height: int = 900, *, dark: bool = False) -> None:
        file = program()
        from playwright.sync_api import sync_playwright

        self._driver = sync_playwright().start()
        try:
            self._browser = self._driver.chromium.launch(executable_path=file, args=DRAWS, timeout=TIMEOUT)
            self.page = self._browser.new_page(
                viewport={"width": width, "height": height}, color_scheme="dark" if dark else "light"
            )
        except BaseException:
            self._driver.stop()
            raise
        self.page.set_default_timeout(TIMEOUT)
        self.complaints: list[str] = []  # errors and warnings of the page
        self.requests: list[str] = []  # requested addresses
        self.page.on("pageerror", lambda e: self.complaints.append(str(e)))
        self.page.on("console", self._said)
        self.page.on("request", lambda r: self.requests.append(r.url))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        try:
            self._browser.close()
        finally:
            self._driver.stop()

    def open(self, place: str | Path) -> None:
        """Open an address or a file and wait until it is loaded and drawn."""
        self.page.goto(place.as_uri() if isinstance(place, Path) else place, wait_until="load")
        self._drawn()

    @contextmanager
    def loading(self) -> Iterator[None]:
        """Wait for the page to load again after the actions in the block."""
        with self.page.expect_event("load"):
            yield
        self._drawn()

    def script(self, text: str) -> Any:
        """Return the value of an expression on the page, awaited."""
        return self.page.evaluate(text)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press, move and release the mouse."""
        self.page.mouse.move(*start)
        self.page.mouse.down()
        self.page.mouse.move(*end, steps=6)
        self.page.mouse.up()

    def _drawn(self) -> None:
        self.script("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def _said(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning", "assert") and not any(words in message.text for words in OURS):
            self.complaints.append(f"{message.text} {message.location.get('url', '')}")

"""A headless browser driven over its own debugging pipe: real pointer events, screenshots, console and requests.

No package beside the standard library: the DevTools protocol is JSON, each message ended by a zero byte, read from the
browser's file descriptor 4 and written to 3.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WIRED = """import os, sys
a, b = (os.dup(int(n)) for n in sys.argv[1:3])  # whatever numbers the pipe's ends had, the browser has them as 3 and 4
os.dup2(a, 3)
os.dup2(b, 4)
for n in (3, 4):
    os.set_inheritable(n, True)  # where a number was right already, dup2 has changed nothing
os.execv(sys.argv[3], sys.argv[3:])"""
TIMEOUT = 60.0  # s, for any one answer


class Browser:
    """One page of a browser that is started here and ended by :meth:`close`."""

    def __init__(self, folder: Path, width: int = 1200, height: int = 900, *, dark: bool = False) -> None:
        program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
        if program is None:
            pytest.skip(f"a browser is absent (none of {', '.join(BROWSERS)}): the page's scripts are not exercised")
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()

        command = [program, "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        command += ["--no-first-run", f"--user-data-dir={folder / 'profile'}", "--remote-debugging-pipe", "about:blank"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", WIRED, str(to_read), str(to_write), *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            pass_fds=(to_read, to_write),
        )
        os.close(to_read)
        os.close(to_write)
        self._left, self._last, self._session = b"", 0, ""
        self.complaints: list[str] = []  # errors and warnings of the page
        self.requests: list[str] = []  # addresses it asked for
        self.loads = 0
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        self._session = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable", {})
        self.size(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", {"features": [scheme]})

    def size(self, width: int, height: int) -> None:
        """Make the window so large."""
        wanted = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", wanted)

    def open(self, url: str) -> None:
        """Go to an address and wait until it is loaded."""
        seen = self.loads
        self._call("Page.navigate", {"url": url})
        self.loaded(seen)

    def loaded(self, seen: int) -> None:
        """Wait for more loads than ``seen``."""
        end = time.monotonic() + TIMEOUT
        while self.loads <= seen:
            assert time.monotonic() < end, "the page was not loaded"
            self._message(0.2)
        self.script("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def script(self, text: str) -> Any:
        """The value of an expression on the page, awaited."""
        asked = {"expression": text, "returnByValue": True, "awaitPromise": True}
        found = self._call("Runtime.evaluate", asked)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def pointer(self, kind: str, x: float, y: float) -> None:
        """A real pointer event: mousePressed, mouseMoved or mouseReleased."""
        pressed = kind != "mouseMoved" or self._down
        self._down = kind == "mousePressed" or (kind == "mouseMoved" and self._down)
        button = {"button": "left" if pressed else "none", "buttons": int(self._down), "clickCount": 1}
        self._call("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **button})

    _down = False

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 6) -> None:
        """Press, move and release."""
        self.pointer("mouseMoved", *start)
        self.pointer("mousePressed", *start)
        for k in range(1, steps + 1):
            self.pointer("mouseMoved", *(a + k / steps * (b - a) for a, b in zip(start, end, strict=True)))
        self.pointer("mouseReleased", *end)

    def picture(self, file: Path, *, whole: bool = False) -> None:
        """A screenshot, of the window or of the whole page."""
        shot = self._call("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": whole})
        file.write_bytes(base64.b64decode(shot["data"]))

    def close(self) -> None:
        """End the browser and everything it started."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._read)
        os.close(self._write)

    def _call(self, method: str, given: dict[str, Any]) -> dict[str, Any]:
        self._last += 1
        number = self._last
        message = {"id": number, "method": method, "params": given}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            answer = self._message(0.5)
            if answer is not None and answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return dict(answer["result"])
        raise AssertionError(f"no answer to {method}")

    def _message(self, seconds: float) -> dict[str, Any] | None:
        """The next message, events noted; None where none came in time."""
        while b"\0" not in self._left:
            if not select.select([self._read], [], [], seconds)[0]:
                return None
            data = os.read(self._read, 1 << 16)
            assert data, "the browser has ended"
            self._left += data
        text, _, self._left = self._left.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        kind, given = message.get("method"), message.get("params", {})
        if kind == "Page.loadEventFired":
            self.loads += 1
        elif kind == "Runtime.exceptionThrown":
            self.complaints.append(str(given["exceptionDetails"]))
        elif kind == "Runtime.consoleAPICalled" and given["type"] in ("error", "warning", "assert"):
            self.complaints.append(" ".join(str(a.get("value")) for a in given["args"]))
        elif kind == "Log.entryAdded" and given["entry"]["level"] in ("error", "warning"):
            self.complaints.append(f"{given['entry']['text']} {given['entry'].get('url', '')}")
        elif kind == "Network.requestWillBeSent":
            self.requests.append(given["request"]["url"])
        return message

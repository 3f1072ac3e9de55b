"""Closed output streams, and terminals that support ASCII only."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
INSPECT = [sys.executable, "-m", "machopt.cli", "inspect", str(ROOT / "toolpaths" / "plain.csv")]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


def shell(words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = " ".join(f"'{w}'" for w in INSPECT)
    return subprocess.run(
        ["sh", "-c", words.replace("COMMAND", command)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )


def test_closed_reader_is_a_failure_without_a_traceback() -> None:
    done = shell("{ COMMAND; echo $? >&2; } | true")
    assert done.stderr.split() == ["141"]


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_discard_output(closed: str) -> None:
    done = shell(f"COMMAND {closed}")
    assert (done.returncode, done.stderr) == (0, "")


def test_characters_unknown_to_the_terminal_are_escaped() -> None:
    done = shell("COMMAND", PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.isascii()

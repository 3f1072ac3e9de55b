"""The process of a command ends immediately, after all exit handlers."""

from __future__ import annotations

import subprocess
import sys

import pytest

LAST = """
import atexit, sys, threading, time
from machopt.cli.process_entry import exit_process
atexit.register(print, "at exit")
class Slow:
    def __del__(self):
        print("taken down")
kept = Slow()
def late():
    time.sleep(0.2)
    print("thread done")
if {thread}:
    threading.Thread(target=late).start()
print("told", end=" ")
print("warned", file=sys.stderr, end=" ")
exit_process(3)
"""


@pytest.mark.parametrize(
    ("thread", "told"),
    [(False, "told at exit\n"), (True, "told thread done\nat exit\ntaken down\n")],
    ids=["alone", "another thread runs"],
)
def test_process_ends_with_its_code_and_complete_output(thread: bool, told: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LAST.format(thread=thread)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 3
    assert done.stdout == told
    assert done.stderr == "warned "


def test_refused_command_line_ends_with_its_code() -> None:
    done = subprocess.run([sys.executable, "-m", "machopt", "nothing"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "found 'nothing'; valid: optimize" in done.stderr

"""What is said when kernels are compiled, and where there is no place to store them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from machopt import compiled as module
from machopt.cli import compiling
from machopt.cli.compiling import NOT_STORED, STORED
from machopt.cli.display import Display

ROOT = Path(__file__).resolve().parents[1]


def test_a_compilation_is_told_once(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    monkeypatch.setattr("machopt.plan.kernels.compile_beside", lambda: started.append(True))
    with Display(show=True) as display, compiling.compiling(display):
        module._LISTENER.on_start(None)
        module._LISTENER.on_start(None)
    assert capsys.readouterr().err == f"… {STORED}\n"
    assert started == [True]


def test_what_is_compiled_after_the_plan_starts_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("machopt.plan.kernels.compile_beside", lambda: pytest.fail("nobody would end it"))
    with Display(show=False) as display, compiling.compiling(display):
        pass
    module._LISTENER.on_start(None)


def test_without_a_place_to_store_it_says_what_would_help(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere(*_: object, **options: object) -> object:
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")  # as numba does
        return lambda function: function

    monkeypatch.setattr(module._LISTENER, "stored", True)
    monkeypatch.setattr(module.numba, "njit", nowhere)
    module.compiled(lambda x: x)
    monkeypatch.setattr("machopt.plan.kernels.compile_beside", lambda: pytest.fail("would store nothing"))
    with Display(show=True) as display, compiling.compiling(display):
        module._LISTENER.on_start(None)
    assert capsys.readouterr().err == f"… {NOT_STORED}\n"


def test_help_and_inspect_import_no_heavy_package(tmp_path: Path) -> None:
    heavy = "fcl coal pinocchio numba scipy trimesh pydantic plotly matplotlib"
    code = """
import sys
from machopt.cli import main
try:
    main(sys.argv[2:])
except SystemExit:
    pass
found = [name for name in sys.argv[1].split() if name in sys.modules]
assert not found, found
if "--help" in sys.argv:
    assert "numpy" not in sys.modules
"""
    for words in (["--help"], ["inspect", str(ROOT / "toolpaths" / "plate_holes.csv")]):
        done = subprocess.run(
            [sys.executable, "-c", code, heavy, *words],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert done.returncode == 0, done.stderr

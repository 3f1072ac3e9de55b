"""Kernel compilation: messages, cache, and missing cache folder."""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.caching import NullCache

from machopt.cli import compilation_notice
from machopt.cli.compilation_notice import NOT_STORED, STORED
from machopt.cli.progress_display import ProgressDisplay
from machopt.numerics import compiled_functions as module
from machopt.planning import kernel_precompilation
from machopt.planning.kernel_precompilation import KERNELS, MORE, compile_all

ROOT = Path(__file__).resolve().parents[1]
FACTOR = 2.0


@module.jit_compile
def scale_by_factor(x: float) -> float:
    return FACTOR * x


def test_installed_kernel_is_not_compiled_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = numba.njit(nogil=True)(scale_by_factor.py_func)  # type: ignore[attr-defined]
    module.enable_kernel_storage(first, tmp_path)
    first(1.0)
    again = numba.njit(nogil=True)(scale_by_factor.py_func)  # type: ignore[attr-defined]
    again._cache = module._InstalledCache(again.py_func, again._cache, tmp_path)
    assert again(3.0) == 6.0
    assert len(again.stats.cache_hits) == 1
    assert again(3) == 6  # other types: compiled
    assert len(again.stats.cache_misses) == 1
    monkeypatch.setitem(globals(), "FACTOR", 3.0)  # simulates another version with another number
    other = numba.njit(nogil=True)(scale_by_factor.py_func)  # type: ignore[attr-defined]
    other._cache = module._InstalledCache(other.py_func, other._cache, tmp_path)
    assert other(3.0) == 9.0


def test_kernel_is_recompiled_when_a_called_kernel_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """numba checks only the caller's file: with the callee in another file it would use the old machine code."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "numba"))
    monkeypatch.syspath_prepend(tmp_path)
    head = "from machopt.numerics.compiled_functions import jit_compile\n"
    (tmp_path / "outer_kernel.py").write_text(
        f"{head}from inner_kernel import inner\n\n@jit_compile\ndef outer(x):\n    return inner(x)\n"
    )
    made, output = ("outer_kernel", "inner_kernel"), []
    # the lengths differ because the bytecode of a module is identified by time and size
    for factor in ("2.0", "2.0", "-3.25"):
        (tmp_path / "inner_kernel.py").write_text(f"{head}\n@jit_compile\ndef inner(x):\n    return {factor} * x\n")
        importlib.invalidate_caches()
        module._hash_file.cache_clear()  # simulates a new process
        for name in made:
            sys.modules.pop(name, None)
        outer = importlib.import_module(made[0]).outer
        output.append((outer(1.0), len(outer.stats.cache_hits)))
    for name in made:
        sys.modules.pop(name)
    module._hash_file.cache_clear()
    assert output == [(2.0, 0), (2.0, 1), (-3.25, 0)]


def test_precompiled_kernel_is_stored_under_its_call_signature() -> None:
    """numba stores under the argument of ``compile``: if the argument is a text
    of the types, no call finds the entry."""
    finest = next(k for k in KERNELS if k[1] == "_finest")
    (kernel,) = compile_all([finest])
    values = [*kernel.stats.cache_hits, *kernel.stats.cache_misses]
    assert values
    assert all(isinstance(types, tuple) for types in values)


def test_stored_kernel_is_loaded_without_compilation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    types = (numba.float64,)
    first = numba.njit(nogil=True)(scale_by_factor.py_func)  # type: ignore[attr-defined]
    module.enable_kernel_storage(first, tmp_path)
    again = numba.njit(nogil=True)(scale_by_factor.py_func)  # type: ignore[attr-defined]
    again._cache = module._InstalledCache(again.py_func, NullCache(), tmp_path)
    assert not module.load_stored_kernel(again, types)  # not stored yet
    assert again.signatures == []
    first(1.0)
    assert module.load_stored_kernel(again, types)
    monkeypatch.setattr(again._cache, "load_overload", lambda *_: pytest.fail("taken already"))
    assert module.load_stored_kernel(again, types)
    assert again(3.0) == 6.0
    assert (len(again.stats.cache_hits), len(again.stats.cache_misses)) == (1, 0)


def test_machine_code_is_loaded_without_the_compiler(tmp_path: Path) -> None:
    """A process with stored code does not import the compiler; other types are compiled there."""
    (tmp_path / "stored_kernel.py").write_text(
        "from machopt.numerics.compiled_functions import jit_compile\n\n\n@jit_compile\ndef mean(x):\n    return "
        "x.sum() / len(x)\n"
    )
    code = """
import numpy as np, numba.core.base as base
from stored_kernel import mean
refreshed, refresh = [], base.BaseContext.refresh
base.BaseContext.refresh = lambda context: (refreshed.append(context), refresh(context))[1]
print(mean(np.array([1.0, 2.0])), len(refreshed) > 0, end=" ")
print(mean(np.array([1, 2])), len(refreshed) > 0)
"""
    places = os.pathsep.join([str(tmp_path), str(ROOT)])
    environment = {**os.environ, "PYTHONPATH": places, "NUMBA_CACHE_DIR": str(tmp_path / "numba")}

    def run(text: str) -> str:
        return subprocess.run(
            [sys.executable, "-c", text], capture_output=True, text=True, check=True, env=environment
        ).stdout

    run("import numpy as np\nfrom stored_kernel import mean\nmean(np.array([1.0, 2.0]))")
    assert run(code) == "1.5 False 1.5 True\n"


@pytest.mark.parametrize(("cores", "taken"), [(2, 3), (1, 0)])
def test_second_core_loads_kernels_until_one_is_missing(
    cores: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    requested: list[str] = []
    third = threading.Event()

    def take(kernel: Any, types: tuple[Any, ...]) -> bool:
        assert len(types) == kernel.py_func.__code__.co_argcount
        requested.append(kernel.py_func.__name__)
        if len(requested) == 3:
            third.set()
        return len(requested) < 3

    monkeypatch.setattr(module, "load_stored_kernel", take)
    monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda: cores)
    with kernel_precompilation.preload_kernels_in_thread():
        assert cores < 2 or third.wait(60.0)
    assert requested == [name for _, name, _ in KERNELS[:taken]]


@pytest.mark.parametrize(
    "gone", [("kinematics.product_of_exponentials", "renamed", "f8"), ("kinematics.moved_away", "compute_poses", "f8")]
)
def test_unknown_kernel_entry_does_not_affect_a_plan(
    gone: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nothing is printed and the plan succeeds; the next test names the entry."""
    requested: list[str] = []
    monkeypatch.setattr(
        module, "load_stored_kernel", lambda kernel, _: requested.append(kernel.py_func.__name__) or True
    )
    monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda: 2)
    monkeypatch.setattr(kernel_precompilation, "KERNELS", (KERNELS[0], gone, *KERNELS[1:]))
    before = threading.active_count()
    with kernel_precompilation.preload_kernels_in_thread():
        while threading.active_count() > before:
            pass
    assert requested == [KERNELS[0][1]]
    assert capfd.readouterr().err == ""


def test_every_precompiled_entry_is_a_kernel() -> None:
    from importlib import import_module

    from numba.core.sigutils import normalize_signature

    for name, function, types in KERNELS + MORE:
        kernel = getattr(import_module(f"machopt.{name}"), function, None)
        assert kernel is not None, (
            f"planning/kernel_precompilation.py lists {name}.{function}, which is gone: rename or remove the entry"
        )
        arguments, _ = normalize_signature(f"({types})")
        assert len(arguments) == kernel.py_func.__code__.co_argcount, (name, function)


def test_every_called_kernel_is_precompiled() -> None:
    """Otherwise the first command after an installation compiles: the first run of a cobot took twice as long."""
    trees = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): ast.parse(path.read_text(encoding="utf-8"))
        for path in (ROOT / "machopt").rglob("*.py")
    }
    made = {
        (file, node.name): node
        for file, tree in trees.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and any(getattr(d, "id", "").startswith("jit_compile") for d in node.decorator_list)
    }
    files = {file for file, _ in made}
    called: set[tuple[str, str]] = set()
    for file, tree in trees.items():
        known = {name: (file, name) for there, name in made if there == file}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                known |= {a.asname or a.name: (node.module, a.name) for a in node.names}
        if not any(of in made or ".".join(of) in files for of in known.values()):
            continue  # it uses no compiled function and no file with one
        inside = {id(n) for (there, _), f in made.items() if there == file for n in ast.walk(f)}
        for node in ast.walk(tree):
            if id(node) in inside:
                continue  # one kernel calls another
            if isinstance(node, ast.Name):
                called.add(known.get(node.id, ("", "")))
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                called.add((".".join(known.get(node.value.id, ("",))), node.attr))
    brought = {(f"machopt.{name}", function) for name, function, _ in KERNELS + MORE}
    assert len(brought & called) > 40, "the search has lost sight of them"
    assert sorted((called & made.keys()) - brought) == []


def test_kernel_compilation_needs_only_numpy_and_numba() -> None:
    """A wheel is built where no other package is installed."""
    code = """
import sys, numba
from importlib import import_module
before = set(sys.modules)
for name in sys.argv[1:]:
    import_module(name)
new = {n.split(".")[0] for n in set(sys.modules) - before} - set(sys.stdlib_module_names)
assert new <= {"machopt", "numpy", "numba", "llvmlite"}, new
"""
    names = sorted({f"machopt.{name}" for name, _, _ in KERNELS + MORE})
    done = subprocess.run(
        [sys.executable, "-c", code, *names],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr


def test_compilation_is_reported_once(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    monkeypatch.setattr("machopt.planning.kernel_precompilation.start_compile_process", lambda: started.append(True))
    with ProgressDisplay(show=True) as display, compilation_notice.announce_compilation(display):
        module._LISTENER.on_start(None)
        module._LISTENER.on_start(None)
    assert capsys.readouterr().err == f"… {STORED}\n"
    assert started == [True]


def test_compilation_after_the_plan_starts_no_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "machopt.planning.kernel_precompilation.start_compile_process", lambda: pytest.fail("nobody would end it")
    )
    with ProgressDisplay(show=False) as display, compilation_notice.announce_compilation(display):
        pass
    module._LISTENER.on_start(None)


def test_second_process_compiles_on_a_free_core(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []

    def start(words: list[str], **_: object) -> str:
        started.append(words)
        return "process"

    monkeypatch.setattr(subprocess, "Popen", start)
    for cores, answer in ((None, None), (1, None), (2, "process")):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert kernel_precompilation.start_compile_process() == answer
    assert started == [[sys.executable, "-m", "machopt.planning.kernel_precompilation"]]

    def none(*_: object, **__: object) -> None:
        raise OSError("no process to be had")

    monkeypatch.setattr(subprocess, "Popen", none)
    assert kernel_precompilation.start_compile_process() is None


def test_installation_processes_divide_the_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each module is compiled once, by the first free process; all are stored in the folder."""
    made: list[str] = []
    stored: list[str] = []
    monkeypatch.setattr(kernel_precompilation, "compile_all", lambda some: made.extend(module for module, *_ in some))
    monkeypatch.setattr(module, "enable_kernel_storage", lambda kernel, folder: stored.append(kernel.__name__))
    (tmp_path / "planning.external_axes.moving_axis_kernels.claimed").touch()
    kernel_precompilation.compile_into(tmp_path)
    wanted = [name for name, *_ in KERNELS + MORE]
    assert sorted(made) == sorted(name for name in wanted if name != "planning.external_axes.moving_axis_kernels")
    assert next(iter(dict.fromkeys(made))) == kernel_precompilation.LONGEST[0]
    assert len(stored) == len(wanted)
    kernel_precompilation.compile_into(tmp_path)
    assert len(made) == len([name for name in wanted if name != "planning.external_axes.moving_axis_kernels"])


def test_missing_cache_folder_is_reported_with_a_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module._LISTENER, "stored", True)
    monkeypatch.setattr(
        module._CallTreeCache._impl_class, "_locator_classes", []
    )  # numba finds no location and reports it
    module.jit_compile(lambda x: x)
    monkeypatch.setattr(
        "machopt.planning.kernel_precompilation.start_compile_process", lambda: pytest.fail("would store nothing")
    )
    with ProgressDisplay(show=True) as display, compilation_notice.announce_compilation(display):
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

"""Functions compiled by numba: found where the installation brought them, else stored on disk where there is a place
for it, elsewhere compiled in each process.

They hold no interpreter lock, so that threads can run them side by side."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import event
from numba.core.caching import FunctionCache, NullCache
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

F = TypeVar("F", bound=Callable[..., Any])
CompilationCallback = Callable[
    [bool], None
]  # called once, when something is compiled that was not stored; True: it will be stored
INSTALLED_FOLDER = Path(__file__).parents[1] / "kernels"  # made while a wheel is built; a source tree has none


class _CompilationListener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Hears of every function that numba really compiles; what it loads from disk makes no event."""

    def __init__(self) -> None:
        self.told: CompilationCallback | None = None
        self.stored = True

    def on_start(self, event: Any) -> None:
        if self.told is not None:
            told, self.told = self.told, None
            told(self.stored)

    def on_end(self, event: Any) -> None:
        """Nothing: only the beginning is told."""


_LISTENER = _CompilationListener()
event.register("numba:compile", _LISTENER)


@contextlib.contextmanager
def call_on_compilation(told: CompilationCallback) -> Iterator[None]:
    """Have ``told`` called when the next function is compiled in this block, and not after it."""
    _LISTENER.told = told
    try:
        yield
    finally:
        _LISTENER.told = None


def jit_compile(function: F) -> F:
    """``numba.njit``, cached where a folder may be written: a read-only installation and home are none."""
    made = numba.njit(nogil=True)(function)
    try:
        made._cache = _CallTreeCache(function)
    except RuntimeError:  # numba finds no folder it may write to
        _LISTENER.stored = False
    if INSTALLED_FOLDER.is_dir():
        made._cache = _InstalledCache(made.py_func, made._cache, INSTALLED_FOLDER)
    return made  # type: ignore[no-any-return]


def load_stored_kernel(kernel: Any, types: tuple[Any, ...]) -> bool:
    """Have a kernel's machine code for such arguments at hand before it is called; False where none is stored.

    What the first call would do, from any thread; but it compiles nothing.
    """
    with global_compiler_lock:
        if types in kernel.overloads:
            return True
        made = kernel._cache.load_overload(types, kernel.targetctx)
        if made is None:
            return False
        kernel._cache_hits[types] += 1
        kernel.targetctx.insert_user_function(made.entry_point, made.fndesc, [made.library])
        kernel.add_overload(made)
    return True


def enable_kernel_storage(kernel: Any, folder: Path) -> None:
    """From now on, write what is compiled of a kernel into a folder that an installation brings."""
    kernel._cache = _InstallationWriter(kernel.py_func, NullCache(), folder)


class _CallTreeCache(FunctionCache):  # type: ignore[misc]
    """numba's own store, which looks at the source of the function alone: here those it calls must be the same too.

    To load, it wants the memory of arrays alone, where numba takes in all that it compiles with (0.06 s of every
    command); what is compiled after all takes that in itself.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), tuple(hash_kernel_sources(self._py_func)))


class _InstalledCache(NullCache):  # type: ignore[misc]
    """What an installation brought of a function, and behind it where numba itself stores. Nothing is written here.

    A file is found by all that its machine code depends on: types, numba, Python, the processor, and the source of the
    function and of those it calls.
    """

    def __init__(self, function: Any, behind: Any, folder: Path) -> None:
        self.function, self.behind, self.folder = function, behind, folder

    @property
    def cache_path(self) -> Any:
        return self.behind.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        try:
            with self._file(sig, target_context.codegen()).open("rb") as file:
                return CompileResult._rebuild(target_context, *pickle.load(file))  # our own installation
        except FileNotFoundError:
            return self.behind.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        self.behind.save_overload(sig, data)

    def _file(self, types: Any, codegen: Any) -> Path:
        depends = (
            numba.__version__,
            sys.version_info[:3],
            types,
            codegen.magic_tuple(),
            hash_kernel_sources(self.function),
        )
        digest = hashlib.sha256(repr(depends).encode()).hexdigest()[:32]
        return self.folder / f"{self.function.__module__}.{self.function.__qualname__}-{digest}.machine"


class _InstallationWriter(_InstalledCache):
    """Writes it, while a wheel is built. Nothing is read: what was has no machine code left to write."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()

    def save_overload(self, sig: Any, data: Any) -> None:
        file = self._file(sig, data.codegen)
        own = file.with_suffix(f".{os.getpid()}")  # two processes may compile the same
        own.write_bytes(dumps(data._reduce()))
        own.replace(file)


def hash_kernel_sources(function: Any) -> list[str]:
    """Hashes of the files with a function and the compiled functions it calls, and the numbers they take in."""
    files: set[str] = set()
    numbers: set[str] = set()
    open_, seen = [function], {function}
    while open_:
        function = open_.pop()
        files.add(_hash_file(inspect.getfile(function)))
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if isinstance(value, CPUDispatcher):
                if value.py_func not in seen:
                    seen.add(value.py_func)
                    open_.append(value.py_func)
            elif isinstance(value, (int, float, tuple)):  # also one that another file defines
                numbers.add(f"{name}={value!r}")
    return sorted(files | numbers)


@functools.cache
def _hash_file(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()

"""Functions compiled by numba, with caches: from the installation, else on disk where possible, else per process.

They release the interpreter lock, so that threads can run them in parallel.
"""

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
INSTALLED_FOLDER = Path(__file__).parents[1] / "kernels"  # created while a wheel is built; a source tree has none


class _CompilationListener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Listener for functions that numba really compiles; loading from disk causes no event."""

    def __init__(self) -> None:
        self.callback: CompilationCallback | None = None
        self.stored = True

    def on_start(self, event: Any) -> None:
        """Call the callback once.

        Args:
            event: not used.
        """
        if self.callback is not None:
            message, self.callback = self.callback, None
            message(self.stored)

    def on_end(self, event: Any) -> None:
        """Do nothing: only the start is reported.

        Args:
            event: not used.
        """


_LISTENER = _CompilationListener()
event.register("numba:compile", _LISTENER)


@contextlib.contextmanager
def call_on_compilation(callback: CompilationCallback) -> Iterator[None]:
    """Call a function when the next function is compiled inside the block, once.

    Args:
        callback: callback; its argument is whether the compiled code will be stored.
    """
    _LISTENER.callback = callback
    try:
        yield
    finally:
        _LISTENER.callback = None


def jit_compile(function: F) -> F:
    """Compile a function with ``numba.njit``, cached where a folder is writable.

    Args:
        function: function to compile.
    """
    return _compile(function, fastmath=False)


def jit_compile_reordering(function: F) -> F:
    """Compile a function as :func:`jit_compile` does, with sums and maxima in any order: several elements at once.

    Args:
        function: function to compile; its numbers are never NaN.
    """
    return _compile(function, fastmath={"nnan", "nsz", "reassoc"})


def _compile(function: F, fastmath: bool | set[str]) -> F:
    compiled = numba.njit(nogil=True, fastmath=fastmath)(function)
    try:
        compiled._cache = _CallTreeCache(function)
    except RuntimeError:  # numba finds no writable folder
        _LISTENER.stored = False
    if INSTALLED_FOLDER.is_dir():
        compiled._cache = _InstalledCache(compiled.py_func, compiled._cache, INSTALLED_FOLDER)
    return compiled  # type: ignore[no-any-return]


def load_stored_kernel(kernel: Any, types: tuple[Any, ...]) -> bool:
    """Load a kernel's machine code before its first call; return False where none is stored.

    It does the same as the first call, from any thread, but compiles nothing.

    Args:
        kernel: compiled function.
        types: numba types of its arguments.
    """
    with global_compiler_lock:
        if types in kernel.overloads:
            return True
        loaded = kernel._cache.load_overload(types, kernel.targetctx)
        if loaded is None:
            return False
        kernel._cache_hits[types] += 1
        kernel.targetctx.insert_user_function(loaded.entry_point, loaded.fndesc, [loaded.library])
        kernel.add_overload(loaded)
    return True


def enable_kernel_storage(kernel: Any, folder: Path) -> None:
    """Write the compiled code of a kernel into a folder of an installation from now on.

    Args:
        kernel: compiled function.
        folder: folder of the installation.
    """
    kernel._cache = _InstallationWriter(kernel.py_func, NullCache(), folder)


class _CallTreeCache(FunctionCache):  # type: ignore[misc]
    """numba's cache, which hashes only the source of the function; here the source of called functions counts too.

    Loading initialises the memory management of arrays only, while numba initialises its whole compiler (0.06 s per
    command); a later compilation initialises the rest itself.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load stored machine code; None where there is none.

        Args:
            sig: numba types of the arguments.
            target_context: numba target context.
        """
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), tuple(hash_kernel_sources(self._py_func)))


class _InstalledCache(NullCache):  # type: ignore[misc]
    """Read-only cache of an installation, followed by numba's own cache.

    A file is found by all that its machine code depends on: types, numba, Python, the processor, and the source of the
    function and of those it calls.
    """

    def __init__(self, function: Any, behind: Any, folder: Path) -> None:
        self.function, self.behind, self.folder = function, behind, folder

    @property
    def cache_path(self) -> Any:
        return self.behind.cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load machine code of the installation, else of numba's own cache.

        Args:
            sig: numba types of the arguments.
            target_context: numba target context.
        """
        rtsys.initialize(target_context)
        try:
            with self._get_file(sig, target_context.codegen()).open("rb") as file:
                return CompileResult._rebuild(target_context, *pickle.load(file))  # our own installation
        except FileNotFoundError:
            return self.behind.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store machine code in numba's own cache.

        Args:
            sig: numba types of the arguments.
            data: compiled code.
        """
        self.behind.save_overload(sig, data)

    def _get_file(self, types: Any, codegen: Any) -> Path:
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
    """Writer of the installation's cache while a wheel is built. It reads nothing, because loaded code cannot be
    written.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load nothing; only refresh the target context.

        Args:
            sig: not used.
            target_context: numba target context.
        """
        target_context.refresh()

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write machine code into the folder of the installation.

        Args:
            sig: numba types of the arguments.
            data: compiled code.
        """
        file = self._get_file(sig, data.codegen)
        own = file.with_suffix(f".{os.getpid()}")  # two processes may compile the same
        own.write_bytes(dumps(data._reduce()))
        own.replace(file)


def hash_kernel_sources(function: Any) -> list[str]:
    """Return hashes of the files with a function and the compiled functions it calls, and the constants they use.

    Args:
        function: Python function of a kernel.
    """
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

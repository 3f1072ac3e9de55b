"""Output folders that are whole or not there: written into a temporary sibling, renamed at the end."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import signal
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from machopt.errors import InputError

RESULT_FILES = ("result.json", "identification.json", "diagnosis.json", "plan.json", "map.json", "batch.json")
"""A folder is ours, and may be replaced, if one of these is a JSON object with a key machopt…"""


@contextlib.contextmanager
def output_folder(path: Path | str) -> Iterator[Path]:
    """Yield a temporary sibling of ``path``; rename it to ``path`` on success, remove it on any failure.

    An existing ``path`` is replaced only if it is an empty folder or an earlier machopt output. Ctrl-C and
    SIGTERM inside the block remove the temporary folder; while the rename runs they wait until it is done.
    Only SIGKILL leaves the temporary sibling (a hidden ``.name.partial-…``), never a half-written ``path``.

    Raises:
        InputError: ``path`` is a file, a folder that is not ours, or the working directory.
    """
    target = Path(path).expanduser().resolve()
    _refuse_foreign(target, Path(path))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = _new_sibling(target, "partial")
    except OSError as error:
        raise InputError(f"the output folder cannot be created: {error.strerror}", file=path) from None
    with _Signals() as signals:
        try:
            try:
                yield partial
            except Exception:
                signals.again()  # compiled code turns the exception of a signal into one of its own
                raise
            signals.hold()
            _refuse_foreign(target, Path(path))  # it may have appeared meanwhile
            _swap(partial, target)
        finally:
            signals.hold()
            shutil.rmtree(partial, ignore_errors=True)


def write_json(path: Path, value: Mapping[str, object]) -> None:
    """Write JSON with the keys in the given order, one-space indent, NaN and infinities as null.

    NumPy scalars and arrays, tuples and paths are taken as they come; anything else is refused.
    """
    text = json.dumps(_plain(value), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", newline="\n")


def is_machopt_output(folder: Path) -> bool:
    """True if ``folder`` carries a result file of ours."""
    return any(_carries_our_key(folder / name) for name in RESULT_FILES)


def _carries_our_key(file: Path) -> bool:
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(value, dict) and any(str(key).startswith("machopt") for key in value)


def _refuse_foreign(target: Path, named: Path) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise InputError("is a file; a folder that is new, empty or an earlier output would work", file=named)
    here = Path.cwd()
    if target == here or target in here.parents:
        raise InputError("is the working directory or above it; name a folder inside it", file=named)
    if any(target.iterdir()) and not is_machopt_output(target):
        raise InputError(
            f"exists and is not an earlier machopt output (none of {', '.join(RESULT_FILES)} of ours in it); "
            "name a new folder, or empty this one",
            file=named,
        )


def _new_sibling(target: Path, kind: str) -> Path:
    for number in range(1000):
        sibling = target.parent / f".{target.name}.{kind}-{os.getpid()}-{number}"
        with contextlib.suppress(FileExistsError):
            sibling.mkdir()
            return sibling
    raise OSError(f"no free name for a temporary folder beside {target}")


def _swap(partial: Path, target: Path) -> None:
    """Put ``partial`` in the place of ``target``; an existing target comes back if the rename fails."""
    if not target.exists():
        partial.rename(target)
        return
    old = _new_sibling(target, "old")
    target.rename(old / target.name)
    try:
        partial.rename(target)
    except OSError:
        (old / target.name).rename(target)
        old.rmdir()
        raise
    shutil.rmtree(old, ignore_errors=True)


class _Signals:
    """Turn SIGTERM into an exception like Ctrl-C's, and hold both back once asked to.

    Handlers are process-wide and belong to the main thread: elsewhere, or where the program has its own
    handler, nothing is touched.
    """

    def __init__(self) -> None:
        self._held = False
        self._came: int | None = None
        self._waiting: list[int] = []
        self._former: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():
            defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
            for number, default in defaults.items():
                if signal.getsignal(number) == default:
                    self._former[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)
        for number in self._waiting:
            self._raise(number)

    def hold(self) -> None:
        """From here to the end of the block, signals wait."""
        self._held = True

    def again(self) -> None:
        """Raise for a signal that has come already."""
        if self._came is not None:
            self._raise(self._came)

    def _on_signal(self, number: int, _: FrameType | None) -> None:
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


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return value.as_posix()
    if value is None or isinstance(value, str | bool | int):
        return value
    raise TypeError(f"{type(value).__name__} has no JSON form here: {value!r}")

"""A threshold that notes what it is held against, and passes for the number that it is.

``watching()`` puts such numbers into the tables that ``machopt.measurement.diagnosis.thresholds`` lists. Each carries,
through sums,
products, powers, roots, ``max`` and ``min``, how to get back from what has become of it to the threshold alone: where
``x > k * bar`` is asked, ``x / k`` is the value of the threshold at which the answer would change. Whatever else numpy
or a kernel does with it, it does with the plain number: such a threshold was read and never held against anything.
"""

from __future__ import annotations

import builtins
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from types import ModuleType
from typing import Any

import numpy as np

Back = Callable[
    [Any], Any
]  # from what has become of the threshold to the threshold; not a number where nothing leads back
COMPARED = (np.less, np.less_equal, np.greater, np.greater_equal)


@dataclass
class Seen:
    """What one threshold was held against: the values of itself at which an answer would change."""

    value: float
    asked: int = 0  # numbers it was held against
    below: float = -np.inf  # the nearest of them
    above: float = np.inf
    lower: int = 0  # how many lie on either side
    higher: int = 0
    read: int = 0  # taken from its table
    where: set[str] = field(default_factory=set)

    def note(self, at: Any, where: str) -> None:
        at = np.asarray(at, dtype=float).ravel()
        at = at[np.isfinite(at)]
        if not len(at):
            return
        self.asked += len(at)
        self.where.add(where)
        low, high = at[at <= self.value], at[at > self.value]
        self.lower, self.higher = self.lower + len(low), self.higher + len(high)
        self.below = max(self.below, float(low.max(initial=-np.inf)))
        self.above = min(self.above, float(high.min(initial=np.inf)))


Log = dict[str, Seen]


class _Watched:
    """Arithmetic that a float, an int and an array share."""

    log: Log
    back: dict[str, Back]

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        given = [plain(x) for x in inputs]
        if "out" in more:
            more["out"] = tuple(plain(x) for x in more["out"])
        with np.errstate(all="ignore"):
            out = getattr(ufunc, method)(*given, **more)
        if method != "__call__" or more or ufunc.nout != 1:
            return out
        for k, x in enumerate(inputs):
            if isinstance(x, _Watched) and ufunc in COMPARED:
                _note(x, given[1 - k])
        back: dict[str, Back] = {}
        for k, x in enumerate(inputs):
            inverse = _inverse(ufunc, k, given) if isinstance(x, _Watched) else None
            if inverse is not None:
                back |= {name: _after(b, inverse) for name, b in x.back.items()}
        return _made(out, next(x for x in inputs if isinstance(x, _Watched)).log, back) if back else out

    def __lt__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.less, "__call__", self, other)

    def __le__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.less_equal, "__call__", self, other)

    def __gt__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.greater, "__call__", self, other)

    def __ge__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.greater_equal, "__call__", self, other)

    def __add__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.add, "__call__", self, other)

    def __radd__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.add, "__call__", other, self)

    def __sub__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.subtract, "__call__", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.subtract, "__call__", other, self)

    def __mul__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.multiply, "__call__", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.multiply, "__call__", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.true_divide, "__call__", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.true_divide, "__call__", other, self)

    def __pow__(self, other: Any) -> Any:
        return self.__array_ufunc__(np.power, "__call__", self, other)

    def __neg__(self) -> Any:
        return self.__array_ufunc__(np.negative, "__call__", self)


class WatchedFloat(_Watched, float):
    """A number with a point."""


class WatchedInt(_Watched, int):
    """A count: stays one where numpy asks for one."""


class WatchedArray(_Watched, np.ndarray):
    """A threshold times an array."""

    def __array_finalize__(self, other: Any) -> None:
        self.log, self.back = getattr(other, "log", {}), {}  # a part or another shape of it leads nowhere


def plain(x: Any) -> Any:
    if isinstance(x, WatchedInt):
        return int(x)
    if isinstance(x, WatchedFloat):
        return float(x)
    return x.view(np.ndarray) if isinstance(x, WatchedArray) else x


def _made(value: Any, log: Log, back: dict[str, Back]) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        out: Any = value.view(WatchedArray)
    elif np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fi":
        out = WatchedFloat(float(value))
    else:
        return value
    out.log, out.back = log, back
    return out


def _after(back: Back, inverse: Back) -> Back:
    return lambda v: back(inverse(v))


def _inverse(ufunc: Any, k: int, given: list[Any]) -> Back | None:
    """How to get from the result of a ufunc back to its argument ``k``."""
    if ufunc is np.sqrt:
        return lambda v: np.where(np.asarray(v) >= 0.0, np.square(v), np.nan)
    if ufunc in (np.square, np.negative, np.log, np.radians, np.degrees):
        of = {np.square: _root(2), np.negative: np.negative, np.log: np.exp, np.radians: np.degrees}
        return of.get(ufunc, np.radians)  # type: ignore[arg-type,return-value]
    if len(given) != 2:
        return None
    c = given[1 - k]
    if ufunc is np.add:
        return lambda v: v - c
    if ufunc is np.subtract:
        return (lambda v: v + c) if k == 0 else (lambda v: c - v)
    if ufunc is np.multiply:
        return lambda v: np.where(np.asarray(c) == 0, np.nan, v / np.where(np.asarray(c) == 0, 1.0, c))
    if ufunc is np.true_divide:
        return (lambda v: v * c) if k == 0 else (lambda v: np.divide(c, v))
    if ufunc is np.power and k == 0:
        return _root(c)
    if ufunc is np.maximum:
        return lambda v: np.where(np.asarray(v) >= c, v, np.nan)
    if ufunc is np.minimum:
        return lambda v: np.where(np.asarray(v) <= c, v, np.nan)
    return None


def _root(power: Any) -> Back:
    return lambda v: np.where(np.asarray(v) >= 0.0, np.power(np.maximum(v, 0.0), 1.0 / power), np.nan)


def _note(watched: Any, other: Any) -> None:
    where = _where()
    for name, back in watched.back.items():
        with np.errstate(all="ignore"):
            watched.log[name].note(back(np.asarray(other, dtype=float)), where)


def _where() -> str:
    """The line of machopt that asks."""
    frame = sys._getframe(1)
    while frame is not None and "/machopt/" not in frame.f_code.co_filename:
        frame = frame.f_back  # type: ignore[assignment]
    if frame is None:
        return "?"
    return f"{frame.f_code.co_filename.split('/machopt/')[-1]}:{frame.f_lineno}"


def _largest(*values: Any, **more: Any) -> Any:
    if more or len(values) < 2 or not any(isinstance(v, _Watched) for v in values):
        return builtins.max(*values, **more)
    out = values[0]
    for v in values[1:]:
        out = np.maximum(out, v)
    return out


def _smallest(*values: Any, **more: Any) -> Any:
    if more or len(values) < 2 or not any(isinstance(v, _Watched) for v in values):
        return builtins.min(*values, **more)
    out = values[0]
    for v in values[1:]:
        out = np.minimum(out, v)
    return out


class _Reading:
    """A table that counts what is taken from it."""

    def __init__(self, table: Any, concern: str, log: Log) -> None:
        self._of = {f.name: _threshold(getattr(table, f.name), f"{concern}.{f.name}", log) for f in fields(table)}
        self._log, self._concern = log, concern

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        self._log[f"{self._concern}.{name}"].read += 1
        return self._of[name]


def _threshold(value: Any, name: str, log: Log) -> Any:
    out: Any = WatchedInt(value) if isinstance(value, int) else WatchedFloat(value)
    out.log, out.back = log, {name: lambda v: v}
    return out


@contextmanager
def watching() -> Iterator[Log]:
    """The tables of thresholds note what they are held against, into the log, for so long."""
    kept = _tables()
    owners = {id(module) for module, _ in kept.values()}
    asking = [
        m for n, m in sys.modules.items() if n.startswith("machopt.") and id(getattr(m, "thresholds", 0)) in owners
    ]
    log = {f"{c.lower()}.{f.name}": Seen(float(getattr(t, f.name))) for c, (_, t) in kept.items() for f in fields(t)}
    try:
        for concern, (module, table) in kept.items():
            setattr(module, concern, _Reading(table, concern.lower(), log))
        for m in asking:
            vars(m).update(max=_largest, min=_smallest)
        yield log
    finally:
        _put_back(kept)
        for m in asking:
            del vars(m)["max"], vars(m)["min"]


@contextmanager
def otherwise(values: dict[str, float]) -> Iterator[None]:
    """Thresholds (``detection.gain``) at other values for so long."""
    kept = _tables()
    try:
        for name, value in values.items():
            concern, _, number = name.partition(".")
            module = kept[concern.upper()][0]
            table = getattr(module, concern.upper())
            changed = replace(table, **{number: type(getattr(table, number))(value)})
            setattr(module, concern.upper(), changed)
        yield
    finally:
        _put_back(kept)


def _tables() -> dict[str, tuple[ModuleType, Any]]:
    """Where each table stands, and the table."""
    from machopt.measurement.diagnosis import thresholds

    return {concern: (module, getattr(module, concern)) for concern, module in thresholds.TABLES.items()}


def _put_back(kept: dict[str, tuple[ModuleType, Any]]) -> None:
    for concern, (module, table) in kept.items():
        setattr(module, concern, table)

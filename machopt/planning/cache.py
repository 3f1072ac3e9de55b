"""Results of steps kept from one plan to the next, by everything they follow from: a steered job is planned again with
most of its runs as they were.

A step asks for its result with the very inputs it hangs on, arrays by their bytes. So what is taken from an earlier
plan is, to the last bit, what would be computed now; whoever plans without a store computes it. ``view`` keeps one from
plan to plan; a job with external joints has one for itself, as a motion is tried before its plan is taken.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Hashable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from machopt.data_types.plan_options import (
    ExternalJointOptions,
    FixedRotation,
    ObjectiveWeights,
    PlanOptions,
    ProcessForce,
    SteeringRule,
)

T = TypeVar("T")
UNUSED = 2  # plans after which a result that none of them asked for is forgotten


@dataclass
class StepCache:
    """What steps came to, and how often that was asked for again."""

    results: dict[Hashable, Any] = field(default_factory=dict)
    used: dict[Hashable, int] = field(default_factory=dict)  # the last plan that asked
    plan: int = 0
    found: dict[str, int] = field(default_factory=dict)  # by step, of the plan at work
    made: dict[str, int] = field(default_factory=dict)


_AT_WORK: ContextVar[StepCache | None] = ContextVar("store", default=None)


@contextlib.contextmanager
def use_step_cache(store: StepCache) -> Iterator[None]:
    """Plan with a store; afterwards it forgets what the last UNUSED plans had no use for."""
    store.plan += 1
    store.found, store.made = {}, {}
    token = _AT_WORK.set(store)
    try:
        yield
    finally:
        _AT_WORK.reset(token)
        for key in [k for k, plan in store.used.items() if plan < store.plan - UNUSED]:
            del store.results[key], store.used[key]


@contextlib.contextmanager
def use_temporary_cache() -> Iterator[None]:
    """Plan with the store at work, or with one that is dropped afterwards."""
    with contextlib.nullcontext() if _AT_WORK.get() is not None else use_step_cache(StepCache()):
        yield


def is_cache_active() -> bool:
    """A store is at work, so that steps are worth being asked for in small parts."""
    return _AT_WORK.get() is not None


def compute_cached(step: str, inputs: Callable[[], tuple[object, ...]], make: Callable[[], T]) -> T:
    """The result of a step, from the store where it has it.

    Args:
        step: its name.
        inputs: gives all it follows from: numbers, words, frozen options, arrays, tuples of these, and objects made
            once for a job (robot, model, limits), which count as the same only where they are the very same.
        make: computes it. Its arrays are made read-only: nobody may change what others are given, too.
    """
    store = _AT_WORK.get()
    if store is None:
        return make()
    key = (step, _key(inputs()))
    if key not in store.results:
        store.results[key] = _frozen(make())
        store.made[step] = store.made.get(step, 0) + 1
    else:
        store.found[step] = store.found.get(step, 0) + 1
    store.used[key] = store.plan
    result: T = store.results[key]
    return result


@dataclass(frozen=True)
class _Very:
    """One object, and no other that is equal to it; held, so that nothing else takes its place in memory."""

    one: Any = field(hash=False, compare=False)
    place: int


def _key(value: object) -> Hashable:
    if isinstance(value, np.ndarray):
        digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=16).digest()
        return value.dtype.str, value.shape, digest
    if isinstance(value, tuple | list):
        return tuple(_key(v) for v in value)
    if value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        return type(value).__name__, value
    if isinstance(
        value, PlanOptions | ProcessForce | ObjectiveWeights | ExternalJointOptions | SteeringRule | FixedRotation
    ):
        return value  # frozen, of numbers and words
    return _Very(value, id(value))


def _frozen(value: T) -> T:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple):
        for v in value:
            _frozen(v)
    elif is_dataclass(value):
        for f in fields(value):
            _frozen(getattr(value, f.name))
    return value

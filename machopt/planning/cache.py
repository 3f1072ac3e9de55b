"""Cache of step results between plans, keyed by all inputs of a step: a re-planned job reuses its unchanged runs.

A step passes every input it depends on; arrays are hashed by their bytes. A cached result is therefore identical, to
the
last bit, to a newly computed one. Without an active cache each step computes its result. ``view`` keeps one cache
from plan to plan. A job with external joints has its own cache, because a motion is tried before its plan is accepted.
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
UNUSED = 2  # number of plans without use after which a result is removed


@dataclass
class StepCache:
    """Results of steps and the number of cache hits and misses."""

    results: dict[Hashable, Any] = field(default_factory=dict)
    used: dict[Hashable, int] = field(default_factory=dict)  # number of the last plan that used the result
    plan: int = 0  # number of the current plan
    found: dict[str, int] = field(default_factory=dict)  # cache hits of the current plan by step
    made: dict[str, int] = field(default_factory=dict)  # cache misses of the current plan by step


_AT_WORK: ContextVar[StepCache | None] = ContextVar("store", default=None)


@contextlib.contextmanager
def use_step_cache(cache: StepCache) -> Iterator[None]:
    """Activate a cache for the block; afterwards remove results that the last UNUSED plans did not use.

    Args:
        cache: cache to read from and to fill.
    """
    cache.plan += 1
    cache.found, cache.made = {}, {}
    token = _AT_WORK.set(cache)
    try:
        yield
    finally:
        _AT_WORK.reset(token)
        for key in [k for k, plan in cache.used.items() if plan < cache.plan - UNUSED]:
            del cache.results[key], cache.used[key]


@contextlib.contextmanager
def use_temporary_cache() -> Iterator[None]:
    """Use the active cache, or a temporary one that is discarded after the block."""
    with contextlib.nullcontext() if _AT_WORK.get() is not None else use_step_cache(StepCache()):
        yield


def is_cache_active() -> bool:
    """Return whether a cache is active, so that it pays to request steps in small parts."""
    return _AT_WORK.get() is not None


def compute_cached(step: str, inputs: Callable[[], tuple[object, ...]], make: Callable[[], T]) -> T:
    """Return the result of a step, from the active cache where it is stored.

    Args:
        step: name of the step.
        inputs: returns everything the result depends on: numbers, strings, frozen options, arrays, tuples of these, and
            objects created once per job (robot, model, limits). Such objects are compared by identity.
        make: computes the result. Its arrays are made read-only, because later callers receive the same arrays.

    Returns:
        The stored or newly computed result.
    """
    store = _AT_WORK.get()
    if store is None:
        return make()
    key = (step, _build_key(inputs()))
    if key not in store.results:
        store.results[key] = _freeze(make())
        store.made[step] = store.made.get(step, 0) + 1
    else:
        store.found[step] = store.found.get(step, 0) + 1
    store.used[key] = store.plan
    result: T = store.results[key]
    return result


@dataclass(frozen=True)
class _Very:
    """Identity key of one object; it keeps a reference, so that no other object reuses the address."""

    one: Any = field(hash=False, compare=False)
    place: int


def _build_key(value: object) -> Hashable:
    if isinstance(value, np.ndarray):
        digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=16).digest()
        return value.dtype.str, value.shape, digest
    if isinstance(value, tuple | list):
        return tuple(_build_key(v) for v in value)
    if value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        return type(value).__name__, value
    if isinstance(
        value, PlanOptions | ProcessForce | ObjectiveWeights | ExternalJointOptions | SteeringRule | FixedRotation
    ):
        return value  # frozen, with numbers and strings only
    return _Very(value, id(value))


def _freeze(value: T) -> T:
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple):
        for v in value:
            _freeze(v)
    elif is_dataclass(value):
        for f in fields(value):
            _freeze(getattr(value, f.name))
    return value

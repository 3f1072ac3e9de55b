"""How the foreign lab's instruments err: fat tails, wandering, bias a session, coarse digits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dual_quaternions import Array


@dataclass(frozen=True)
class Instrument:
    """One quantity's errors, 1 sigma in its own unit."""

    reading: float  # of one reading
    shared: float = 0.0  # of all readings of a load cycle or visit: the zero that was read before them
    tails: float = 6.0  # degrees of freedom of Student's t
    wander: float = 0.0  # share of ``reading`` that is a first-order process in the order of the rows
    memory: float = 6.0  # rows over which that falls to 1/e
    step: float = 0.0  # last digit


def errors(kind: Instrument, groups: Array, width: int, rng: np.random.Generator) -> Array:
    """(N, width) errors of N readings; ``groups`` (N,) tells which share a zero."""
    n = len(groups)
    own = rng.standard_t(kind.tails, (n, width)) * np.sqrt((kind.tails - 2) / kind.tails)
    if kind.wander > 0:
        keep = np.exp(-1.0 / kind.memory)
        slow = np.zeros((n, width))
        value = rng.normal(size=width)
        for k in range(n):
            value = keep * value + np.sqrt(1 - keep**2) * rng.normal(size=width)
            slow[k] = value
        own = np.sqrt(1 - kind.wander**2) * own + kind.wander * slow
    out = kind.reading * own
    if kind.shared > 0:
        labels, which = np.unique(groups, return_inverse=True)
        out = out + kind.shared * rng.normal(size=(len(labels), width))[which]
    return np.asarray(out)


def rounded(values: Array, step: float) -> Array:
    """To the instrument's last digit."""
    return values if step <= 0 else np.round(values / step) * step

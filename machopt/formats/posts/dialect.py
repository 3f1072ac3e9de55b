"""What one maker's posts add to the common fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from machopt.arrays import Array
from machopt.formats.posts.columns import ROUNDED, Job
from machopt.formats.posts.template import Column, Value


@dataclass(frozen=True)
class Passing:
    """How a controller passes the ends of moves, as the feed model takes it."""

    distance: Array  # (M,) m before and behind the point at which it may leave the line, 0 for an exact stop
    cap: Array  # (M,) m/s that the termination itself allows, inf for none


def zones(job: Job, used: frozenset[str]) -> Passing:
    """Makers whose zone is a distance that the post prints; without such a field every end is an exact stop."""
    distance = job.blend if used & ROUNDED else np.zeros(len(job.program))
    return Passing(distance, np.full(len(job.program), np.inf))


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """Fields and remarks of one maker; every function takes the job."""

    columns: Callable[[Job], Mapping[str, Callable[[], Column]]] = lambda _: {}
    values: Callable[[Job], Mapping[str, Value]] = lambda _: {}
    notes: Callable[[Job, frozenset[str]], Sequence[str]] = lambda _, __: ()
    """Remarks for the head of the program; the names tell which fields the post uses."""
    assumed: Callable[[Job, frozenset[str]], Sequence[str]] = lambda _, __: ()
    """What is taken because the cell does not say it, beside what is common to all makers."""
    check: Callable[[Job, frozenset[str]], None] = lambda _, __: None
    """Raises InputError where a field that the post uses cannot be had."""
    passing: Callable[[Job, frozenset[str]], Passing] = zones
    """How it passes corners; see :mod:`machopt.formats.posts.feedmodel`."""
    absent: Mapping[str, str] = field(default_factory=dict)
    """Why a field may have no value, and what would work; said where a template cannot do without it."""
    coupled: bool = False  # the controller itself computes the tool's place with rail and positioner
    maker: bool = True  # False: angles are the URDF's, whatever the cell's joint map says

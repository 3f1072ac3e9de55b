"""Rules that the posts of one maker add to the common fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from machopt.numerics.array_types import Array
from machopt.programs.writing.template_fields import ROUNDED, PostJob
from machopt.programs.writing.template_language import TemplateColumn, TemplateValue


@dataclass(frozen=True)
class CornerPassing:
    """How a controller passes the ends of moves, as the feed model takes it."""

    distance: Array  # (M,) m before and behind the point at which it may leave the line, 0 for an exact stop
    cap: Array  # (M,) m/s that the termination itself allows, inf for none


def compute_zone_passing(job: PostJob, used: frozenset[str]) -> CornerPassing:
    """Compute corner passing of makers whose zone is a printed distance; without it every end is an exact stop.

    Args:
        job: Program, controller, axis values and blend zones.
        used: Names of the template fields that the post uses.

    Returns:
        Zone distance in m and passing speed limit of each move.
    """
    distance = job.blend if used & ROUNDED else np.zeros(len(job.program))
    return CornerPassing(distance, np.full(len(job.program), np.inf))


@dataclass(frozen=True, kw_only=True)
class MakerRules:
    """Fields and remarks of one maker; every function takes the job."""

    columns: Callable[[PostJob], Mapping[str, Callable[[], TemplateColumn]]] = lambda _: {}
    values: Callable[[PostJob], Mapping[str, TemplateValue]] = lambda _: {}
    notes: Callable[[PostJob, frozenset[str]], Sequence[str]] = lambda _, __: ()
    """Remarks for the head of the program; the names tell which fields the post uses."""
    assumptions: Callable[[PostJob, frozenset[str]], Sequence[str]] = lambda _, __: ()
    """What is taken because the cell does not state it, beside what is common to all makers."""
    check: Callable[[PostJob, frozenset[str]], None] = lambda _, __: None
    """Raises InputError where a field that the post uses cannot be had."""
    passing: Callable[[PostJob, frozenset[str]], CornerPassing] = compute_zone_passing
    """How it passes corners; see :mod:`machopt.programs.writing.feed_model`."""
    absent: Mapping[str, str] = field(default_factory=dict)
    """Why a field may have no value, and what is accepted; used in the error where a template requires it."""
    coupled: bool = False  # the controller itself computes the tool's place with rail and positioner
    rapid_stops: Callable[[PostJob], str] = lambda _: ""
    """Why rapid moves stop at each point, where no bound is known of the maker's rounding; empty where they run on."""
    maker: bool = True  # False: angles are the URDF's, independent of the cell's joint map

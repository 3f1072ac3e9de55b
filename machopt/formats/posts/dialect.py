"""What one maker's posts add to the common fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from machopt.formats.posts.columns import Job
from machopt.formats.posts.template import Column, Value


@dataclass(frozen=True)
class Dialect:
    """Fields and remarks of one maker; every function takes the job."""

    columns: Callable[[Job], Mapping[str, Callable[[], Column]]] = lambda _: {}
    values: Callable[[Job], Mapping[str, Value]] = lambda _: {}
    notes: Callable[[Job, frozenset[str]], Sequence[str]] = lambda _, __: ()
    """Remarks for the head of the program; the names tell which fields the post uses."""
    check: Callable[[Job, frozenset[str]], None] = lambda _, __: None
    """Raises InputError where a field that the post uses cannot be had."""
    absent: Mapping[str, str] = field(default_factory=dict)
    """Why a field may have no value, and what would work; said where a template cannot do without it."""
    maker: bool = True  # False: angles are the URDF's, whatever the cell's joint map says

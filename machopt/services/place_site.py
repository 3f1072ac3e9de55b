"""Cell and jobs of ``machopt place``, loaded; here, or by another process that was told only what was asked."""

from __future__ import annotations

import functools
import pickle
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.effects.own import in_use, with_effects
from machopt.formats.absolute_accuracy import apply_absolute_accuracy
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.setups import placed
from machopt.formats.toolchoice import stints_of, with_tools
from machopt.formats.toolpath import read_toolpath
from machopt.formats.unknownwords import refuse_unknown_words
from machopt.placement.moved import refuse
from machopt.placement.search import Site
from machopt.services.knownrobot import reading_of
from machopt.services.place_asked import PlaceRequest, refuse_options

A = TypeVar("A")
B = TypeVar("B")
_one_at_a_time = threading.Lock()  # a worker of a cluster may have threads; a plan uses the cores by itself


def read(request: PlaceRequest) -> tuple[Cell, tuple[Toolpath, ...]]:
    """The files that the request names.

    Raises:
        InputError: a file is wrong.
    """
    cell = load_cell(request.cell)
    pairs = zip(request.toolpaths, request.readings, strict=True)
    return cell, tuple(read_toolpath(file, **reading_of(cell), **reading) for file, reading in pairs)


def site_of(request: PlaceRequest, cell: Cell, toolpaths: tuple[Toolpath, ...]) -> tuple[Site, PlanOptions]:
    """What is looked at from everywhere.

    Raises:
        InputError: the cell, an option or a range is wrong.
    """
    refuse(cell, base=request.search.base)
    for toolpath, file in zip(toolpaths, request.toolpaths, strict=True):
        refuse_unknown_words(toolpath, file)
    toolpaths = tuple(placed(toolpath, cell) for toolpath in toolpaths)
    stints = [stints_of(with_tools(cell, toolpath), toolpath) for toolpath in toolpaths]
    options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
    refuse_options(options)
    cell = apply_absolute_accuracy(cell, options)
    return Site.of(cell, toolpaths, options, request.search, stints), options


def answer(order: bytes, ask: Callable[[Any, A], B], item: A) -> B:
    """Answer one question in a process that may never have heard of the site: ``order`` is the pickled request."""
    with _one_at_a_time:
        request, site = _known(order)
        with in_use(with_effects(request.effects)):
            return ask(site, item)


@functools.lru_cache(maxsize=1)
def _known(order: bytes) -> tuple[PlaceRequest, Site]:
    request: PlaceRequest = pickle.loads(order)
    with in_use(with_effects(request.effects)):
        return request, site_of(request, *read(request))[0]

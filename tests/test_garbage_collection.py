"""Garbage collection is postponed during imports, and imported objects are frozen."""

from __future__ import annotations

import gc

from machopt.cli import garbage_collection


def test_loaded_objects_are_frozen_once() -> None:
    before, frozen = gc.get_threshold(), gc.get_freeze_count()
    garbage_collection._freeze_existing_objects.cache_clear()
    try:
        garbage_collection.pause_garbage_collection()
        assert gc.get_threshold()[0] == garbage_collection.LOADING_THRESHOLD
        garbage_collection.freeze_loaded_objects()
        first = gc.get_freeze_count()
        assert first > 0
        assert gc.get_threshold()[0] == garbage_collection.WORKING_THRESHOLDS
        more: list[list[int]] = [[] for _ in range(10_000)]
        garbage_collection.freeze_loaded_objects()
        assert gc.get_freeze_count() - first < len(more)
    finally:
        gc.set_threshold(*before)
        if not frozen:
            gc.unfreeze()
            garbage_collection._freeze_existing_objects.cache_clear()

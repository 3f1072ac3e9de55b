"""Settings of Python's garbage collector for short commands.

Loading the libraries creates a million permanent objects. Searching them again and again takes a tenth of a short
command. So the collector runs rarely while they are loaded, and they are excluded afterwards. Later collections may
then be frequent, so that cyclic references to large tables do not accumulate (30 MiB with a thousand points).
"""

from __future__ import annotations

import gc
from functools import cache

LOADING_THRESHOLD = 1_000_000  # objects made between two collections (Python's own: 700)
WORKING_THRESHOLDS = 50_000


def pause_garbage_collection() -> None:
    """Let the garbage collector run rarely while libraries are imported."""
    gc.set_threshold(LOADING_THRESHOLD, *gc.get_threshold()[1:])


def freeze_loaded_objects() -> None:
    """Exclude all existing objects from garbage collection, once in a process."""
    _freeze_existing_objects()
    gc.set_threshold(WORKING_THRESHOLDS, *gc.get_threshold()[1:])


@cache  # gc.get_freeze_count() would walk through all frozen objects: a twentieth of a short command
def _freeze_existing_objects() -> None:
    gc.freeze()

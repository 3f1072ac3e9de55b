"""When Python looks for circles of objects that nobody holds any more.

Loading the libraries makes a million objects that all stay, and looking through them again and again takes a tenth of
a short command. So none are looked for while they are loaded, and what has been loaded is left out of every later look,
which may then come so often that circles around large tables do not add up (30 MiB of a thousand points).
"""

from __future__ import annotations

import gc

LOADING_THRESHOLD = 1_000_000  # objects made between two looks (Python's own: 700)
WORKING_THRESHOLDS = 50_000


def pause_garbage_collection() -> None:
    """Libraries are about to be imported."""
    gc.set_threshold(LOADING_THRESHOLD, *gc.get_threshold()[1:])


def freeze_loaded_objects() -> None:
    """The work begins; what is there now stays. Once a process: what a second command finds is no library."""
    if gc.get_freeze_count() == 0:
        gc.freeze()
    gc.set_threshold(WORKING_THRESHOLDS, *gc.get_threshold()[1:])

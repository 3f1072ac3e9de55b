"""Reading options under the user's names, as a manifest records them and ``verify`` reads them again."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

_FEED, _PER_MINUTE = "feed_mm_min", 60e3


def format_reading_options(reading: Mapping[str, Any]) -> dict[str, object]:
    """Format the given keywords of ``read_toolpath`` under the user's names.

    Args:
        reading: Keywords of ``read_toolpath``, SI units.

    Returns:
        Name of the user → value; the feed in mm/min.
    """
    out: dict[str, Any] = {
        k: list(v) if isinstance(v, tuple) else v
        for k, v in reading.items()
        if v is not None and v is not False and v not in ((), [])  # 0 decimals are a given value
    }
    feed = out.pop("default_feed", None)
    return out if feed is None else {**out, _FEED: float(f"{feed * _PER_MINUTE:.12g}")}


def parse_reading_options(user: Mapping[str, Any]) -> dict[str, Any]:
    """Parse recorded reading options to keywords of ``read_toolpath``.

    Args:
        user: Name of the user → value, as recorded.

    Returns:
        Keywords, SI units.

    Raises:
        InputError: a key is unknown, or its value has the wrong type.
    """
    known = {_FEED if k == "default_feed" else k for k in inspect.signature(read_toolpath).parameters} - {
        "path",
        "robot",
    }
    for key, value in user.items():
        if key not in known:
            raise InputError(f"found {key!r}; known are {', '.join(sorted(known))}", where="reading")
        number = isinstance(value, int | float) and not isinstance(value, bool)
        words = isinstance(value, list) and all(isinstance(v, str) for v in value)
        if not (
            number
            if key.endswith(("_feed", "_mm_min", "_tolerance", "decimals", "max_extent"))
            else isinstance(value, str | bool) or words
        ):
            raise InputError(f"found {value!r}", where=f"reading.{key}")
    out: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in user.items()}
    feed = out.pop(_FEED, None)
    return out if feed is None else {**out, "default_feed": feed / _PER_MINUTE}

"""How a toolpath was read, under the user's names: what a manifest records and ``verify`` takes again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_FEED, _PER_MINUTE = "feed_mm_min", 60e3


def reading_as_user(reading: Mapping[str, Any]) -> dict[str, object]:
    """Keywords of ``read_toolpath`` that were given, the feed in mm/min."""
    out: dict[str, Any] = {
        k: list(v) if isinstance(v, tuple) else v for k, v in reading.items() if v not in (None, False, (), [])
    }
    feed = out.pop("default_feed", None)
    return out if feed is None else {**out, _FEED: float(f"{feed * _PER_MINUTE:.12g}")}


def reading_from_user(user: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords again, in SI."""
    out: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in user.items()}
    feed = out.pop(_FEED, None)
    return out if feed is None else {**out, "default_feed": feed / _PER_MINUTE}

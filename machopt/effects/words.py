"""Effects and places in words of the trade."""

from __future__ import annotations

from collections.abc import Sequence

from machopt.domain.location import ARM, BASE, COLUMN, JOINT, LINK, ROWS, SENSOR, TOOL, located
from machopt.effects import registry

_SENSORS = {
    "force": "force sensor",
    "displacement": "tracker",
    "tau": "torque channel",
    "qse": "link-side encoder",
    "q": "encoder",
    "qcmd": "command channel",
    "position": "tracker",
    "wrench": "force sensor",
    "current": "current",
    "qd": "velocity channel",
    "xyz": "tracker",
}
_MOST_ROWS = 6


def noun(effect: str) -> str:
    """ "hysteresis"; of a user's own its name without underscores."""
    known = registry.known(effect)
    return known.noun if known else effect.replace("_", " ")


def what(effect: str) -> str:
    """One sentence on what the effect is; empty for a user's own."""
    known = registry.known(effect)
    return known.sentence if known else ""


def place(location: str) -> str:
    """A location in words: ``joint:4-5`` is "joints 4 and 5"."""
    at = located(location)
    if at.of_joints and len(at.numbers) > 1:
        return "joints " + " and ".join(map(str, at.numbers))
    if at.kind in (JOINT, LINK):
        return f"{at.kind} {at.which}"
    if at.kind == SENSOR:
        return _SENSORS.get(at.which, f"channel {at.which}")
    if at.kind == COLUMN:
        return f"column {at.which}"
    if at.kind == ROWS:
        return _rows(at.which)
    return {"base": "base", "tool": "tool", "arm": "whole arm", "": "no particular place"}.get(location, location)


def named(effect: str, location: str) -> str:
    """An effect at its place: "hysteresis of joint 3", "compliance of the base"."""
    known, name = registry.known(effect), noun(effect)
    if not location or (known is not None and not known.of):
        return name
    article = "the " if located(location).kind in (BASE, TOOL, SENSOR, ARM) else ""
    said = f"{article}{place(location)}" if known is None else known.at.get(location, f"{article}{place(location)}")
    return f"{name} {'of' if known is None else known.of} {said}"


def spoken(effect: str, location: str) -> str:
    """An effect in a running sentence, its place where it has several: "link compliance of link 3", "wrong payload"."""
    known = registry.known(effect)
    name = known.spoken or known.noun if known else effect.replace("_", " ")
    at = located(location)
    if at.kind in (JOINT, LINK):
        return f"{name} of {place(location)}"
    return f"{name} ({location})" if at.of_rows else name


def listed(words: Sequence[str], last: str = "or") -> str:
    """ "a, b or c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def _rows(which: str) -> str:
    numbers = [n for n in which.split(",") if n]
    if not numbers:
        return "rows"
    if len(numbers) > _MOST_ROWS:
        return f"{len(numbers)} rows ({', '.join(numbers[:4])} …)"
    return f"row {numbers[0]}" if len(numbers) == 1 else f"rows {listed(numbers, 'and')}"

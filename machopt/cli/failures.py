"""Failed checks in the order in which somebody looks for a fault: what is behind the others first, in plain words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.verify import Check

_INPUTS, _MANIFEST, _FILES = "made from these inputs", "manifest.json", "files as listed"
_UNREADABLE = "can be read"
_FOLLOWS = ("result.json verdict", "result.json outputs", "result.json verification")  # tell of the other checks
_FROM_PLACE = ("joint velocity", "joint acceleration", "joint jerk", "feed")  # a sample out of place breaks these too
_CONSEQUENCE = 6  # rank of what follows from other failures
MOST = 6  # failures that are told in full


def causes_first(checks: Sequence[Check]) -> list[Check]:
    """Failed checks before all others, causes before what follows from them."""
    failed = {id(c): _rank(c, checks) for c in checks if c.passed is False}
    return sorted(checks, key=lambda c: failed.get(id(c), 99))  # stable: else in the order they were made


def failures(checks: Sequence[Check]) -> str:
    """The first cause on the first line; the other failures below it, those that follow from them by name."""
    failed = [c for c in causes_first(checks) if c.passed is False]
    causes = [c for c in failed if _rank(c, checks) < _CONSEQUENCE]
    follow = [c.name for c in failed if c not in causes]
    first, *others = causes or failed
    told = sentence(first)
    if first.name == _FILES:  # what changed in it belongs on the same line
        file = first.where.split(" ", maxsplit=1)[0]
        inside = next((c for c in others if sentence(c).startswith(file)), None)
        if inside is not None:
            others.remove(inside)
            told = f"{told}; {sentence(inside)}"
    lines = [told, *(f"  also {sentence(c)}" for c in others[: MOST - 1])]
    if len(others) >= MOST:
        lines.append(f"  and {len(others) - MOST + 1} more checks")
    if follow and causes:
        lines.append(f"  because of that also: {', '.join(follow[:MOST])}{' …' if len(follow) > MOST else ''}")
    return "\n".join(lines)


def sentence(c: Check) -> str:
    """File, what, how much, place."""
    if c.name == _FILES:
        return c.where
    if c.name == _INPUTS:
        return f"OUT was not made from these inputs: {c.where}"
    name = c.name.removesuffix(_UNREADABLE).strip()
    name = name if "." in name or c.name in ("robot programs", "tables") else f"trajectory.csv, {name}"
    if math.isnan(c.value) and math.isfinite(c.limit) and " " not in c.unit and c.limit:
        return f"{name}: no value where one belongs (or one where none does), {c.where}"
    counts = math.isnan(c.value) or c.limit == 0.0 or math.isnan(c.limit)  # so many places are wrong, the first named
    if counts or " follows" in c.where:
        return f"{name}: {c.where}"
    place = c.where if c.where.startswith(("on ", "at ", "before ", "behind ", "between ")) else f"at {c.where}"
    return f"{name}: {c.value:.4g} {c.unit}, the limit is {c.limit:.4g}" + (f", {place}" if c.where else "")


def _rank(c: Check, checks: Sequence[Check]) -> int:
    if c.name in (_INPUTS, _MANIFEST):
        return 0
    if c.name == _FILES:
        return 1
    if c.name.endswith(_UNREADABLE):
        return 2
    unread = [
        o.name.removesuffix(_UNREADABLE).strip() for o in checks if o.passed is False and o.name.endswith(_UNREADABLE)
    ]
    if (
        c.name in _FOLLOWS
        or (unread and c.name.startswith("result.json"))
        or any(f"{name}: " in c.where or f"{name} lacks" in c.where for name in unread)
    ):
        return _CONSEQUENCE
    if c.name.startswith("result.json"):
        return 5
    return 4 if c.name in _FROM_PLACE else 3

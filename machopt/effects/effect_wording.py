"""Names of effects and places in words for reports and messages."""

from __future__ import annotations

from collections.abc import Sequence

from machopt.data_types.effect_locations import ARM, BASE, COLUMN, JOINT, LINK, ROWS, SENSOR, TOOL, parse_location
from machopt.effects import registry
from machopt.effects.protocol import UNCATALOGUED

_UNCATALOGUED_NOUN = "effect outside the catalogue"
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


def format_effect_noun(effect: str) -> str:
    """Return the noun of an effect, for example "hysteresis".

    Args:
        effect: Name of the effect as files and findings state it.

    Returns:
        The noun; for a user-defined effect its name without underscores.
    """
    known = registry.find_effect(effect)
    if effect == UNCATALOGUED:
        return _UNCATALOGUED_NOUN
    return known.noun if known else effect.replace("_", " ")


def format_effect_sentence(effect: str) -> str:
    """Return one sentence that explains the effect.

    Args:
        effect: Name of the effect as files and findings state it.

    Returns:
        The sentence; empty for a user-defined effect.
    """
    known = registry.find_effect(effect)
    return known.sentence if known else ""


def format_place(location: str) -> str:
    """Return a location in words: ``joint:4-5`` becomes "joints 4 and 5".

    Args:
        location: Location string as in findings.

    Returns:
        The place in words.
    """
    at = parse_location(location)
    if at.is_joint_location and len(at.numbers) > 1:
        return "joints " + " and ".join(map(str, at.numbers))
    if at.kind in (JOINT, LINK):
        return f"{at.kind} {at.which}"
    if at.kind == SENSOR:
        return _SENSORS.get(at.which, f"channel {at.which}")
    if at.kind == COLUMN:
        return f"column {at.which}"
    if at.kind == ROWS:
        return _format_rows(at.which)
    return {"base": "base", "tool": "tool", "arm": "whole arm", "": "no particular place"}.get(location, location)


def format_effect_at_place(effect: str, location: str) -> str:
    """Return an effect with its place: "hysteresis of joint 3", "compliance of the base".

    Args:
        effect: Name of the effect as files and findings state it.
        location: Place of the effect, for example ``joint:3``.

    Returns:
        The phrase.
    """
    known, name = registry.find_effect(effect), format_effect_noun(effect)
    if effect == UNCATALOGUED:
        return format_effect_in_sentence(effect, location)
    if not location or (known is not None and not known.preposition):
        return name
    article = "the " if parse_location(location).kind in (BASE, TOOL, SENSOR, ARM) else ""
    place = (
        f"{article}{format_place(location)}"
        if known is None
        else known.place_wording.get(location, f"{article}{format_place(location)}")
    )
    return f"{name} {'of' if known is None else known.preposition} {place}"


def format_effect_in_sentence(effect: str, location: str) -> str:
    """Return an effect for use inside a sentence, with its place if it can occur at several: "link compliance of link
    3".

    Args:
        effect: Name of the effect as files and findings state it.
        location: Place of the effect, for example ``joint:3``.

    Returns:
        The phrase.
    """
    known = registry.find_effect(effect)
    if effect == UNCATALOGUED:
        return f"an {_UNCATALOGUED_NOUN} at {format_place(location)}"
    name = known.short_noun or known.noun if known else effect.replace("_", " ")
    at = parse_location(location)
    if at.kind in (JOINT, LINK):
        return f"{name} of {format_place(location)}"
    return f"{name} ({location})" if at.is_row_location else name


def join_with_commas(words: Sequence[str], last: str = "or") -> str:
    """Return a list in words: "a, b or c".

    Args:
        words: Words in order.
        last: Conjunction before the last word.

    Returns:
        The joined text; empty for no words.
    """
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def _format_rows(which: str) -> str:
    numbers = [n for n in which.split(",") if n]
    if not numbers:
        return "rows"
    if len(numbers) > _MOST_ROWS:
        return f"{len(numbers)} rows ({', '.join(numbers[:4])} …)"
    return f"row {numbers[0]}" if len(numbers) == 1 else f"rows {join_with_commas(numbers, 'and')}"

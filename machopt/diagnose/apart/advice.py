"""What would split two explanations that poses and loads cannot."""

from __future__ import annotations

from machopt.diagnose.apart.disputes import NOTHING, Stand
from machopt.effects import registry
from machopt.effects.words import spoken


def words(s: Stand) -> str:
    """Its name in a sentence."""
    if s is NOTHING:
        return "nothing"
    return spoken(s.effect, s.location) if s.effect else f"something at {s.location}"


def advice(one: Stand, two: Stand) -> str:
    """What would split two laws that poses and loads cannot."""
    effects = {one.effect, two.effect}
    if effects & {e.name for e in registry.of_records() if any(law.moves == "wrench" for law in e.recorded)}:
        return "known weights hung where the load acts, or a second force sensor, instead of the one in doubt"
    if "displacement_frame" in effects:
        return "register the displacement's axes anew, with the arm moved along base_link's axes"
    if effects & {e.called for e in registry.EFFECTS.values() if e.drifts or (e.unloaded and not e.paired)}:
        return "the same poses without load and with one, and a record of temperature over a day"
    if NOTHING in (one, two):
        return "larger loads or a quieter gauge; at this size it moves the tool by less than readings scatter"
    places = " and ".join(dict.fromkeys(s.location for s in (one, two)))
    return f"a second target on the arm between {places}, read together with the one at the tool"

"""Advice on measurements that separate two explanations which poses and loads cannot separate."""

from __future__ import annotations

from machopt.effects import registry
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.measurement.diagnosis.discrimination.open_hypotheses import NO_EFFECT, CandidateLaw


def format_hypothesis_name(s: CandidateLaw) -> str:
    """Return the name of a candidate law for use in a sentence.

    Args:
        s: Candidate law.

    Returns:
        Text.
    """
    if s is NO_EFFECT:
        return "nothing"
    return format_effect_in_sentence(s.effect, s.location) if s.effect else f"something at {s.location}"


def advise_on_separation(one: CandidateLaw, two: CandidateLaw) -> str:
    """Return a measurement that would separate two laws.

    Args:
        one: First law.
        two: Second law.

    Returns:
        Text.
    """
    effects = {one.effect, two.effect}
    if effects & {
        e.name
        for e in registry.select_record_effects()
        if any(law.affected_quantity == "wrench" for law in e.record_laws)
    }:
        return "known weights hung where the load acts, or a second force sensor, instead of the one in doubt"
    if "displacement_frame" in effects:
        return "register the displacement's axes anew, with the arm moved along base_link's axes"
    if effects & {
        e.file_word for e in registry.EFFECTS.values() if e.drift_laws or (e.angle_laws and not e.is_joint_pair)
    }:
        return "the same poses without load and with one, and a record of temperature over a day"
    if NO_EFFECT in (one, two):
        return "larger loads or a quieter gauge; at this size it moves the tool by less than readings scatter"
    places = " and ".join(dict.fromkeys(s.location for s in (one, two)))
    return f"a second target on the arm between {places}, read together with the one at the tool"

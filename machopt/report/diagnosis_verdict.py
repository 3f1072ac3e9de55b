"""The verdict on the diagnosis page: badge, sentence, warnings, and the numbers that carry it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.diagnose.nouns.result import Diagnosis
from machopt.diagnose.verdict.words import closes, record_only
from machopt.report.diagnosis import DiagnosisPage
from machopt.report.diagnosis_words import chance, parted, percents, sized, standing
from machopt.report.template import part

if TYPE_CHECKING:
    from markupsafe import Markup


def verdict_html(data: DiagnosisPage) -> Markup:
    """The section at the top."""
    d = data.diagnosis
    badge, tone = standing(d)
    left = "nothing was added" if not d.findings else f"with {len(d.findings)} found"
    told = math.isfinite(d.mismatch_p)
    scatter = "what repeats of a reading scatter" if told else "not repeated: what the fit leaves in what it has seen"
    before, after = parted(d.heldout_before, d.unit), parted(d.heldout_after, d.unit)
    cards = [
        ("Held-out error before", *before, "the nominal structure, refitted"),
        ("Held-out error after", *after, left),
        ("Noise floor", *parted(d.noise_floor, d.unit), scatter),
    ]
    if record_only(d):
        cards[0] = ("Error before", *before, "the record as stated, model refitted")
        cards[1] = ("Held-out error after", *after, "the record put right, model refitted")
        if not closes(d):
            del cards[0]
            cards[0] = ("Held-out error", *cards[0][1:])
    if d.verdict in ("consistent", "insufficient"):
        cards.append(("Repeatable mismatch", f"p {chance(d.mismatch_p)}", "", "chance that noise alone does this"))
    else:
        of = (
            "of the mismatch of the record as stated"
            if of_record(d) and closes(d)
            else "of what the record put right leaves"
            if record_only(d)
            else f"of the repeatable {sized(d.repeatable, d.unit)}"
        )
        cards.append(
            ("Closed" if closes(d) or d.verdict != "partly_explained" else "Explained", *percents(d.explained), of)
        )
    return part("verdict", "verdict", tone, badge, d.sentence, d.warnings, cards)


def of_record(d: Diagnosis) -> bool:
    """Whether something was found of the record itself: then before and after are counted with that put right."""
    return any(f.record for f in d.findings)

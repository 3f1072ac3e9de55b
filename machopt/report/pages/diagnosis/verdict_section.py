"""Verdict section of the diagnosis page: badge, sentence, warnings and key figures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.verdict.verdict_text import has_record_findings_only, is_mismatch_closed
from machopt.report.page_types.diagnosis_page_data import DiagnosisPageData
from machopt.report.template_rendering import render_part
from machopt.report.wording.diagnosis_terms import (
    describe_verdict,
    format_error,
    format_error_parts,
    format_p_value,
    format_percent_parts,
)

if TYPE_CHECKING:
    from markupsafe import Markup


def build_verdict_html(data: DiagnosisPageData) -> Markup:
    """Return the section.

    Args:
        data: The data of the page.
    """
    d = data.diagnosis
    badge, tone = describe_verdict(d)
    left = "nothing was added" if not d.findings else f"with {len(d.findings)} found"
    is_probability_known = math.isfinite(d.mismatch_p)
    scatter = (
        "what repeats of a reading scatter"
        if is_probability_known
        else "not repeated: what the fit leaves in what it has seen"
    )
    before, after = format_error_parts(d.heldout_before, d.unit), format_error_parts(d.heldout_after, d.unit)
    cards = [
        ("Held-out error before", *before, "the nominal structure, refitted"),
        ("Held-out error after", *after, left),
        ("Noise floor", *format_error_parts(d.noise_floor, d.unit), scatter),
    ]
    if has_record_findings_only(d):
        cards[0] = ("Error before", *before, "the record as stated, model refitted")
        cards[1] = ("Held-out error after", *after, "the record corrected, model refitted")
        if not is_mismatch_closed(d):
            del cards[0]
            cards[0] = ("Held-out error", *cards[0][1:])
    if d.verdict in ("consistent", "insufficient"):
        cards.append(
            ("Repeatable mismatch", f"p {format_p_value(d.mismatch_p)}", "", "chance that noise alone does this")
        )
    else:
        of = (
            "of the mismatch of the record as stated"
            if has_data_finding(d) and is_mismatch_closed(d)
            else "of the error of the corrected record"
            if has_record_findings_only(d)
            else f"of the repeatable {format_error(d.repeatable, d.unit)}"
        )
        cards.append(
            (
                "Closed" if is_mismatch_closed(d) or d.verdict != "partly_explained" else "Explained",
                *format_percent_parts(d.explained),
                of,
            )
        )
    return render_part("verdict", "verdict", tone, badge, d.sentence, d.warnings, cards)


def has_data_finding(d: DiagnosisResult) -> bool:
    """Return whether a fault of the recording was found; before and after then refer to the corrected recording.

    Args:
        d: The diagnosis.
    """
    return any(f.record for f in d.findings)

"""Rules that the verdict of a diagnosis must satisfy, in one place.

The search proposes a verdict. :func:`apply_verdict_rules` weakens it where a rule is not satisfied, and moves
corrections that help but cannot be named out of the findings. :func:`find_contradictions` tests the same rules on a
written document.
"""

from __future__ import annotations

from dataclasses import replace

from machopt.data_types.documents.diagnosis_document import DiagnosisDocument, EstimateSection, FindingEntry
from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, Finding
from machopt.measurement.diagnosis.verdict.transmission_error_naming import (
    SplitWaves,
    convert_to_unnamed,
    is_constant_of_unnamed_waves,
    split_waves,
)
from machopt.measurement.diagnosis.verdict.verdict_text import (
    describe_withdrawn_findings,
    format_error_size,
    format_verdict,
    has_record_findings_only,
    is_mismatch_closed,
    suggest_next_experiment,
)

RECORD_EFFECTS = ("units", "columns", "outliers")  # effects that never explain a mismatch of the arm alone
HEADLINES = {
    "consistent": "Consistent",
    "explained": "Explained",
    "partly_explained": "Partly explained",
    "unexplained": "Unexplained",
    "insufficient": "Not enough data",
}


def apply_verdict_rules(d: DiagnosisResult) -> DiagnosisResult:
    """Return the diagnosis with a verdict that its numbers support, and with the matching sentence.

    Args:
        d: Result of the diagnosis with the errors of its written files.

    Returns:
        The diagnosis.
    """
    d = _separate_unnamed_corrections(d)
    if d.verdict == "insufficient":
        return d
    if d.verdict == "explained" and (reason := _explain_missing_proof(d)) is not None:
        d = replace(d, verdict="partly_explained", notes=(*d.notes, reason))
    if d.verdict == "unexplained" and any(not f.record for f in d.findings):
        d = replace(d, verdict="partly_explained")
    if d.verdict == "partly_explained" and not _is_partly_explained(d):
        d = replace(_withdraw_named_findings(d), verdict="unexplained")
    return replace(d, sentence=format_verdict(d))


def find_contradictions(document: DiagnosisDocument) -> tuple[str, ...]:
    """Find statements of a document that contradict its verdict.

    Args:
        document: Content of diagnosis.json.

    Returns:
        One sentence for each contradiction.
    """
    first, last, out = document.baseline, document.final, []
    named = [f for f in document.findings if not f.of_the_record]
    proof = [f for f in document.findings if f.effect not in RECORD_EFFECTS]
    if not document.sentence.startswith(HEADLINES[document.verdict]):
        out.append(f"the headline does not begin with {HEADLINES[document.verdict]!r}")
    if document.verdict == "explained":
        noise, after, before = first.measured_noise, last.heldout_rmse, first.heldout_rmse
        if not proof:
            out.append("explained by nothing but faults of the record")
        if not (last.explained_share or 0.0) > thresholds.SHARES.majority:
            out.append(f"explained, and {100 * (last.explained_share or 0.0):.0f} % of the mismatch is closed")
        if noise is None or after is None or not after <= thresholds.RATIOS.equal_fit * noise:
            out.append(f"explained, and the held-out error {after} is not near the measured noise {noise}")
        if after is None or before is None or not after < before:
            out.append("explained without a smaller held-out error")
    if document.verdict == "partly_explained" and not document.findings:
        out.append("partly explained by nothing")
    if document.verdict == "unexplained" and named:
        out.append("unexplained beside named effects")
    if document.verdict == "consistent" and any(f.effect != "geometric_stiffness" for f in named):
        out.append("consistent beside named effects")
    out += [f"{f.effect} {f.location}: no size differs from zero" for f in named if not _has_certain_entry(f)]
    return tuple(out)


def _explain_missing_proof(d: DiagnosisResult) -> str | None:
    """Return why a mismatch does not count as explained; None if it does."""
    noise, after = d.measured_noise, d.heldout_after
    if not [f for f in d.findings if f.effect not in RECORD_EFFECTS]:
        if d.findings:
            return "only faults of the record were found, which explain nothing of the arm"
        return "the corrections that lower the error cannot be named"
    if d.unwritten:
        names = ", ".join(format_effect_in_sentence(*name) for name in d.unwritten)
        return f"no model file can state {names}: the files hold the model that fits best without it"
    if not noise > 0.0:
        return (
            "the noise was neither measured by replicates nor stated, so the remaining error cannot be compared with it"
        )
    if not after <= thresholds.RATIOS.equal_fit * noise:
        return (
            f"the written files leave {format_error_size(after, d.unit)} on readings that no fit saw, "
            f"{after / noise:.1f} times the noise of {format_error_size(noise, d.unit)}"
        )
    if not after < d.heldout_before:
        return "the written files do not predict unseen readings better than the refitted nominal model"
    if not d.explained > thresholds.SHARES.majority:
        return f"the findings close {100.0 * d.explained:.0f} % of the repeatable mismatch, which is not most of it"
    return None


def _is_partly_explained(d: DiagnosisResult) -> bool:
    """Return whether what was found predicts unseen readings better."""
    if not d.findings:
        return False
    if any((f.effect, f.location) in d.unwritten and f.after < f.before for f in d.findings):
        return True
    return is_mismatch_closed(d) or (not has_record_findings_only(d) and d.heldout_after < d.heldout_before)


def _withdraw_named_findings(d: DiagnosisResult) -> DiagnosisResult:
    """Remove effects of the arm with which the written files do not predict unseen readings better."""
    named = tuple(f for f in d.findings if not f.record)
    return replace(
        d,
        findings=tuple(f for f in d.findings if f.record),
        notes=(*d.notes, *describe_withdrawn_findings(named)),
    )


def _separate_unnamed_corrections(d: DiagnosisResult) -> DiagnosisResult:
    """Move kinematic corrections that cannot be named out of the findings.

    These have no certain size or hardly any gain, or they are waves of few periods or of implausible size, with the
    constant part of such waves. They stay in kinematics.yaml, because they were fitted together with the others and
    lower the error.
    """
    named, unnamed, waves = list[Finding](), list[Finding](), list[Finding]()
    for f in d.findings:
        parts = split_waves(f)
        waves += [] if parts.unnamed is None else [parts.unnamed]
        if parts.named is not None and _is_unnamed_correction(d, parts.named):
            parts = SplitWaves(None, convert_to_unnamed(f))
        named += [] if parts.named is None else [parts.named]
        unnamed += [] if parts.unnamed is None else [parts.unnamed]
    constant = [is_constant_of_unnamed_waves(f, waves) for f in named]
    unnamed += [f for f, is_part in zip(named, constant, strict=True) if is_part]
    named = [f for f, is_part in zip(named, constant, strict=True) if not is_part]
    if not unnamed:
        return d
    names = ", ".join(format_effect_in_sentence(f.effect, f.location) for f in unnamed)
    text = f"written into kinematics.yaml because they lower the error, and too uncertain to be named: {names}"
    d = replace(d, findings=tuple(named), unnamed=(*d.unnamed, *unnamed), notes=(*d.notes, text))
    return replace(d, next_experiment=suggest_next_experiment(d))


def _is_unnamed_correction(d: DiagnosisResult, f: Finding) -> bool:
    """Return whether a kinematic correction has no certain size, hardly any gain, or a cause that poses do not show.

    A torque by the angle of a joint turns it by a smooth curve, as low orders do. It is named only where it leaves
    nothing else, so that no other smooth error is in it.
    """
    if not isinstance(f.correction, KinematicCorrection):
        return False
    is_torque = f.effect != f.correction.effect
    if is_torque and not d.heldout_after <= thresholds.RATIOS.equal_fit * d.measured_noise:
        return True
    whole, own = d.heldout_before - d.heldout_after, f.before - f.after
    least = thresholds.SHARES.negligible
    return not _has_certain_size(f) or (own < least * whole and own < least * f.after)


def _has_certain_size(f: Finding) -> bool:
    """Return whether the 95 % interval of a size excludes zero; True for findings without intervals."""
    return _is_any_certain(list(f.parameters.values()))


def _has_certain_entry(f: FindingEntry) -> bool:
    return _is_any_certain(list(f.parameters.values()))


def _is_any_certain(sizes: list[EstimatedValue] | list[EstimateSection]) -> bool:
    ends = [e.ci95 for e in sizes if e.ci95[0] != e.ci95[1]]
    return not ends or any((low is not None and low > 0.0) or (high is not None and high < 0.0) for low, high in ends)

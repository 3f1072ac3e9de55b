"""Open questions of a diagnosis: the laws that the next measurement has to discriminate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from machopt.data_types.documents.diagnosis_document import DiagnosisDocument, FindingEntry, RivalEntry
from machopt.data_types.parameter_keys import JOINT_SPRING, ParameterKey
from machopt.effects.protocol import UNCATALOGUED
from machopt.errors import RecordingError
from machopt.measurement.diagnosis.data_types.diagnosis_result import is_spring_observable

MAX_RIVALS = 5  # most rivals of one finding, the best ones
MAX_REJECTED_RIVALS = 2  # rejected rivals that a finding without open ones is compared with
MAX_LOCATIONS = 3  # locations of a mismatch that no law explains
MAX_HIDDEN_EFFECTS = 3  # undetected effects with the largest possible size


@dataclass(frozen=True, kw_only=True)
class CandidateLaw:
    """Law that may be true, with its fit in the diagnosis."""

    effect: str
    location: str
    law: str = ""  # empty: the first law of the effect
    coefficients: tuple[float, ...] = ()  # SI; empty: only size or rms is known
    shape: tuple[float, ...] = ()
    correction: Mapping[str, Any] | None = None  # its parameters in absolute units
    size: float | None = None  # of the first quantity, if only a detection limit is known
    rms: float | None = None  # m per coordinate, if only the mismatch at its place is known

    @property
    def name(self) -> tuple[str, str]:
        return self.effect, self.location


NO_EFFECT = CandidateLaw(effect="nothing", location="")


@dataclass(frozen=True)
class RivalLawSet:
    """Competing laws of which one is true, and the pairs to separate. Other findings are refitted with each."""

    reason: str
    candidate_laws: tuple[CandidateLaw, ...]
    pairs: tuple[tuple[int, int], ...]
    other_laws: tuple[CandidateLaw, ...] = ()


@dataclass(frozen=True, kw_only=True)
class OpenDiagnosis:
    """Part of a diagnosis that a measurement plan needs."""

    channel: str  # deflection or position
    verdict: str
    coordinates: int  # 3 or 6
    wrench_frame: str
    displacement_frame: str
    registration: str
    scatter: tuple[float, float] | None  # m, of a single reading and shared by a visit
    turn: float | None  # rad, rotational scatter of a single reading
    compliance: Mapping[int, float]  # joint (1-based): rad/(N·m), of observable joints
    rival_sets: tuple[RivalLawSet, ...]
    notes: tuple[str, ...]  # what cannot be planned, with the reason


def read_open_diagnosis(data: DiagnosisDocument, file: Path) -> OpenDiagnosis:
    """Read the open questions of a diagnosis.

    Args:
        data: The diagnosis document.
        file: Path of the document, for error messages.

    Returns:
        The open diagnosis.

    Raises:
        InputError: The diagnosis is of a motion, or a required number is missing.
    """
    if data.channel not in ("deflection", "position"):
        raise RecordingError(
            f"is a diagnosis of a motion (channel {data.channel}); poses and loads can be planned for load tests "
            f"and measured poses. What it says itself: {data.next_experiment}",
            file=file,
            where="channel",
        )
    recorded = data.recorded
    scatter, turn = recorded.scatter_m, recorded.scatter_rad
    disputes, notes = _build_rival_sets(data, file)
    return OpenDiagnosis(
        channel=data.channel,
        verdict=data.verdict,
        coordinates=recorded.coordinates,
        wrench_frame=recorded.wrench_frame,
        displacement_frame=recorded.displacement_frame,
        registration=recorded.registration,
        scatter=None if scatter is None else (_require_number(scatter.own, file), _require_number(scatter.visit, file)),
        turn=None if turn is None else _require_number(turn.own, file),
        compliance=_read_joint_compliances(data, file),
        rival_sets=tuple(disputes),
        notes=tuple(notes),
    )


def _read_joint_compliances(data: DiagnosisDocument, file: Path) -> Mapping[int, float]:
    """Return the compliance of each observable joint (1-based). Negative values of a fit are dropped."""
    out = {}
    for c in data.coefficients:
        if c.key is not None and c.key.effect == JOINT_SPRING:
            value, sigma = _require_number(c.value, file), np.inf if c.sigma is None else c.sigma
            if is_spring_observable(value, sigma):
                out[ParameterKey(c.key.effect, c.key.location, c.key.coefficient).joint] = value
    return out


def _require_number(value: float | None, file: Path) -> float:
    """Return a number that the plan requires."""
    if value is None:
        raise RecordingError(
            "does not hold what a plan needs (a number is null); a fresh machopt diagnose writes it", file=file
        )
    return float(value)


def _build_rival_sets(data: DiagnosisDocument, file: Path) -> tuple[list[RivalLawSet], list[str]]:
    findings = [f for f in data.findings if f.fit is not None]
    notes = [f"{f.effect} {f.location} is no matter of poses and loads" for f in data.findings if f.fit is None]
    if findings:
        open_ = [f for f in findings if any(effect != UNCATALOGUED for effect, _ in f.one_of[1:])]
        notes += [
            f"{f.effect} {f.location} and {effect} {location}: no poses and loads tell these two apart"
            for f in findings
            for effect, location in f.one_of[1:]
            if effect == UNCATALOGUED
        ]
        return [_build_finding_rivals(f, [o for o in findings if o is not f]) for f in open_ or findings], notes
    if data.verdict == "unexplained":
        return _build_location_rivals(data, file), notes
    hidden = [
        CandidateLaw(effect=x.effect, location=x.location, size=float(x.value))
        for x in data.detection_limits
        if x.value is not None and x.standing != "not testable"
    ]
    if not hidden:
        return [], notes
    candidate_laws = (NO_EFFECT, *hidden)
    why = "nothing was found; these effects could hide most below their detection limits"
    return [RivalLawSet(why, candidate_laws, tuple((0, k) for k in range(1, len(candidate_laws))))], notes


def _build_finding_rivals(f: FindingEntry, others: Sequence[FindingEntry]) -> RivalLawSet:
    """Return a finding with its open rivals; without open rivals with the best rejected ones and with no effect."""
    own = _build_candidate_law(f)
    rivals = [_build_candidate_law(r) for r in f.rivals if r.fit is not None]
    left = [
        s for s in rivals if s.name in f.one_of[1:]
    ]  # a law that is identical under this load, as play, has no fit of its own
    beside = tuple(_build_candidate_law(o) for o in others)
    if left:
        candidate_laws = (own, *left)
        why = f"{own.effect} {own.location} was found, these could not be excluded"
        return RivalLawSet(why, candidate_laws, tuple(combinations(range(len(candidate_laws)), 2)), beside)
    candidate_laws = (own, *rivals[:MAX_REJECTED_RIVALS], NO_EFFECT)
    why = f"{own.effect} {own.location} was found alone: against nothing and the nearest that were rejected"
    return RivalLawSet(why, candidate_laws, tuple((0, k) for k in range(1, len(candidate_laws))), beside)


def _build_candidate_law(named: FindingEntry | RivalEntry) -> CandidateLaw:
    fit = named.fit
    if fit is None:
        raise ValueError(f"{named.effect} {named.location} was not fitted")
    return CandidateLaw(
        effect=named.effect,
        location=named.location,
        law=named.law,
        coefficients=tuple(map(float, fit.coefficients)),
        shape=tuple(map(float, fit.shape)),
        correction=None if fit.correction is None else dict(fit.correction.parameters),
    )


def _build_location_rivals(data: DiagnosisDocument, file: Path) -> list[RivalLawSet]:
    factor = {"mm": 1e-3}.get(data.rmse_unit)
    if factor is None:
        raise RecordingError(f"found {data.rmse_unit!r}; mm was expected", file=file, where="rmse_unit")
    rms = factor * _require_number(data.baseline.repeatable_rmse, file)
    shares = sorted((s for s in data.mismatch if s.kind == "machine"), key=lambda s: -(s.share or 0.0))
    candidate_laws = tuple(CandidateLaw(effect="", location=s.axis, rms=rms) for s in shares)
    if not candidate_laws:
        return []
    why = "no law explains the mismatch; these are the nearest places"
    return [RivalLawSet(why, candidate_laws, tuple(combinations(range(len(candidate_laws)), 2)))]

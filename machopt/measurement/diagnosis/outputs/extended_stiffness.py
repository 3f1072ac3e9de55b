"""Extended stiffness of a diagnosis: refitted joint springs, and terms including the findings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import parse_joint_location, parse_location
from machopt.data_types.stiffness import SOFTEST, STIFFEST, ArmStiffness, StiffnessTerm
from machopt.effects.effect_wording import format_effect_in_sentence
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import (
    BaseCoefficient,
    DiagnosisResult,
    is_spring_observable,
)
from machopt.stiffness.arm_stiffness import find_unstable_term
from machopt.stiffness.terms.stability_check import UnstableTerm
from machopt.stiffness.terms.term_builder import compile_terms


@dataclass(frozen=True)
class ExtendedStiffness:
    """Stiffness before and after the findings; None if fewer than six joints are known or one is prismatic."""

    before: ArmStiffness | None  # joints refitted, without findings
    after: ArmStiffness | None  # joints refitted, with findings
    withheld: tuple[StiffnessTerm, ...] = ()  # found terms that are not included
    notes: tuple[str, ...] = ()  # reasons, one sentence each


def build_extended_stiffness(cell: Cell, d: DiagnosisResult, *, weight_alone: bool = False) -> ExtendedStiffness:
    """Build the stiffness from refitted joints and terms; unobservable joints keep the cell's springs.

    Under gravity alone a joint deflects by an amount that the joint angles determine, as geometry and harmonics do. A
    spring far from the cell's is then probably an artefact of those and is not included. A fit does not guarantee a
    positive joint compliance with all terms. A finding that would make it negative stays in the diagnosis but is not
    included. Its joints then keep the springs that fit without it. Findings that the model was already fitted without
    (``unwritten``) are left out as well.

    Args:
        cell: Robot cell.
        d: Result of the diagnosis.
        weight_alone: Whether the recording has measured poses without load.

    Returns:
        The stiffness with notes.
    """
    springs = {c.unknown.spring_joint: c for c in d.coefficients if c.unknown.spring_joint is not None}
    named = [(f, f.correction) for f in d.findings if isinstance(f.correction, StiffnessTerm)]
    found = tuple(c for f, c in named if (f.effect, f.location) not in d.unwritten)
    unwritten = tuple(c for f, c in named if (f.effect, f.location) in d.unwritten)
    known = () if cell.stiffness is None else cell.stiffness.terms
    if (cell.stiffness is None and len(springs) < len(cell.arm_joints)) or cell.arm_prismatic:
        return ExtendedStiffness(None, None)
    rejected_terms = {id(t): why for t in found if (why := _explain_implausible_term(cell, t)) is not None}
    withheld = [t for t in found if id(t) in rejected_terms]
    comments = [
        f"{format_effect_in_sentence(t.effect, t.location)} is not in stiffness.yaml, and the joints keep the "
        f"springs that fit without "
        f"it, since nothing that is built can be so: {rejected_terms[id(t)]}"
        for t in withheld
    ]
    found = tuple(t for t in found if id(t) not in rejected_terms)
    new = {_get_term_name(t) for t in found}
    terms = (*(t for t in known if _get_term_name(t) not in new), *found)
    spring_limit = thresholds.RATIOS.stiffness_error if weight_alone else np.inf
    before = _build_stiffness(cell, springs, known, lambda c: c.before, spring_limit)
    # with a joint's finding its jointly fitted spring is withheld too; for a body those of all joints
    joints_without_findings = set(range(1, len(cell.arm_joints) + 1)) if withheld else set()
    after = _build_stiffness(
        cell,
        springs,
        terms,
        lambda c: c.before if c.unknown.spring_joint in joints_without_findings else c.value,
        spring_limit,
    )
    while found and (wrong := _check_stiffness(cell, after)) is not None:
        out = _find_wrong_term(terms, new, wrong)
        joints_without_findings.update(_list_joints(out) or range(1, len(cell.arm_joints) + 1))
        withheld.append(out)
        comments.append(
            f"{format_effect_in_sentence(out.effect, out.location)} is not in stiffness.yaml, and its joint "
            f"keeps the spring that fits "
            f"without it: {wrong.reason}"
        )
        terms = tuple(t for t in terms if t is not out)
        after = _build_stiffness(
            cell,
            springs,
            terms,
            lambda c: c.before if c.unknown.spring_joint in joints_without_findings else c.value,
            spring_limit,
        )
    observable_joints = [
        j for j, c in sorted(springs.items()) if cell.stiffness is not None and is_spring_observable(c.value, c.sigma)
    ]
    comments += [
        f"joint {j} keeps the cell's spring in stiffness.yaml: poses bend under weight alone, where geometry that "
        f"was not found looks like a spring more than {spring_limit:g} times off; the same poses with a load would tell"
        for j in observable_joints
        if _compute_spring_factor(cell, j, springs[j].value) > spring_limit
    ]
    return ExtendedStiffness(before, after, (*withheld, *unwritten), tuple(comments))


def add_withheld_notes(d: DiagnosisResult, extended_stiffness: ExtendedStiffness) -> DiagnosisResult:
    """Return the diagnosis with withheld findings marked and noted.

    Args:
        d: Result of the diagnosis.
        extended_stiffness: Extended stiffness with the withheld terms.

    Returns:
        The diagnosis.
    """
    findings = tuple(
        replace(f, correction=RecordCorrection(f.correction.effect, f.correction.location, f.correction.parameters))
        if any(f.correction is t for t in extended_stiffness.withheld) and f.correction is not None
        else f
        for f in d.findings
    )
    return replace(d, findings=findings, warnings=(*d.warnings, *extended_stiffness.notes))


def _build_stiffness(
    cell: Cell,
    springs: Mapping[int, BaseCoefficient],
    terms: tuple[StiffnessTerm, ...],
    of: Callable[[BaseCoefficient], float],
    near: float,
) -> ArmStiffness:
    """Return joints with observable springs within a factor ``near`` of the cell's, and terms."""
    if not springs:
        assert cell.stiffness is not None  # otherwise all joints are observable
        return cell.stiffness if terms == cell.stiffness.terms else replace(cell.stiffness, terms=terms)
    prior, out = None if cell.stiffness is None else cell.stiffness.joints, []
    for j in range(len(cell.arm_joints)):
        c = springs.get(j + 1)
        value = 0.0 if c is None else of(c)
        sure = c is not None and is_spring_observable(value, c.sigma)
        if prior is not None and not (sure and _compute_spring_factor(cell, j + 1, value) <= near):
            out.append(float(prior[j]))
        else:
            out.append(float(np.clip(1.0 / max(value, 1.0 / STIFFEST), SOFTEST, STIFFEST)))
    known = cell.stiffness
    if known is None:
        return ArmStiffness(joints=np.array(out), terms=terms)
    return ArmStiffness(joints=np.array(out), terms=terms, external=known.external, position=known.position)


def _compute_spring_factor(cell: Cell, joint: int, compliance: float) -> float:
    """Return the ratio, at least 1, of a positive compliance and the cell's."""
    assert cell.stiffness is not None
    ratio = compliance * float(cell.stiffness.joints[joint - 1])
    return max(ratio, 1.0 / ratio)


def _explain_implausible_term(cell: Cell, term: StiffnessTerm) -> str | None:
    """Return why a file may not state a term, according to its law; None if it may."""
    try:
        compile_terms((term,), load_robot(cell), cell.tool.T_flange_tcp, None)
    except InputError as error:
        return error.reason
    return None


def _check_stiffness(cell: Cell, stiffness: ArmStiffness) -> UnstableTerm | None:
    """Check the stiffness as the planner does."""
    return find_unstable_term(stiffness, load_robot(cell), cell.tool.T_flange_tcp, cell.arm_limits)


def _find_wrong_term(terms: Sequence[StiffnessTerm], new: set[tuple[str, str]], wrong: UnstableTerm) -> StiffnessTerm:
    """Return the unstable term, or the finding at its joint."""
    named = [t for t in terms if _get_term_name(t) == (wrong.effect, wrong.location)]
    beside = [t for t in terms if _get_term_name(t) in new and _list_joints(t) & _list_joints(wrong)]
    return next(t for t in (*(t for t in named if _get_term_name(t) in new), *beside, *named))


def _list_joints(of: StiffnessTerm | UnstableTerm) -> set[int]:
    return (
        {j + 1 for j in parse_joint_location(of.location)} if parse_location(of.location).is_joint_location else set()
    )


def _get_term_name(t: StiffnessTerm) -> tuple[str, str]:
    return t.effect, t.location

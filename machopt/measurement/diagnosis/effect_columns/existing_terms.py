"""Terms that the cell's stiffness already contains: their contribution is subtracted before the search.

If the search finds a law where the cell already has one, the law is refitted as a whole and not in addition.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location, parse_location
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.effects import registry
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.measurement.diagnosis.effect_columns import joint_torque, structural_compliance
from machopt.numerics.array_types import Array

GEOMETRIC = "geometric_stiffness"  # always included in the equilibrium


def select_known_terms(terms: tuple[StiffnessTerm, ...]) -> tuple[StiffnessTerm, ...]:
    """Select the terms with a contribution of their own; K_C is always included.

    Args:
        terms: Terms of the cell's stiffness.

    Returns:
        The terms without geometric stiffness.
    """
    return tuple(t for t in terms if t.effect != GEOMETRIC)


def has_geometric_stiffness(stiffness: ArmStiffness | None) -> bool:
    """Return whether a cell's stiffness states geometric stiffness, so that it is no finding.

    Args:
        stiffness: Stiffness of the cell, or None.

    Returns:
        True if stated.
    """
    return stiffness is not None and any(t.effect == GEOMETRIC for t in stiffness.terms)


def compute_known_pose_displacement(r: StaticReadings, terms: tuple[StiffnessTerm, ...]) -> Array:
    """Compute the displacement of measured poses by known terms under weight and load.

    Each pose is evaluated from a gear at rest, as in a plan, because poses do not tell the load history. The torque
    of a gravity compensator is not included, nor the weight torque that it mostly cancels.

    Args:
        r: Static readings.
        terms: Terms of the cell's stiffness.

    Returns:
        (N, D) m, rad.
    """
    out = r.project_to_measured(np.zeros((len(r), 6)), BODY_BEHIND_FLANGE)
    for term in terms:
        known = registry.find_elastic_effect(term.effect)
        if known.body_laws:
            out += structural_compliance.compute_term_displacement(r, term)
        elif known.joint_laws:
            out += joint_torque.compute_joint_term_displacement(r, term)
    return out


def is_known_in_poses(term: StiffnessTerm) -> bool:
    """Return whether :func:`compute_known_pose_displacement` includes a term.

    Args:
        term: Term of a stiffness model.

    Returns:
        True if included.
    """
    effect = registry.find_elastic_effect(term.effect)
    return bool(effect.body_laws or effect.joint_laws)


def is_known_in_motions(term: StiffnessTerm) -> bool:
    """Return whether a motion with known torques includes a term: laws of single joints, and parallel torques.

    Args:
        term: Term of a stiffness model.

    Returns:
        True if included.
    """
    first, last = parse_joint_location(term.location) if parse_location(term.location).is_joint_location else (0, 1)
    return (first == last and bool(registry.find_elastic_effect(term.effect).joint_laws)) or is_known_in_torques(term)


def is_known_in_torques(term: StiffnessTerm) -> bool:
    """Return whether the torque channel includes a term: parallel torques.

    Args:
        term: Term of a stiffness model.

    Returns:
        True if included.
    """
    return bool(registry.find_elastic_effect(term.effect).parallel_torque_laws)


def diagnose_with_known_terms(
    terms: tuple[StiffnessTerm, ...],
    diagnose: Callable[[tuple[StiffnessTerm, ...]], tuple[DiagnosisResult, DiagnosisProblem]],
    counts: Callable[[StiffnessTerm], bool] = lambda _: True,
) -> tuple[DiagnosisResult, DiagnosisProblem]:
    """Diagnose with known terms, and repeat without those that the diagnosis finds itself.

    Args:
        terms: Terms of the cell's stiffness.
        diagnose: Function that diagnoses a recording with these known terms.
        counts: Function that returns whether the channel includes a term; others are noted.

    Returns:
        The diagnosis and its problem.
    """
    left = tuple(t for t in terms if not counts(t))
    terms = tuple(t for t in terms if counts(t))
    d, problem = diagnose(terms)
    again = {(f.effect, f.location) for f in d.findings} & {(t.effect, t.location) for t in terms}
    if again:
        d, problem = diagnose(tuple(t for t in terms if (t.effect, t.location) not in again))
    text = [
        f"the cell's own terms {words}: {', '.join(f'{t.effect} {t.location}' for t in some)}"
        for words, some in (("that this kind of recording does not count", left), ("count as known", terms))
        if some
    ]
    return replace(d, notes=(*d.notes, *text)) if text else d, problem

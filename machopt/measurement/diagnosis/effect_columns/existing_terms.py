"""Terms that the cell holds already: what they explain is taken off before anything is looked for.

A law that is found all the same where the cell holds it is fitted anew, not on top of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.data_types.locations import parse_joint_location, parse_location
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.effects import registry
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.measurement.diagnosis.effect_columns import joint_torque, structural_compliance
from machopt.numerics.array_types import Array

GEOMETRIC = "geometric_stiffness"  # counted in any case


def select_known_terms(terms: tuple[StiffnessTerm, ...]) -> tuple[StiffnessTerm, ...]:
    """Those that explain something; K_C is counted whether it stands in a file or not."""
    return tuple(t for t in terms if t.effect != GEOMETRIC)


def has_geometric_stiffness(stiffness: ArmStiffness | None) -> bool:
    """Whether a cell's stiffness says that K_C counts, so that it is nothing to find."""
    return stiffness is not None and any(t.effect == GEOMETRIC for t in stiffness.terms)


def compute_known_pose_displacement(r: StaticReadings, terms: tuple[StiffnessTerm, ...]) -> Array:
    """(N, D) m, rad, what terms make of measured poses under weight and load.

    Each pose is one of a gear at rest, as a plan takes it: poses do not say how a torque came there. The balancer's
    torque is not counted, nor is what it mostly cancels.
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
    """What :func:`compute_known_pose_displacement` counts."""
    effect = registry.find_elastic_effect(term.effect)
    return bool(effect.body_laws or effect.joint_laws)


def is_known_in_motions(term: StiffnessTerm) -> bool:
    """What a motion counts where gears twist and it tells the torque: laws of single joints, torques beside gears."""
    first, last = parse_joint_location(term.location) if parse_location(term.location).is_joint_location else (0, 1)
    return (first == last and bool(registry.find_elastic_effect(term.effect).joint_laws)) or is_known_in_torques(term)


def is_known_in_torques(term: StiffnessTerm) -> bool:
    """What joint torques of a motion count: torques beside gears."""
    return bool(registry.find_elastic_effect(term.effect).parallel_torque_laws)


def diagnose_with_known_terms(
    terms: tuple[StiffnessTerm, ...],
    diagnose: Callable[[tuple[StiffnessTerm, ...]], tuple[DiagnosisResult, DiagnosisProblem]],
    counts: Callable[[StiffnessTerm], bool] = lambda _: True,
) -> tuple[DiagnosisResult, DiagnosisProblem]:
    """A diagnosis where terms count as known, once more without those that it names itself.

    Args:
        terms: what the cell holds.
        diagnose: of a recording, with these terms known.
        counts: whether such a recording counts a term; the others are said.
    """
    left = tuple(t for t in terms if not counts(t))
    terms = tuple(t for t in terms if counts(t))
    d, problem = diagnose(terms)
    again = {(f.effect, f.location) for f in d.findings} & {(t.effect, t.location) for t in terms}
    if again:
        d, problem = diagnose(tuple(t for t in terms if (t.effect, t.location) not in again))
    said = [
        f"the cell's own terms {words}: {', '.join(f'{t.effect} {t.location}' for t in some)}"
        for words, some in (("that this kind of recording does not count", left), ("count as known", terms))
        if some
    ]
    return replace(d, notes=(*d.notes, *said)) if said else d, problem

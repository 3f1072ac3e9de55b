"""Terms that the cell holds already: what they explain is taken off before anything is looked for.

A law that is found all the same where the cell holds it is fitted anew, not on top of itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.laws import at_body, at_joint
from machopt.diagnose.nouns.problem import Problem
from machopt.diagnose.nouns.readings import BEHIND, Readings
from machopt.diagnose.nouns.result import Diagnosis
from machopt.domain.location import joints_of, located
from machopt.domain.stiffness import Stiffness, Term
from machopt.effects import registry

GEOMETRIC = "geometric_stiffness"  # counted in any case


def terms_of(terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Those that explain something; K_C is counted whether it stands in a file or not."""
    return tuple(t for t in terms if t.effect != GEOMETRIC)


def geometric(stiffness: Stiffness | None) -> bool:
    """Whether a cell's stiffness says that K_C counts, so that it is nothing to find."""
    return stiffness is not None and any(t.effect == GEOMETRIC for t in stiffness.terms)


def at_rest(r: Readings, terms: tuple[Term, ...]) -> Array:
    """(N, D) m, rad, what terms make of measured poses under weight and load.

    Each pose is one of a gear at rest, as a plan takes it: poses do not say how a torque came there. The balancer's
    torque is not counted, nor is what it mostly cancels.
    """
    out = r.seen(np.zeros((len(r), 6)), BEHIND)
    for term in terms:
        known = registry.elastic(term.effect)
        if known.gives:
            out += at_body.moved(r, term)
        elif known.laws:
            out += at_joint.moved(r, term)
    return out


def in_poses(term: Term) -> bool:
    """What :func:`at_rest` counts."""
    effect = registry.elastic(term.effect)
    return bool(effect.gives or effect.laws)


def in_motions(term: Term) -> bool:
    """What a motion counts where gears twist and it tells the torque: laws of single joints, torques beside gears."""
    first, last = joints_of(term.location) if located(term.location).of_joints else (0, 1)
    return (first == last and bool(registry.elastic(term.effect).laws)) or in_torques(term)


def in_torques(term: Term) -> bool:
    """What joint torques of a motion count: torques beside gears."""
    return bool(registry.elastic(term.effect).beside)


def diagnosed(
    terms: tuple[Term, ...],
    diagnose: Callable[[tuple[Term, ...]], tuple[Diagnosis, Problem]],
    counts: Callable[[Term], bool] = lambda _: True,
) -> tuple[Diagnosis, Problem]:
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

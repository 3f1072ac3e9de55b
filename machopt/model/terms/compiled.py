"""A stiffness file's terms made ready for computing, each by the family that its effect belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from machopt.arrays import Array
from machopt.domain.stiffness import Term
from machopt.effects import registry
from machopt.effects.given import Parameters
from machopt.errors import InputError
from machopt.model.robot import Robot
from machopt.model.terms import body, compensator, joint
from machopt.model.terms.base import LinearTerm
from machopt.typos import suggest_word


def vocabulary() -> dict[str, tuple[str, ...]]:
    """Effects that can stand in ``terms`` and their locations."""
    return {e.called: e.places for e in registry.EFFECTS.values() if e.elastic}


def compile_terms(
    terms: Sequence[Term], robot: Robot, T_flange_tcp: Array, file: Any = None
) -> tuple[tuple[LinearTerm, ...], bool]:
    """Make a stiffness file's terms ready for computing.

    Args:
        terms: as the file lists them.
        robot: the arm they belong to.
        T_flange_tcp: (4, 4).
        file: named in messages.

    Returns:
        the linear terms, and whether the geometric stiffness K_C is to be counted.

    Raises:
        InputError: an effect, location or parameter that does not exist or does not fit.
    """
    out: list[LinearTerm] = []
    geometric = False
    seen: set[tuple[str, str]] = set()
    for n, term in enumerate(terms):
        where = f"terms[{n}]"
        _check_place(term, where, file)
        if (term.effect, term.location) in seen:
            raise InputError(f"{term.effect} at {term.location} stands twice; keep one", file=file, where=where)
        seen.add((term.effect, term.location))
        parameters = Parameters(term.parameters, f"{where}.parameters", file)
        if term.effect == "geometric_stiffness":
            geometric = True
        else:
            out.append(_made(term, robot, T_flange_tcp, parameters))
        parameters.finish()
    return tuple(out), geometric


def term_of(effect: str, location: str, robot: Robot, T_flange_tcp: Array, **parameters: Any) -> LinearTerm:
    """One term by name; without the parameters that hold its coefficients it is one to be fitted."""
    terms, _ = compile_terms((Term(effect, location, parameters),), robot, T_flange_tcp)
    return terms[0]


def body_of(term: Term, robot: Robot, T_flange_tcp: Array) -> body.BodySpring:
    """A file's term of a body that gives way.

    Raises:
        InputError: as :func:`compile_terms`.
    """
    _check_place(term, "terms", None)
    parameters = Parameters(term.parameters, "terms.parameters", None)
    made = body.body_term(term.effect, robot, T_flange_tcp, parameters, term.location)
    parameters.finish()
    return made


def _check_place(term: Term, where: str, file: Any) -> None:
    known = vocabulary()
    if term.effect not in known:
        hint = suggest_word(term.effect, known)
        raise InputError(
            f"effect {term.effect!r} is not known; {hint}valid: {', '.join(known)}; one of your own: "
            "--effects FILE.py, --terms FILE.py in diagnose",
            file=file,
            where=f"{where}.effect",
        )
    if term.location not in known[term.effect]:
        raise InputError(
            f"{term.effect} cannot be at {term.location!r}; valid: {_some(known[term.effect])}",
            file=file,
            where=f"{where}.location",
        )


def _made(term: Term, robot: Robot, T_flange_tcp: Array, parameters: Parameters) -> LinearTerm:
    known = registry.elastic(term.effect)
    if known.gives:
        return body.body_term(term.effect, robot, T_flange_tcp, parameters, term.location)
    if known.beside:
        return compensator.compensator(parameters, term.location)
    return joint.joint_term(term.effect, parameters, term.location)


def _some(words: Sequence[str]) -> str:
    return ", ".join(words) if len(words) <= 6 else f"{', '.join(words[:3])} … {words[-1]}"

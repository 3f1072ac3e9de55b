"""Compilation of a stiffness file's terms, each by the family of its effect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from machopt.data_types.effect_locations import is_on_arm
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import registry
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.errors import CellError
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.spelling_suggestions import suggest_word
from machopt.stiffness.terms import body_spring, gravity_compensator, joint_term
from machopt.stiffness.terms.term_interface import LinearTerm


def list_effects_and_locations() -> dict[str, tuple[str, ...]]:
    """Return the effects that may occur in ``terms`` and their locations."""
    return {e.file_word: e.places for e in registry.EFFECTS.values() if e.is_elastic}


def compile_terms(
    terms: Sequence[StiffnessTerm], robot: Robot, T_flange_tcp: Array, file: Any = None
) -> tuple[tuple[LinearTerm, ...], bool]:
    """Convert a stiffness file's terms for computation.

    Args:
        terms: as the file lists them.
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        file: file name for messages.

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
        _check_location(term, len(robot.joints), where, file)
        if (term.effect, term.location) in seen:
            raise CellError(f"{term.effect} at {term.location} is given twice; keep one", file=file, where=where)
        seen.add((term.effect, term.location))
        parameters = ParameterReader(term.parameters, f"{where}.parameters", file)
        if term.effect == "geometric_stiffness":
            geometric = True
        else:
            out.append(_build_term(term, robot, T_flange_tcp, parameters))
        parameters.refuse_unread_keys()
    return tuple(out), geometric


def build_fitted_term(
    effect: str, location: str, robot: Robot, T_flange_tcp: Array, **parameters: object
) -> LinearTerm:
    """Return one term by name; without the parameters of its coefficients it is a term to be fitted.

    Args:
        effect: name of the effect.
        location: its location.
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        parameters: parameters as in the file.
    """
    terms, _ = compile_terms((StiffnessTerm(effect, location, parameters),), robot, T_flange_tcp)
    return terms[0]


def build_body_spring(term: StiffnessTerm, robot: Robot, T_flange_tcp: Array) -> body_spring.BodySpring:
    """Return a file's term of a compliant body.

    Args:
        term: term of the file.
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.

    Raises:
        InputError: as :func:`compile_terms`.
    """
    _check_location(term, len(robot.joints), "terms", None)
    parameters = ParameterReader(term.parameters, "terms.parameters", None)
    spring = body_spring.build_body_term(term.effect, robot, T_flange_tcp, parameters, term.location)
    parameters.refuse_unread_keys()
    return spring


def _check_location(term: StiffnessTerm, joints: int, where: str, file: Any) -> None:
    known = list_effects_and_locations()
    if term.effect not in known:
        hint = suggest_word(term.effect, known)
        raise CellError(
            f"effect {term.effect!r} is not known; {hint}valid: {', '.join(known)}; one of your own: --effects FILE.py",
            file=file,
            where=f"{where}.effect",
        )
    places = [place for place in known[term.effect] if is_on_arm(place, joints)]
    if term.location not in places:
        raise CellError(
            f"{term.effect} cannot be at {term.location!r}; valid: {_join_words(places)}",
            file=file,
            where=f"{where}.location",
        )


def _build_term(term: StiffnessTerm, robot: Robot, T_flange_tcp: Array, parameters: ParameterReader) -> LinearTerm:
    known = registry.find_elastic_effect(term.effect)
    if known.body_laws:
        return body_spring.build_body_term(term.effect, robot, T_flange_tcp, parameters, term.location)
    if known.parallel_torque_laws:
        return gravity_compensator.build_gravity_compensator(parameters, term.location)
    return joint_term.build_joint_term(term.effect, parameters, term.location)


def _join_words(words: Sequence[str]) -> str:
    return ", ".join(words) if len(words) <= 6 else f"{', '.join(words[:3])} … {words[-1]}"

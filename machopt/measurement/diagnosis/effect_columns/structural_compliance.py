"""Compliant bodies in static readings: each registered law, transformed to the TCP.

Weight cancels in load tests but not in measured poses. All weights beyond a spring and the recorded load act on it.
Their resultant is referred to the TCP: f = Σ m g + f_load, m = Σ (p_b − p_TCP) × m g + m_load. The own weight of a
link is distributed evenly from its root to twice the distance of its centre of mass.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import format_link_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.protocol import BodyLaw, Effect
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantity, Shape
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.numerics.array_types import Array
from machopt.stiffness.terms.body_spring import BodySpring, SpringLocation, build_spring, locate_spring
from machopt.stiffness.terms.term_builder import build_body_spring

NOTE = "out of what the joints' torques explain"
WEIGHT = ", w weight and load"


def build_structure_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the laws of all compliant bodies at all places.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    out = []
    for effect in registry.select_body_effects():
        last = format_link_location(r.joint_count)  # one body with the tool; tried as tool compliance
        for where in (p for p in r.list_places(effect.places) if p != last):
            place = locate_spring(r.robot, r.T_flange_tcp, where)
            load = compute_carried_wrench(r, place)
            laws = [law for law in effect.body_laws if r.is_difference or law.includes_weight]
            observable_laws = [
                law.restrict_to_observed(r.dimensions, turning=bool(r.wrench[:, 3:].any())) for law in laws
            ]
            for law in {
                one.name: one for one in observable_laws
            }.values():  # some laws coincide without moments or measured rotations
                grid = law.grid(place.shape)
                if grid:
                    out.append(_build_structure_hypothesis(r, effect, place, law, load, grid))
    return out if r.is_difference else [h for h in out if np.abs(h.columns(h.shapes[0])).max() > 0.0]


def compute_carried_wrench(r: StaticReadings, place: SpringLocation) -> Array:
    """Compute the wrench that a spring carries: recorded load and, in measured poses, the weight of all bodies beyond
    it.

    Args:
        r: Static readings.
        place: Location of the spring.

    Returns:
        (N, 6) N, N·m at the TCP in base axes.
    """
    if r.is_difference or r.masses is None:
        return r.wrench
    return r.wrench + compute_weight_wrench(r, r.masses.body >= place.first_loaded_body)


def compute_weight_wrench(r: StaticReadings, carried: NDArray[np.bool_]) -> Array:
    """Compute the wrench of the weight of selected bodies.

    Args:
        r: Static readings.
        carried: (B,) True for selected bodies.

    Returns:
        (N, 6) N, N·m at the TCP in base axes.
    """
    if r.masses is None or not carried.any():
        return np.zeros((len(r), 6))
    assert r.state.R_bodies is not None  # readings come with bodies
    assert r.state.p_bodies is not None
    body, mass = r.masses.body[carried], r.masses.mass[carried]
    at = np.einsum("nbij,bj->nbi", r.state.R_bodies[:, body], r.masses.com[carried]) + r.state.p_bodies[:, body]
    force = mass[:, None] * r.masses.gravity
    moment = np.cross(at - r.state.T_base_tool[:, None, :3, 3], force)
    total = np.broadcast_to(force.sum(axis=0), (len(r), 3))
    return np.concatenate([total, moment.sum(axis=1)], axis=1)


def compute_term_displacement(r: StaticReadings, term: StiffnessTerm) -> Array:
    """Compute the displacement of the readings by a body term of stiffness.yaml.

    Args:
        r: Static readings.
        term: Term of the stiffness.

    Returns:
        (N, D) m, rad.
    """
    spring = build_body_spring(term, r.robot, r.T_flange_tcp)
    return r.project_to_measured(
        _compute_tcp_twist(r, spring, compute_carried_wrench(r, spring.place)) @ spring.values,
        find_first_moved_body(spring.place),
    )


def find_first_moved_body(place: SpringLocation) -> int:
    """Return the first body that moves if a spring yields; a bending link moves itself.

    Args:
        place: Location of the spring.

    Returns:
        Body index, see :meth:`StaticReadings.project_to_measured`.
    """
    return BODY_BEHIND_FLANGE if place.location == "tool" else place.body


def _compute_tcp_twist(r: StaticReadings, spring: BodySpring, load: Array) -> Array:
    """(N, 6, P) m, rad at the TCP per unit of each coefficient."""
    out = spring.compute_response(r.state, load)
    own = [] if r.is_difference else _list_distributed_weights(r, spring.place)
    sag = spring.compute_weight_sag(r.state, own) if own else None
    return out if sag is None else out + sag


def _list_distributed_weights(r: StaticReadings, place: SpringLocation) -> list[tuple[Array, float]]:
    """Return each distributed weight of a link (3,) N and its extent from the root."""
    if r.masses is None or place.first_loaded_body == place.body or not place.shape.length:
        return []
    x = place.shape.axes[:, 0]
    root = place.end - place.shape.length * x
    return [
        (r.masses.mass[b] * r.masses.gravity, 2.0 * float((r.masses.com[b] - root) @ x))
        for b in np.flatnonzero(r.masses.body == place.body)
    ]


def _build_structure_hypothesis(
    r: StaticReadings, effect: Effect, place: SpringLocation, law: BodyLaw, load: Array, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    def made(values: Array, shape: Shape) -> BodySpring:
        return build_spring(effect.file_word, place, law, values, np.array(shape))

    count = len(law.coefficients)
    least = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, count))
    lower = least if law.bounded else ()

    def columns(shape: Shape) -> Array:
        return r.project_to_measured(
            _compute_tcp_twist(r, made(np.zeros(count), shape), load), find_first_moved_body(place)
        )

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape))

    return EffectHypothesis(
        effect=effect.file_word,
        location=place.location,
        law=law.name,
        equation=law.equation if r.is_difference else law.equation + WEIGHT,
        columns=columns,
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        correction=lambda x, shape: made(x, shape).to_file(),
        family="body",
        penalty=thresholds.LEVELS.gain_two_sigma * len(law.shape),
        project_to_plausible=None if np.isfinite(least).all() else law.project_to_admissible,
        note=law.note or (NOTE if r.is_difference else f"under weight, {NOTE}"),
    )

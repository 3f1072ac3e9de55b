"""A spring between two halves of one body: base, a link, the tool.

With S the frame where the body gives way, fixed to body b, and r from S to the TCP, a wrench (f, m) at the TCP is
(Rᵀ f, Rᵀ (m + r × f)) in S; the twist C_S w_S of S is carried back to the TCP the same way. That is G C_S Gᵀ with
G = [[R, −[r]× R], [0, R]], the congruence that keeps C symmetric and positive. Here stands where S is; what a body does
there its law says, :mod:`machopt.effects.bodies` and its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.domain.location import link_of
from machopt.domain.stiffness import Term
from machopt.effects import files, registry
from machopt.effects.bodies import LEAST_LENGTH, form_of
from machopt.effects.given import Parameters
from machopt.effects.protocol import Body, BodyLaw
from machopt.model.robot import ArmState, Robot
from machopt.model.terms.base import Coefficient, LinearTerm, Plain
from machopt.se3 import inverse, normalise, transform

LEAST_PLANE = 0.1  # sine of a link against the axis of joint 2, below which the arm has no plane there
BASE, TOOL = 0, 6  # body indices


@dataclass(frozen=True)
class Place:
    """Where a body gives way, all joints at zero."""

    location: str  # link:i, base, tool
    body: int  # 0 base_link, i link i; what S is fixed to
    end: Array  # (3,) m, origin of S in base_link
    shape: Body
    given: dict[str, Any] = field(default_factory=dict)  # keys of the file that say where

    @property
    def beyond(self) -> int:
        """The first body whose weight it bears at S or beyond; a link's own is spread along it."""
        return self.body + 1 if 0 < self.body < TOOL else self.body

    def frame(self, law: BodyLaw) -> Array:
        """(4, 4) S in base_link, with the axes of a law."""
        return transform(law.axes(self.shape), self.end)


def placed(robot: Robot, T_flange_tcp: Array, location: str, parameters: Parameters | None = None) -> Place:
    """Where the body of a location gives way: as the parameters of a file say, else at the far end of it."""
    given = Parameters({}, location) if parameters is None else parameters
    if location == "base":
        return _base(given, location)
    if location == "tool":
        return _tool(robot, T_flange_tcp, given, location)
    return _link(robot, given, location)


def spring(effect: str, place: Place, law: BodyLaw, values: Array, shape: Array) -> BodySpring:
    """A law at its place, as the planner takes it."""
    return BodySpring(
        effect=effect,
        place=place,
        law=law,
        shape=shape,
        T_base_spring=place.frame(law),
        basis=law.matrices(shape, place.shape),
        coefficients=tuple(Coefficient(*c) for c in files.named(law, len(values))),
        values=values,
    )


def body_term(effect: str, robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> BodySpring:
    """A term of one body from a file."""
    place, known = placed(robot, T_flange_tcp, location, parameters), registry.elastic(effect)
    if known.reads is not None:
        _refuse_no_beam(parameters, place)
    law, values, shape, body = files.body_law_of(known, parameters, place.shape)
    return spring(effect, replace(place, shape=body), law, values, shape)


@dataclass(frozen=True, kw_only=True)
class BodySpring(Plain):
    """Compliance C_S = Σ_p x_p C_p in a frame fixed to one body."""

    effect: str
    place: Place
    law: BodyLaw
    shape: Array  # (S,) of the law
    T_base_spring: Array  # (4, 4) the frame S in base_link at q = 0
    basis: Array  # (P, 6, 6) SI, local axes at S
    coefficients: tuple[Coefficient, ...]
    values: Array  # (P,)

    @property
    def location(self) -> str:
        return self.place.location

    @property
    def body(self) -> int:
        """0 base_link, i link i."""
        return self.place.body

    @cached_property
    def _in_body(self) -> Array:
        """(6, P·6) the matrices side by side in the axes of the body at q = 0, so that S needs no turning."""
        turn = np.kron(np.eye(2), self.T_base_spring[:3, :3])
        return np.asarray((turn @ self.basis @ turn.T).transpose(2, 0, 1).reshape(6, -1))

    def response(self, state: ArmState, wrench: Array) -> Array:
        if state.R_bodies is None or state.p_bodies is None:
            raise ValueError("an ArmState with bodies is needed")
        R, moved = state.R_bodies[..., self.body, :, :], state.p_bodies[..., self.body, :]
        r = state.T_base_tool[..., :3, 3] - moved - R @ self.T_base_spring[:3, 3]
        force, moment = wrench[..., :3], wrench[..., 3:] + cross(r, wrench[..., :3])
        local = np.concatenate(
            [np.einsum("...ji,...j->...i", R, force), np.einsum("...ji,...j->...i", R, moment)], axis=-1
        )
        twist = (local @ self._in_body).reshape(*local.shape[:-1], len(self.basis), 6)
        turn = np.einsum("...ij,...pj->...pi", R, twist[..., 3:])
        shift = np.einsum("...ij,...pj->...pi", R, twist[..., :3]) + cross(turn, r[..., None, :])
        return np.swapaxes(np.concatenate([shift, turn], axis=-1), -1, -2)

    def sag(self, state: ArmState, own: list[tuple[Array, float]]) -> Array | None:
        """(M, 6, P) twist of the TCP under weights spread along the body; None: the law counts them at S.

        Args:
            state: M configurations with bodies.
            own: of each weight the whole of it (3,) N in base_link axes, and how far from the root it reaches, m.
        """
        if state.R_bodies is None or state.p_bodies is None:
            raise ValueError("an ArmState with bodies is needed")
        R, moved = state.R_bodies[:, self.body], state.p_bodies[:, self.body]
        A = R @ self.T_base_spring[:3, :3]
        twist = self.law.sags(self.shape, self.place.shape, [(np.einsum("mji,j->mi", A, w), span) for w, span in own])
        if twist is None:
            return None
        r = state.T_base_tool[:, :3, 3] - moved - R @ self.T_base_spring[:3, 3]
        turn, shift = A @ twist[:, 3:], A @ twist[:, :3]
        return np.concatenate([shift + np.cross(turn, r[:, :, None], axis=1), turn], axis=1)

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def folded(self) -> BodySpring:
        """The same spring with its matrices added up into one: what it does under load, in a fraction of the time."""
        C = np.einsum("p,pij->ij", self.values, self.basis)
        return replace(self, basis=C[None], coefficients=(Coefficient("scale", "1"),), values=np.ones(1))

    def to_file(self) -> Term:
        stated = self.law.stated(self.values, self.shape, self.place.shape)
        return Term(self.effect, self.location, {**self.place.given, **stated})


def _link(robot: Robot, parameters: Parameters, location: str) -> Place:
    link = link_of(location)
    points = [*robot.point, robot.T_base_flange_zero[:3, 3]]
    start = parameters.array("from_mm", (3,), points[link - 1] * 1e3) / 1e3
    end = parameters.array("to_mm", (3,), points[link] * 1e3) / 1e3
    given = {k: parameters.array(k, (3,)).tolist() for k in ("from_mm", "to_mm") if parameters.has(k)}
    length = float(np.linalg.norm(end - start))
    if length < LEAST_LENGTH:
        return Place(location, link, end, Body(axes=np.eye(3)), given)
    body = Body(axes=beam_axes(end - start), length=length, normal=_across(robot, (end - start) / length))
    return Place(location, link, end, body, given)


def _refuse_no_beam(parameters: Parameters, place: Place) -> None:
    """Raise where a file means a beam and nothing gives it a length."""
    if place.shape.length > 0.0 or place.location == "base":
        return
    if place.location == "tool" and (parameters.has("length_mm") or parameters.has("cylinders")):
        return
    if form_of(parameters, beam=True) != "beam":  # a matrix needs no length
        return
    if place.location == "tool":
        raise parameters.error(
            "length_mm",
            "is missing, and the TCP lies beside the flange, across the tool axis, which gives a beam "
            "no length; length_mm or a matrix (compliance, compliance_diagonal, form: diagonal) would work",
        )
    link = place.body
    raise parameters.error(
        "",
        f"the origins of joint {link} and the next are less than {LEAST_LENGTH * 1e3:g} mm apart, which makes no beam; "
        "from_mm and to_mm (base_link coordinates with all joints at zero) would say where it is; a matrix "
        "(compliance, compliance_diagonal) needs no length",
    )


def _across(robot: Robot, along: Array) -> Array:
    """(3,) normal of the arm's plane, square to a link; any that is square to it where the link has no plane."""
    normal = robot.axis[1] - (robot.axis[1] @ along) * along
    if np.linalg.norm(normal) < LEAST_PLANE:
        least = int(np.abs(along).argmin())
        normal = np.eye(3)[least] - along[least] * along
    return np.asarray(normal / np.linalg.norm(normal))


def _base(parameters: Parameters, location: str) -> Place:
    at = parameters.array("at_mm", (3,), np.zeros(3)) / 1e3
    given = {"at_mm": (at * 1e3).tolist()} if parameters.has("at_mm") else {}
    return Place(location, BASE, at, Body(axes=np.eye(3)), given)


def _tool(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> Place:
    T_base_tcp = robot.T_base_flange_zero @ T_flange_tcp
    axis = T_base_tcp[:3, 2]
    reach = abs(float(axis @ (T_base_tcp[:3, 3] - robot.T_base_flange_zero[:3, 3])))
    reach = reach if reach > LEAST_LENGTH else 0.0
    length = parameters.number("length_mm", reach * 1e3, positive=reach > 0.0) / 1e3
    given = {"length_mm": length * 1e3} if parameters.has("length_mm") else {}
    S = transform(beam_axes(axis), T_base_tcp[:3, 3])  # at the TCP, x out of the tool
    root = inverse(S) @ robot.T_base_flange_zero
    return Place(location, TOOL, S[:3, 3], Body(axes=S[:3, :3], length=length, root=root, turned=True), given)


def cross(a: Array, b: Array) -> Array:
    """a × b over the last axis; a third of the time of numpy.cross."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def beam_axes(direction: Array) -> Array:
    """(3, 3) rotation whose x is along ``direction``."""
    x = normalise(direction)
    helper = np.eye(3)[int(np.abs(x).argmin())]
    y = normalise(np.cross(helper, x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)

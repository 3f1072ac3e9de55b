"""Spring between two halves of one body: base, a link, the tool.

With S the frame of the compliance, fixed to body b, and r from S to the TCP, a wrench (f, m) at the TCP is
(Rᵀ f, Rᵀ (m + r × f)) in S; the twist C_S w_S of S is transformed back to the TCP the same way. That is G C_S Gᵀ with
G = [[R, −[r]× R], [0, R]], the congruence that keeps C symmetric and positive. This module defines the location of S;
the law of a body is in :mod:`machopt.effects.compliance_matrices.body_compliance_laws` and its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from machopt.data_types.effect_locations import parse_link_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion, registry
from machopt.effects.compliance_matrices.body_compliance_laws import find_parameter_form
from machopt.effects.compliance_matrices.uniform_beam_law import LEAST_LENGTH
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody
from machopt.kinematics.robot import ArmState, Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, cross_product, invert_transform, normalise_vectors
from machopt.stiffness.terms.term_interface import DefaultTerm, LinearTerm, TermCoefficient

MIN_PLANE_SINE = 0.1  # sine of a link against the axis of joint 2, below which the arm has no plane there
BASE = 0  # body index


@dataclass(frozen=True, kw_only=True)
class SpringLocation:
    """Location of a body's compliance, with all joints at zero."""

    location: str  # link:i, base, tool
    body: int  # 0 base_link, i link i; what S is fixed to
    end: Array  # (3,) m, origin of S in base_link
    shape: CompliantBody
    file_parameters: dict[str, Any] = field(default_factory=dict)  # keys of the file that define the location
    is_tool: bool = False  # behind the flange: the body is the last link

    @property
    def first_loaded_body(self) -> int:
        """First body whose weight loads the spring; a link's own weight is distributed along it."""
        return self.body if self.body == BASE or self.is_tool else self.body + 1

    def compute_frame(self, law: BodyLaw) -> Array:
        """Return (4, 4) S in base_link, with the axes of a law.

        Args:
            law: law of the body.
        """
        return build_transform(law.axes(self.shape), self.end)


def locate_spring(
    robot: Robot, T_flange_tcp: Array, location: str, parameters: ParameterReader | None = None
) -> SpringLocation:
    """Return the location of a body's compliance: from the parameters of a file, else at its far end.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        location: link:i, base or tool.
        parameters: parameters of the file; None: none.
    """
    reader = ParameterReader({}, location) if parameters is None else parameters
    if location == "base":
        return _locate_in_base(reader, location)
    if location == "tool":
        return _locate_in_tool(robot, T_flange_tcp, reader, location)
    return _locate_in_link(robot, reader, location)


def build_spring(effect: str, place: SpringLocation, law: BodyLaw, values: Array, shape: Array) -> BodySpring:
    """Return a law at its location, as a term for the planner.

    Args:
        effect: name of the effect.
        place: location of the spring.
        law: law of the body.
        values: (P,) coefficients, SI.
        shape: (S,) shape parameters of the law.
    """
    return BodySpring(
        effect=effect,
        place=place,
        law=law,
        shape=shape,
        T_base_spring=place.compute_frame(law),
        basis=law.matrices(shape, place.shape),
        coefficients=tuple(TermCoefficient(*c) for c in parameter_conversion.list_coefficient_names(law, len(values))),
        values=values,
    )


def build_body_term(
    effect: str, robot: Robot, T_flange_tcp: Array, parameters: ParameterReader, location: str
) -> BodySpring:
    """Return a term of one body from a file.

    Args:
        effect: name of the effect.
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        parameters: parameters of the file.
        location: link:i, base or tool.
    """
    place, known = locate_spring(robot, T_flange_tcp, location, parameters), registry.find_elastic_effect(effect)
    if known.file_reader is not None:
        _check_beam_length(parameters, place)
    law, values, shape, body = parameter_conversion.find_body_law(known, parameters, place.shape)
    return build_spring(effect, replace(place, shape=body), law, values, shape)


@dataclass(frozen=True, kw_only=True)
class BodySpring(DefaultTerm):
    """Compliance C_S = Σ_p x_p C_p in a frame fixed to one body."""

    effect: str
    place: SpringLocation
    law: BodyLaw
    shape: Array  # (S,) of the law
    T_base_spring: Array  # (4, 4) the frame S in base_link at q = 0
    basis: Array  # (P, 6, 6) SI, local axes at S
    coefficients: tuple[TermCoefficient, ...]
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
        """(6, P·6) the matrices side by side in the axes of the body at q = 0, so that no rotation to S is needed."""
        turn = np.kron(np.eye(2), self.T_base_spring[:3, :3])
        return np.asarray((turn @ self.basis @ turn.T).transpose(2, 0, 1).reshape(6, -1))

    def compute_response(self, state: ArmState, wrench: Array) -> Array:
        """Return the (M, 6, P) twist of the TCP per unit of each coefficient, base_link axes.

        Args:
            state: M configurations with bodies.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Raises:
            ValueError: the state has no bodies.
        """
        if state.R_bodies is None or state.p_bodies is None:
            raise ValueError("an ArmState with bodies is needed")
        R, moved = state.R_bodies[..., self.body, :, :], state.p_bodies[..., self.body, :]
        r = state.T_base_tool[..., :3, 3] - moved - R @ self.T_base_spring[:3, 3]
        force, moment = wrench[..., :3], wrench[..., 3:] + cross_product(r, wrench[..., :3])
        local = np.concatenate(
            [np.einsum("...ji,...j->...i", R, force), np.einsum("...ji,...j->...i", R, moment)], axis=-1
        )
        twist = (local @ self._in_body).reshape(*local.shape[:-1], len(self.basis), 6)
        turn = np.einsum("...ij,...pj->...pi", R, twist[..., 3:])
        shift = np.einsum("...ij,...pj->...pi", R, twist[..., :3]) + cross_product(turn, r[..., None, :])
        return np.swapaxes(np.concatenate([shift, turn], axis=-1), -1, -2)

    def compute_weight_sag(self, state: ArmState, own: list[tuple[Array, float]]) -> Array | None:
        """Return the (M, 6, P) twist of the TCP under weights distributed along the body; None: the law applies them at
        S.

        Args:
            state: M configurations with bodies.
            own: each weight (3,) N in base_link axes, and its extent from the root in m.
        """
        if state.R_bodies is None or state.p_bodies is None:
            raise ValueError("an ArmState with bodies is needed")
        R, moved = state.R_bodies[:, self.body], state.p_bodies[:, self.body]
        A = R @ self.T_base_spring[:3, :3]
        twist = self.law.compute_own_weight_deflection(
            self.shape, self.place.shape, [(np.einsum("mji,j->mi", A, w), span) for w, span in own]
        )
        if twist is None:
            return None
        r = state.T_base_tool[:, :3, 3] - moved - R @ self.T_base_spring[:3, 3]
        turn, shift = A @ twist[:, 3:], A @ twist[:, :3]
        return np.concatenate(
            [shift + np.swapaxes(cross_product(np.swapaxes(turn, 1, 2), r[:, None]), 1, 2), turn], axis=1
        )

    def with_values(self, values: Array) -> LinearTerm:
        """Return the same term with other coefficients.

        Args:
            values: (P,) SI.
        """
        return replace(self, values=np.asarray(values, float))

    def combine_coefficients(self) -> BodySpring:
        """Return the same spring with its matrices summed into one, which is much faster to evaluate."""
        C = np.einsum("p,pij->ij", self.values, self.basis)
        return replace(self, basis=C[None], coefficients=(TermCoefficient("scale", "1"),), values=np.ones(1))

    def to_file(self) -> StiffnessTerm:
        stated = self.law.to_file_parameters(self.values, self.shape, self.place.shape)
        return StiffnessTerm(self.effect, self.location, {**self.place.file_parameters, **stated})


def _locate_in_link(robot: Robot, parameters: ParameterReader, location: str) -> SpringLocation:
    link = parse_link_location(location)
    points = [*robot.point, robot.T_base_flange_zero[:3, 3]]
    start = parameters.read_array("from_mm", (3,), points[link - 1] * 1e3) / 1e3
    end = parameters.read_array("to_mm", (3,), points[link] * 1e3) / 1e3
    file_parameters = {
        k: parameters.read_array(k, (3,)).tolist() for k in ("from_mm", "to_mm") if parameters.has_key(k)
    }
    length = float(np.linalg.norm(end - start))
    if length < LEAST_LENGTH:
        return SpringLocation(
            location=location,
            body=link,
            end=end,
            shape=CompliantBody(axes=np.eye(3)),
            file_parameters=file_parameters,
        )
    body = CompliantBody(
        axes=build_beam_axes(end - start), length=length, normal=_compute_plane_normal(robot, (end - start) / length)
    )
    return SpringLocation(location=location, body=link, end=end, shape=body, file_parameters=file_parameters)


def _check_beam_length(parameters: ParameterReader, place: SpringLocation) -> None:
    """Raise where a file defines a beam without a length."""
    if place.shape.length > 0.0 or place.location == "base":
        return
    if place.location == "tool" and (parameters.has_key("length_mm") or parameters.has_key("cylinders")):
        return
    if find_parameter_form(parameters, beam=True) != "beam":  # a matrix needs no length
        return
    if place.location == "tool":
        raise parameters.build_error(
            "length_mm",
            "is missing, and the TCP is offset from the flange across the tool axis, which gives a beam "
            "no length; length_mm or a matrix (compliance, compliance_diagonal, form: diagonal) would work",
        )
    link = place.body
    raise parameters.build_error(
        "",
        f"the origins of joint {link} and the next are less than {LEAST_LENGTH * 1e3:g} mm apart, which makes no beam; "
        "from_mm and to_mm (base_link coordinates with all joints at zero) would say where it is; a matrix "
        "(compliance, compliance_diagonal) needs no length",
    )


def _compute_plane_normal(robot: Robot, along: Array) -> Array:
    """Return (3,) the normal of the arm's plane, orthogonal to a link; any orthogonal direction where there is no
    plane.
    """
    normal = robot.axis[1] - (robot.axis[1] @ along) * along
    if np.linalg.norm(normal) < MIN_PLANE_SINE:
        least = int(np.abs(along).argmin())
        normal = np.eye(3)[least] - along[least] * along
    return np.asarray(normal / np.linalg.norm(normal))


def _locate_in_base(parameters: ParameterReader, location: str) -> SpringLocation:
    at = parameters.read_array("at_mm", (3,), np.zeros(3)) / 1e3
    file_parameters = {"at_mm": (at * 1e3).tolist()} if parameters.has_key("at_mm") else {}
    return SpringLocation(
        location=location, body=BASE, end=at, shape=CompliantBody(axes=np.eye(3)), file_parameters=file_parameters
    )


def _locate_in_tool(robot: Robot, T_flange_tcp: Array, parameters: ParameterReader, location: str) -> SpringLocation:
    T_base_tcp = robot.T_base_flange_zero @ T_flange_tcp
    axis = T_base_tcp[:3, 2]
    reach = abs(float(axis @ (T_base_tcp[:3, 3] - robot.T_base_flange_zero[:3, 3])))
    reach = reach if reach > LEAST_LENGTH else 0.0
    length = parameters.read_number("length_mm", reach * 1e3, positive=reach > 0.0) / 1e3
    file_parameters = {"length_mm": length * 1e3} if parameters.has_key("length_mm") else {}
    S = build_transform(build_beam_axes(axis), T_base_tcp[:3, 3])  # at the TCP, x out of the tool
    root = invert_transform(S) @ robot.T_base_flange_zero
    return SpringLocation(
        location=location,
        body=len(robot.joints),
        end=S[:3, 3],
        shape=CompliantBody(axes=S[:3, :3], length=length, root=root, uses_own_axes=True),
        file_parameters=file_parameters,
        is_tool=True,
    )


def build_beam_axes(direction: Array) -> Array:
    """Return the (3, 3) rotation whose x is along a direction.

    Args:
        direction: (3,), not zero.
    """
    x = normalise_vectors(direction)
    helper = np.eye(3)[int(np.abs(x).argmin())]
    y = normalise_vectors(np.cross(helper, x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)

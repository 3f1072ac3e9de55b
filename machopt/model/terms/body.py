"""A spring between two halves of one body: base, a link, the tool.

With S the frame where the body gives way, fixed to body b, and r from S to the TCP, a wrench (f, m) at the TCP is
(Rᵀ f, Rᵀ (m + r × f)) in S; the twist C_S w_S of S is carried back to the TCP the same way. That is G C_S Gᵀ with
G = [[R, −[r]× R], [0, R]], the congruence that keeps C symmetric and positive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.domain.stiffness import Term
from machopt.effects import files
from machopt.effects.beam import Cylinder, stepped
from machopt.effects.bodies import NORMAL, Beam
from machopt.effects.files import Parameters
from machopt.model.robot import ArmState, Robot
from machopt.model.terms.base import Coefficient, LinearTerm, Maker
from machopt.se3 import normalise, skew, transform

Array = NDArray[np.float64]
LEAST_LENGTH = 1e-3  # m; joints nearer than this make no beam
LEAST_SINE = 1e-3  # of the angle between a beam and its principal axis
ROWS = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True)
class BodySpring:
    """Compliance C_S = Σ_p x_p C_p in a frame fixed to one body."""

    effect: str
    location: str
    body: int  # 0 base_link, i link i
    T_base_spring: Array  # (4, 4) the frame S in base_link at q = 0
    basis: Array  # (P, 6, 6) SI, local axes at S
    coefficients: tuple[Coefficient, ...]
    values: Array  # (P,)
    written: Callable[[Array], dict[str, Any]] = field(compare=False)  # values → parameters of the file

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

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def folded(self) -> BodySpring:
        """The same spring with its matrices added up into one: what it does under load, in a fraction of the time."""
        C = np.einsum("p,pij->ij", self.values, self.basis)
        return replace(self, basis=C[None], coefficients=(Coefficient("scale", "1"),), values=np.ones(1))

    def to_file(self) -> Term:
        return Term(self.effect, self.location, self.written(self.values))


def _link(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    link = int(location.removeprefix("link:"))
    points = [*robot.point, robot.T_base_flange_zero[:3, 3]]
    start = parameters.array("from_mm", (3,), points[link - 1] * 1e3) / 1e3
    end = parameters.array("to_mm", (3,), points[link] * 1e3) / 1e3
    length = float(np.linalg.norm(end - start))
    if length < LEAST_LENGTH and _form(parameters, beam=True) == "beam":
        raise parameters.error(
            "",
            f"the origins of joint {link} and the next are {length * 1e3:.3g} mm apart, which makes no beam; "
            "from_mm and to_mm (base_link coordinates with all joints at zero) would say where it is; a matrix "
            "(compliance, compliance_diagonal) needs no length",
        )
    S = transform(beam_axes(end - start) if length >= LEAST_LENGTH else np.eye(3), end)
    given = {k: parameters.array(k, (3,)).tolist() for k in ("from_mm", "to_mm") if parameters.has(k)}
    return _spring("link_compliance", location, link, S, length, parameters, given)


def _base(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    at = parameters.array("at_mm", (3,), np.zeros(3)) / 1e3
    given = {"at_mm": (at * 1e3).tolist()} if parameters.has("at_mm") else {}
    return _spring("base_compliance", location, 0, transform(np.eye(3), at), 0.0, parameters, given)


def _tool(robot: Robot, T_flange_tcp: Array, parameters: Parameters, location: str) -> LinearTerm:
    T_base_tcp = robot.T_base_flange_zero @ T_flange_tcp
    axis = T_base_tcp[:3, 2]
    reach = abs(float(axis @ (T_base_tcp[:3, 3] - robot.T_base_flange_zero[:3, 3])))
    if reach <= LEAST_LENGTH and not (parameters.has("length_mm") or parameters.has("cylinders")):
        if _form(parameters, beam=True) == "beam":  # a matrix needs no length
            raise parameters.error(
                "length_mm",
                "is missing, and the TCP lies beside the flange, across the tool axis, which gives a beam "
                "no length; length_mm or a matrix (compliance, compliance_diagonal, form: diagonal) would work",
            )
        reach = 0.0
    length = parameters.number("length_mm", reach * 1e3, positive=reach > 0.0) / 1e3
    given = {"length_mm": length * 1e3} if parameters.has("length_mm") else {}
    S = transform(beam_axes(axis), T_base_tcp[:3, 3])  # at the TCP, x out of the tool
    if parameters.has("cylinders"):
        fixed, stated = _tool_stack(robot, T_base_tcp, S, parameters)
        scale = Coefficient("scale", "1")
        return BodySpring(
            "tool_compliance",
            location,
            6,
            S,
            fixed[None],
            (scale,),
            np.array([parameters.number("scale", 1.0)]),
            lambda x: {**stated, "scale": float(x[0])},
        )
    return _spring("tool_compliance", location, 6, S, length, parameters, given)


def _tool_stack(robot: Robot, T_base_tcp: Array, S: Array, parameters: Parameters) -> tuple[Array, dict[str, Any]]:
    """Stepped cylinders (tian2025 eqs. 2–3, with lever arms) and a force sensor at the flange, seen from the TCP."""
    stated: dict[str, Any] = {"cylinders": parameters.mappings("cylinders")}
    steps = []
    for n, entry in enumerate(stated["cylinders"]):
        one = parameters.inner(f"cylinders[{n}]", entry)
        bore = one.number("bore_mm", 0.0, positive=False) / 1e3
        step = Cylinder(
            one.number("diameter_mm") / 1e3,
            one.number("length_mm") / 1e3,
            one.number("youngs_GPa") * 1e9,
            one.number("poisson", 0.3),
            bore,
        )
        one.finish()
        if not 0 <= bore < step.diameter:
            raise one.error("bore_mm", "expected at least 0 and less than the diameter")
        steps.append(step)
    C = stepped(steps)
    if parameters.has("sensor_N_per_mm") or parameters.has("sensor_Nm_per_rad"):
        # the sensor sits at the flange, its axes are the flange's
        linear = parameters.array("sensor_N_per_mm", (3,), np.full(3, np.inf)) * 1e3
        angular = parameters.array("sensor_Nm_per_rad", (3,), np.full(3, np.inf))
        for key, values in (("sensor_N_per_mm", linear), ("sensor_Nm_per_rad", angular)):
            if not (values > 0).all():
                raise parameters.error(key, "expected three stiffnesses above zero")
            if np.isfinite(values).all():
                stated[key] = (values / (1e3 if key.endswith("mm") else 1.0)).tolist()
        local = np.diag(np.concatenate([1.0 / linear, 1.0 / angular]))
        flange = robot.T_base_flange_zero
        G = np.eye(6)
        r = S[:3, 3] - flange[:3, 3]
        G[:3, 3:] = -skew(r)
        turn = np.kron(np.eye(2), flange[:3, :3])
        back = np.kron(np.eye(2), S[:3, :3])
        C = C + back.T @ G @ turn @ local @ turn.T @ G.T @ back
    return C, stated


def _spring(
    effect: str, location: str, body: int, S: Array, length: float, parameters: Parameters, given: dict[str, Any]
) -> BodySpring:
    """A beam (coefficients 1/EI, 1/GJ, 1/EA), or a symmetric matrix with 21 coefficients, or its diagonal."""
    form = _form(parameters, beam=length > 0)
    if form == "beam":
        beam = Beam.stating(parameters.keys)
        normal = _normal(parameters, S) if beam.planes else None
        if normal is not None:
            S = transform(np.stack([S[:3, 0], np.cross(normal, S[:3, 0]), normal], axis=-1), S[:3, 3])
        values, _, _ = files.read(beam, parameters)
        coefficients = tuple(Coefficient(*c) for c in files.named(beam, len(values)))

        def written(x: Array) -> dict[str, Any]:
            return {**given, **beam.stated(x, normal)}

        return BodySpring(effect, location, body, S, beam.matrices(length), coefficients, values, written)
    if effect != "tool_compliance":
        S = transform(np.eye(3), S[:3, 3])  # matrices stand in base_link axes at q = 0, the tool's in beam axes
    pairs = [(i, j) for i in range(6) for j in range(i, 6) if form == "full" or i == j]
    basis = np.zeros((len(pairs), 6, 6))
    for p, (i, j) in enumerate(pairs):
        basis[p, i, j] = basis[p, j, i] = 1.0
    coefficients = tuple(
        Coefficient(ROWS[i] if i == j else f"{ROWS[i]}·{ROWS[j]}", _unit(i, j), 0.0 if i == j else -np.inf)
        for i, j in pairs
    )
    if form == "full":
        C = parameters.array("compliance", (6, 6), np.full((6, 6), np.nan))
        if np.isfinite(C).all():
            _semidefinite(parameters, C)
        key, values = "compliance", np.array([C[i, j] for i, j in pairs])
    else:
        key, values = "compliance_diagonal", parameters.array("compliance_diagonal", (6,), np.full(6, np.nan))
        if (values < 0).any():
            raise parameters.error(key, "expected compliances of at least zero")

    def matrix(x: Array) -> dict[str, Any]:
        full = np.einsum("p,pij->ij", x, basis)
        return {**given, key: full.tolist() if form == "full" else np.diag(full).tolist()}

    return BodySpring(effect, location, body, S, basis, coefficients, values, matrix)


def _normal(parameters: Parameters, S: Array) -> Array:
    """(3,) the principal axis that a beam states, made square to it."""
    stated = parameters.array(NORMAL, (3,))
    square = stated - (stated @ S[:3, 0]) * S[:3, 0]
    if not np.linalg.norm(square) > LEAST_SINE * np.linalg.norm(stated):
        raise parameters.error(NORMAL, f"found {stated.tolist()}, along the beam; an axis across it would work")
    return normalise(square)


def _form(parameters: Parameters, *, beam: bool) -> str:
    if parameters.has("compliance"):
        return "full"
    if parameters.has("compliance_diagonal"):
        return "diagonal"
    if not parameters.has("form"):
        return "beam" if beam else "diagonal"
    form = parameters.word("form")
    valid = ("beam", "diagonal", "full") if beam else ("diagonal", "full")
    if form not in valid:
        raise parameters.error("form", f"found {form!r}; valid: {', '.join(valid)}")
    return form


def _semidefinite(parameters: Parameters, C: Array) -> None:
    if not np.allclose(C, C.T, rtol=1e-6, atol=1e-9 * np.abs(C).max()):
        raise parameters.error("compliance", "is not symmetric; a compliance is")
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    if np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -1e-9 or (np.diag(C) < 0).any():
        raise parameters.error("compliance", "gives way against the load in some direction (a negative eigenvalue)")


def _unit(i: int, j: int) -> str:
    return ("m/N", "1/N", "rad/(N·m)")[(i > 2) + (j > 2)]


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


MAKERS: dict[str, Maker] = {"link_compliance": _link, "base_compliance": _base, "tool_compliance": _tool}

"""Terms of a stiffness file, implemented a second time: their effect on joints and bodies.

Every law follows its description in docs/measure.md and in the stiffness file, on pinocchio's frames:

Every law is written from its description in docs/measure.md and in the stiffness file, on pinocchio's frames:

* in the joints, linear: coupling, springs by angle (harmonics or a sector), creep fully relaxed → a 6×6 compliance;
* in one joint, along a curve φ of its torque: knees and the cubic over weight and process together, backlash likewise,
  hysteresis (play, used up or not, or a drag that grows to its end) over the process alone. A process torque τ on top
  of weight g turns the joint by φ(g + τ) − φ(g), a small one by φ'(g) τ (hysteresis: the slope beyond its threshold);
* the balancer of joint 2: a second spring beside the gear;
* between two halves of a body: base, link, tool → a 6×6 compliance in a frame that moves with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.data_types.effect_locations import parse_joint_location, parse_link_location, parse_location
from machopt.data_types.stiffness import StiffnessTerm
from machopt.numerics.array_types import Array

ANGLE_DEPENDENT_EFFECT = "joint_pose_dependent_stiffness"
HARMONIC_KEYS = ("cos_rad_per_Nm", "sin_rad_per_Nm", "cos2_rad_per_Nm", "sin2_rad_per_Nm")
MAX_HARDENING_SHARE = 0.9  # of a joint's compliance that a hardening cubic may take before it goes on along its tangent


class UnknownTermError(ValueError):
    """Term of a stiffness file without a law in this module."""


@dataclass(frozen=True)
class TorqueCurve:
    """Joint whose rotation is a curve over its torque."""

    joint: int  # 0-based
    form: str  # clipped | cubic | play | used | drag
    size: Array  # (P,) rad/(N·m), of the cubic rad/(N·m)³, of drag and of play that is used up rad
    bound: Array  # (P,) N·m, where each piece ends (of the cubic: where its tangent takes over; of drag: its reach)
    reach: float = np.nan  # N·m within which play is used up

    @property
    def feels_weight(self) -> bool:
        return self.form not in ("play", "used", "drag")

    def compute_rotation(self, torque: Array) -> Array:
        """Return the (N,) rotation φ, rad.

        Args:
            torque: (N,) joint torques, N·m.
        """
        t = torque[:, None]
        if self.form == "drag":
            return np.asarray((np.exp(-np.abs(t) / self.bound) - 1.0) * np.sign(t) @ self.size)
        near = np.clip(t, -self.bound, self.bound)
        if self.form == "used":
            return np.asarray(np.tanh((t - near) / self.reach) @ self.size)
        if self.form == "cubic":
            slope = np.where(np.isfinite(self.bound), 3.0 * np.minimum(np.abs(t), self.bound) ** 2, 0.0)
            return np.asarray((near**3 + slope * (t - near)) @ self.size)
        return np.asarray((t - near if self.form == "play" else near) @ self.size)

    def compute_slope(self, torque: Array) -> Array:
        """Return the (N,) slope φ', rad/(N·m); of play beyond its thresholds, of drag where it is fully grown.

        Args:
            torque: (N,) joint torques, N·m.
        """
        t = np.abs(torque)[:, None]
        if self.form == "drag":
            return np.zeros(torque.shape)
        if self.form == "used":
            beyond = np.maximum(t - self.bound, 0.0) / self.reach
            return np.asarray(np.cosh(np.minimum(beyond, 300.0)) ** -2.0 @ self.size / self.reach)
        if self.form == "cubic":
            return np.asarray(3.0 * np.minimum(t, self.bound) ** 2 @ self.size)
        return np.asarray(np.where((t < self.bound) | (self.form == "play"), self.size, 0.0).sum(axis=1))

    @property
    def minimum_slope(self) -> float:
        """Least value of φ', rad/(N·m); drag is stiffest at first."""
        if self.form == "drag":
            return -float((self.size / self.bound).sum())
        return float(self.compute_slope(np.append(0.999999 * self.bound, 1e12)).min())


def compute_joint_compliance(terms: Sequence[StiffnessTerm], q: Array) -> Array:
    """Return the (N, 6, 6) compliance of the linear joint terms, rad/(N·m).

    Args:
        terms: Terms of the stiffness file.
        q: (N, 6) true joint angles, rad.
    """
    out = np.zeros((len(q), 6, 6))
    for term in terms:
        if term.effect == "joint_coupling":
            i, j = parse_joint_location(term.location)
            out[:, i, j] += term.parameters["compliance_rad_per_Nm"]
            out[:, j, i] += term.parameters["compliance_rad_per_Nm"]
        elif term.effect in (ANGLE_DEPENDENT_EFFECT, "joint_creep"):
            i = _get_joint(term)
            out[:, i, i] += compute_angle_dependent_compliance(term, q[:, i])
    return out


def compute_angle_dependent_compliance(term: StiffnessTerm, angle: Array) -> Array:
    """Return the (N,) compliance that an angle-dependent spring or a creep adds to its joint, rad/(N·m).

    Args:
        term: Term of the stiffness file.
        angle: (N,) true angle of the joint, rad.
    """
    p = term.parameters
    if term.effect == "joint_creep":
        return np.full(angle.shape, float(_get_row(p, "extra_rad_per_Nm").sum()))  # however late each part comes
    if p.get("law") == "sector":
        off = (angle - np.radians(p["centre_deg"])) / np.radians(p["width_deg"])
        return np.asarray(p["extra_rad_per_Nm"] * np.exp(-(off**2) / 2.0))
    a1, b1, a2, b2 = (float(p.get(name, 0.0)) for name in HARMONIC_KEYS)
    return np.asarray((a1 + 1j * b1).conjugate() * np.exp(1j * angle) + (a2 - 1j * b2) * np.exp(2j * angle)).real


def compute_balancer_stiffness(terms: Sequence[StiffnessTerm], q2: Array) -> Array:
    """Return the (N,) stiffness that a balancer adds in parallel to the gear of joint 2, N·m/rad.

    U(q) = F₀ s + ½ k s² of the distance s of the pivots, s² = a² + L² + 2 a L cos(α + q); the stiffness is U''.

    Args:
        terms: Terms of the stiffness file.
        q2: (N,) true angles of joint 2, rad.
    """
    out = np.zeros(q2.shape)
    for term in terms:
        if term.effect == "gravity_compensator":
            p = term.parameters
            rho, angle = float(p["ratio"]), np.radians(p["angle_deg"]) + q2
            s = np.sqrt(1.0 + rho * rho + 2.0 * rho * np.cos(angle))
            first = -rho * np.sin(angle) / s
            second = (-rho * np.cos(angle) - first**2) / s
            # ½ (s²)'' = −ρ cos
            out += p["force_times_length_Nm"] * second - p["rate_times_length2_Nm"] * rho * np.cos(angle)
    return out


def build_torque_curves(terms: Sequence[StiffnessTerm], k: Array, lower: Array, upper: Array) -> list[TorqueCurve]:
    """Return the curves of rotation over torque, one for each term that is one.

    Args:
        terms: Terms of the stiffness file.
        k: (C, 6) stiffness of every grid cell and of the constant model, N·m/rad; a hardening cubic must leave a
            tenth of it.
        lower: (6,) lower joint limits, rad.
        upper: (6,) upper joint limits, rad.
    """
    out: list[TorqueCurve] = []
    hardening: list[TorqueCurve] = []
    for term in terms:
        p, i = term.parameters, _get_joint(term)
        if term.effect == "joint_backlash":
            bound = np.atleast_1d(float(p["transition_Nm"]))
            out.append(TorqueCurve(i, "clipped", np.radians(p["width_arcmin"] / 60.0) / (2.0 * bound), bound))
        elif term.effect == "joint_hysteresis" and p.get("law") == "bouc_wen":
            out.append(TorqueCurve(i, "drag", np.radians(_get_row(p, "drag_arcmin") / 60.0), _get_row(p, "reach_Nm")))
        elif term.effect == "joint_hysteresis" and p.get("law") == "used_up":
            size, bound = np.radians(_get_row(p, "half_clearance_arcmin") / 60.0), _get_row(p, "threshold_Nm")
            out.append(TorqueCurve(i, "used", size, bound, float(p["reach_Nm"])))
        elif term.effect == "joint_hysteresis":
            out.append(TorqueCurve(i, "play", _get_row(p, "weights_rad_per_Nm"), _get_row(p, "thresholds_Nm")))
        elif term.effect == "joint_nonlinear_stiffness" and p["law"] == "cubic":
            size = _get_row(p, "cubic_rad_per_Nm3")
            (hardening if size[0] < 0 else out).append(TorqueCurve(i, "cubic", size, np.array([np.inf])))
        elif term.effect == "joint_nonlinear_stiffness":
            knee = "knee_Nm" if p["law"] == "knee" else "knees_Nm"
            out.append(TorqueCurve(i, "clipped", _get_row(p, "extra_rad_per_Nm"), _get_row(p, knee)))
    for curve in hardening:
        i = curve.joint
        angle = np.linspace(lower[i], upper[i], 20001)
        beside = compute_balancer_stiffness(terms, angle).max() if i == 1 else 0.0
        least = [
            float(compute_angle_dependent_compliance(t, angle).min())
            for t in terms
            if t.effect == ANGLE_DEPENDENT_EFFECT and _get_joint(t) == i
        ]
        least += [c.minimum_slope for c in out if c.joint == i]
        left = (1.0 / (k[:, i] + beside)).min() + sum(min(v, 0.0) for v in least)
        reach = np.sqrt(MAX_HARDENING_SHARE * max(left, 0.0) / (3.0 * abs(curve.size[0])))
        out.append(TorqueCurve(i, "cubic", curve.size, np.array([reach])))
    return out


def build_body_springs(
    terms: Sequence[StiffnessTerm], origin: Array, flange: Array, T_flange_tcp: Array
) -> list[tuple[int, Array, Array]]:
    """Return the springs of base, links and tool: body (0 base_link … 6), frame S (4, 4) in base_link at q = 0,
    compliance (6, 6) in S.

    A beam is clamped at the joint's own origin and loaded at the next one's (link) or at the TCP (tool); S is at its
    loaded end with x along it. Matrices are in base_link's axes, those of the tool in its beam's axes: y = u × x with
    u the coordinate axis that x is least along.

    Args:
        terms: Terms of the stiffness file.
        origin: (6, 3) origins of the joint frames at q = 0 in base_link, m.
        flange: (4, 4) pose of the flange at q = 0 in base_link.
        T_flange_tcp: (4, 4) pose of the TCP in the flange.
    """
    out = []
    for term in terms:
        p = term.parameters
        if term.effect == "link_compliance":
            body = parse_link_location(term.location)
            points = [*origin, flange[:3, 3]]
            start = np.asarray(p["from_mm"]) / 1e3 if "from_mm" in p else points[body - 1]
            end = np.asarray(p["to_mm"]) / 1e3 if "to_mm" in p else points[body]
            out.append((body, *_build_spring(p, end, end - start, float(np.linalg.norm(end - start)), tool=False)))
        elif term.effect == "base_compliance":
            at = np.asarray(p.get("at_mm", np.zeros(3))) / 1e3
            out.append((0, *_build_spring(p, at, np.zeros(3), 0.0, tool=False)))
        elif term.effect == "tool_compliance":
            tcp = flange @ T_flange_tcp
            reach = abs(float(tcp[:3, 2] @ (tcp[:3, 3] - flange[:3, 3])))
            length = float(p["length_mm"]) / 1e3 if "length_mm" in p else reach
            if "cylinders" in p:
                S = _build_frame(tcp[:3, 3], tcp[:3, 2])
                out.append((6, S, float(p.get("scale", 1.0)) * _build_tool_stack(p, S, flange)))
            else:
                out.append((6, *_build_spring(p, tcp[:3, 3], tcp[:3, 2], length, tool=True)))
    return out


KNOWN_EFFECTS = {
    "joint_coupling",
    ANGLE_DEPENDENT_EFFECT,
    "joint_creep",
    "joint_nonlinear_stiffness",
    "joint_backlash",
    "joint_hysteresis",
    "gravity_compensator",
    "link_compliance",
    "base_compliance",
    "tool_compliance",
    "geometric_stiffness",
}


def shift_compliance(C: Array, r: Array) -> Array:
    """Return the (..., 6, 6) compliance seen at another point of the same rigid body, same axes.

    A wrench (f, m) there is (f, m + r × f) here; the twist goes back the same way.

    Args:
        C: (..., 6, 6) compliance, m/N, rad/N and rad/(N·m).
        r: (..., 3) vector to the other point, m.
    """
    G = np.zeros((*r.shape[:-1], 6, 6))
    G[..., range(6), range(6)] = 1.0
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    G[..., 0, 4], G[..., 0, 5], G[..., 1, 5] = z, -y, x
    G[..., 1, 3], G[..., 2, 3], G[..., 2, 4] = -z, y, -x
    return np.asarray(G @ C @ np.swapaxes(G, -1, -2))


def _build_spring(p: Mapping[str, Any], at: Array, along: Array, length: float, *, tool: bool) -> tuple[Array, Array]:
    if "compliance" in p:
        C = np.asarray(p["compliance"], float)
        return (_build_frame(at, along) if tool else _build_frame(at, None)), np.triu(C) + np.triu(C, 1).T
    if "compliance_diagonal" in p:
        return (_build_frame(at, along) if tool else _build_frame(at, None)), np.diag(
            np.asarray(p["compliance_diagonal"], float)
        )
    if "normal" in p:
        return _build_box_beam(p, at, along, length)
    C, slim = np.zeros((6, 6)), _compute_taper(p)
    if "EI_Nm2" in p:
        C += _integrate_beam_compliance(length, 1.0 / float(p["EI_Nm2"]), 0.0, 0.0, slim)
    if "GJ_Nm2" in p:
        C += _integrate_beam_compliance(length, 0.0, 1.0 / float(p["GJ_Nm2"]), 0.0, slim)
    if "EA_N" in p:
        C += _integrate_beam_compliance(length, 0.0, 0.0, 1.0 / float(p["EA_N"]), slim)
    return _build_frame(at, along), C


def _build_box_beam(p: Mapping[str, Any], at: Array, along: Array, length: float) -> tuple[Array, Array]:
    """A beam that bends by EI about its principal axis ``normal`` and by another EI about the one across."""
    slim = _compute_taper(p)
    bends = np.array([1.0 / float(p.get(key, np.inf)) for key in ("EI_across_Nm2", "EI_Nm2")])
    C = _integrate_beam_compliance(
        length, 0.0, 1.0 / float(p.get("GJ_Nm2", np.inf)), 1.0 / float(p.get("EA_N", np.inf)), slim
    )
    one = _integrate_beam_compliance(length, 1.0, 0.0, 0.0, slim)
    for turn, shift, bend in ((4, 2, bends[0]), (5, 1, bends[1])):
        pair = np.ix_((shift, turn), (shift, turn))
        C[pair] += bend * one[pair]
    x = along / np.linalg.norm(along)
    y = np.cross(np.asarray(p["normal"], float), x)
    y /= np.linalg.norm(y)
    S = np.eye(4)
    S[:3, :3], S[:3, 3] = np.column_stack([x, y, np.cross(x, y)]), at
    return S, C


def _compute_taper(p: Mapping[str, Any]) -> tuple[float, float]:
    """Radius of a beam's end over its root's, and how much it shears: EI/(k G A L²) at its middle."""
    return float(p.get("taper", 1.0)), float(p.get("shear", 0.0))


def _integrate_beam_compliance(
    length: float, bend: float, twist: float, stretch: float, slim: tuple[float, float] = (1.0, 0.0)
) -> Array:
    """(6, 6) at the loaded end of a clamped bar along x, by integrating the compliance of its slices.

    A thin tube: bending and twisting go with the cube of the radius, stretching and shearing with the radius.
    """
    C, (taper, shear) = np.zeros((6, 6)), slim
    # a slice at distance u from the end turns by bend·(m + u f) and is seen u away: ∫ 1, u, u² du
    one, first, second, thin = length, length**2 / 2.0, length**3 / 3.0, length
    if taper != 1.0:
        u = np.linspace(0.0, length, 4001)
        radius = 2.0 * (taper + (1.0 - taper) * u / length) / (1.0 + taper)
        one, first, second = (_integrate_simpson(u**k / radius**3, length) for k in range(3))
        thin = _integrate_simpson(1.0 / radius, length)
    second += shear * length**2 * thin
    C[0, 0], C[3, 3] = thin * stretch, one * twist
    for shift, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        C[shift, shift], C[turn, turn] = bend * second, bend * one
        C[shift, turn] = C[turn, shift] = sign * bend * first
    return C


def _build_tool_stack(p: Mapping[str, Any], S: Array, flange: Array) -> Array:
    """Cylinders in series from flange to tip, and a sensor with its own stiffness at the flange, seen from S."""
    C = np.zeros((6, 6))
    for step in p["cylinders"]:
        D, d, L = (float(step.get(key, 0.0)) / 1e3 for key in ("diameter_mm", "bore_mm", "length_mm"))
        E = float(step["youngs_GPa"]) * 1e9
        area, inertia = np.pi * (D**2 - d**2) / 4.0, np.pi * (D**4 - d**4) / 64.0
        G = E / (2.0 * (1.0 + float(step.get("poisson", 0.3))))
        C = shift_compliance(C, np.array([L, 0.0, 0.0])) + _integrate_beam_compliance(
            L, 1.0 / (E * inertia), 1.0 / (G * 2.0 * inertia), 1.0 / (E * area)
        )
    soft = np.zeros(6)
    if "sensor_N_per_mm" in p:
        soft[:3] = 1e-3 / np.asarray(p["sensor_N_per_mm"], float)
    if "sensor_Nm_per_rad" in p:
        soft[3:] = 1.0 / np.asarray(p["sensor_Nm_per_rad"], float)
    own = rotate_compliance(np.diag(soft), flange[:3, :3])
    return C + rotate_compliance(shift_compliance(own, S[:3, 3] - flange[:3, 3]), S[:3, :3].T)


def rotate_compliance(C: Array, R: Array) -> Array:
    """Return the (..., 6, 6) compliance in rotated axes.

    Args:
        C: (..., 6, 6) compliance, m/N, rad/N and rad/(N·m).
        R: (..., 3, 3) rotation of its own axes into the new ones.
    """
    Z = np.zeros((*R.shape[:-2], 6, 6))
    Z[..., :3, :3] = Z[..., 3:, 3:] = R
    return np.asarray(Z @ C @ np.swapaxes(Z, -1, -2))


def _build_frame(at: Array, along: Array | None) -> Array:
    T = np.eye(4)
    T[:3, 3] = at
    if along is not None:
        x = along / np.linalg.norm(along)
        y = np.cross(np.eye(3)[int(np.abs(x).argmin())], x)
        T[:3, 0], T[:3, 1] = x, y / np.linalg.norm(y)
        T[:3, 2] = np.cross(x, T[:3, 1])
    return T


def _get_joint(term: StiffnessTerm) -> int:
    numbers = parse_location(term.location).numbers
    return numbers[0] - 1 if numbers else -1


def _get_row(p: Mapping[str, Any], key: str) -> Array:
    return np.atleast_1d(np.asarray(p[key], float))


def _integrate_simpson(values: Array, length: float) -> float:
    """∫ over a length of values at its ends and at an odd number of points between."""
    weights = np.full(len(values), 2.0)
    weights[1::2], weights[[0, -1]] = 4.0, 1.0
    return float(weights @ values) * length / (3.0 * (len(values) - 1))

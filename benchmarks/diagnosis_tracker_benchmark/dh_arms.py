"""Three arms by Denavit and Hartenberg's numbers, and where they stand with what is concealed in them.

Kinematics by homogeneous matrices, weight by the slope of the potential energy; nothing of machopt is imported.
Lengths m, masses kg, springs N·m/rad, angles rad unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
GRAVITY = 9.81
SETTLED = 5  # fixed-point steps to the equilibrium under weight


@dataclass(frozen=True)
class Design:
    """An arm as its drawing has it; link i ends at Rz(q) Tz(d) Tx(a) Rx(alpha)."""

    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha_deg: tuple[float, ...]
    offset_deg: tuple[float, ...]
    mass: tuple[float, ...]
    spring: tuple[float, ...]
    home_deg: tuple[float, ...]
    tool: tuple[float, float, float]  # of the reflector at the tip, in the flange
    tool_mass: float


DESIGNS = {
    "big": Design(
        (0.33, 1.15, 0.115, 0, 0, 0),
        (0.675, 0, 0, 1.22, 0, 0.24),
        (-90, 0, -90, 90, -90, 0),
        (0, -90, 0, 0, 0, 0),
        (250, 180, 120, 60, 35, 20),
        (3e6, 2.6e6, 1.8e6, 0.5e6, 0.45e6, 0.25e6),
        (0, 20, -10, 10, 50, 0),
        (0.05, -0.03, 0.35),
        60,
    ),
    "mid": Design(
        (0.15, 0.59, 0.13, 0, 0, 0),
        (0.45, 0, 0, 0.64, 0, 0.095),
        (-90, 0, -90, 90, -90, 0),
        (0, -90, 0, 0, 0, 0),
        (60, 35, 30, 12, 8, 3),
        (6e5, 5e5, 3e5, 8e4, 7e4, 5e4),
        (10, 10, 5, -15, 60, 20),
        (0.0, 0.02, 0.18),
        8,
    ),
    "cobot": Design(
        (0, -0.6127, -0.57155, 0, 0, 0),
        (0.1807, 0, 0, 0.17415, 0.11985, 0.11655),
        (90, 0, 0, 90, -90, 0),
        (0, 0, 0, 0, 0, 0),
        (7.8, 13, 8.7, 3.8, 2.6, 2.0),
        (6e4, 5e4, 4e4, 1.4e4, 1.3e4, 1.2e4),
        (0, -80, 80, -60, 70, 0),
        (0.0, 0.0, 0.12),
        3,
    ),
}


@dataclass(frozen=True)
class Concealed:
    """What no drawing says."""

    spring_factor: Array = field(default_factory=lambda: np.ones(6))
    zero: Array = field(default_factory=lambda: np.zeros(6))  # rad
    waves: tuple[tuple[int, float, float, float], ...] = ()  # joint from 0, order, rad, phase
    coupled: tuple[tuple[int, int, float], ...] = ()  # joint, joint that it drags, rad/rad
    built: dict[int, Array] = field(default_factory=dict)  # link from 0: a, d (m), alpha, turn about y (rad) beside
    payload: float = 0.0  # kg that the tool weighs more
    base: float = 0.0  # rad/(N·m) about x; the pedestal is no round one
    link: tuple[int, float] | None = None  # from 0, rad/(N·m) in its middle
    balancer: tuple[float, float, float, float, float] | None = None  # crank, column (m), N, N/m, rad


def placed(R: Array | None = None, p: Array | None = None) -> Array:
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if p is not None:
        T[:3, 3] = p
    return T


def turned(vector: Array) -> Array:
    """(..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    v = np.asarray(vector, float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    safe = np.where(angle > 1e-9, angle, 1.0)
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 1, 0] = -v[..., 2], v[..., 2]
    K[..., 0, 2], K[..., 2, 0] = v[..., 1], -v[..., 1]
    K[..., 1, 2], K[..., 2, 1] = -v[..., 0], v[..., 0]
    one = np.where(angle > 1e-9, np.sin(angle) / safe, 1.0)
    two = np.where(angle > 1e-9, (1 - np.cos(angle)) / safe**2, 0.5)
    return np.asarray(np.eye(3) + one * K + two * (K @ K))


def about(axis: int, angle: Array | float) -> Array:
    """(..., 3, 3) turn about x, y or z."""
    v = np.zeros((*np.shape(angle), 3))
    v[..., axis] = angle
    return turned(v)


class Arm:
    """A design with what is concealed in this copy of it."""

    def __init__(self, name: str, concealed: Concealed) -> None:
        self.name, self.design, self.concealed = name, DESIGNS[name], concealed
        d = self.design
        self.a, self.d = np.array(d.a, float), np.array(d.d, float)
        self.alpha, self.offset = np.radians(d.alpha_deg), np.radians(d.offset_deg)
        self.mass, self.spring = np.array(d.mass, float), np.array(d.spring, float)
        self.home, self.tool = np.radians(d.home_deg), np.array(d.tool)
        self.along = np.stack([self.a, np.zeros(6), self.d], axis=1)  # from a link's frame to the next, in its axes
        self.centre, self.tool_centre = 0.5 * self.along, 0.5 * self.tool

    def end(self, i: int, *, drawn: bool = False) -> Array:
        """(4, 4) from link i's frame to the next joint's."""
        a, d, alpha, beta = np.zeros(4) if drawn else self.concealed.built.get(i, np.zeros(4))
        T = placed(None, np.array([self.a[i] + a, 0.0, self.d[i] + d]))
        return np.asarray(T @ placed(about(0, self.alpha[i] + alpha)) @ placed(about(1, beta)))

    def frames(self, q: Array, link_turn: Array | None = None, base_turn: Array | None = None) -> tuple[Array, Array]:
        """Of links (N, 6, 4, 4) and of the flange (N, 4, 4), at angles (N, 6)."""
        T = np.tile(np.eye(4), (len(q), 1, 1))
        if base_turn is not None:
            T[:, :3, :3] = turned(base_turn)
        links = []
        for i in range(6):
            T = T.copy()
            T[:, :3, :3] = T[:, :3, :3] @ about(2, q[:, i] + self.offset[i])
            links.append(T)
            if link_turn is not None and self.concealed.link is not None and i == self.concealed.link[0]:
                bent = np.tile(np.eye(4), (len(q), 1, 1))
                bent[:, :3, :3] = turned(link_turn)
                half = 0.5 * self.along[i]
                bent[:, :3, 3] = half - bent[:, :3, :3] @ half
                T = T @ bent
            T = T @ self.end(i)
        return np.stack(links, axis=1), T

    def energy(self, q: Array) -> Array:
        """(N,) J of all weights."""
        links, flange = self.frames(q)
        z = links[:, :, 2, 3] + np.einsum("nik,ik->ni", links[:, :, 2, :3], self.centre)
        tip = flange[:, 2, 3] + flange[:, 2, :3] @ self.tool_centre
        return np.asarray(GRAVITY * (z @ self.mass + (self.design.tool_mass + self.concealed.payload) * tip))

    def weight_torque(self, q: Array) -> Array:
        """(N, 6) N·m that weight turns the joints with."""
        step = 1e-5
        each = []
        for j in range(6):
            h = np.zeros(6)
            h[j] = step
            each.append((self.energy(q - h) - self.energy(q + h)) / (2 * step))
        return np.stack(each, axis=1)

    def moment(self, q: Array, at: Array, beyond: int) -> Array:
        """(N, 3) N·m, base axes, about points (N, 3), of the weights of links after ``beyond`` and of the tool."""
        links, flange = self.frames(q)
        out = np.zeros((len(q), 3))
        for j in range(beyond + 1, 6):
            lever = links[:, j, :3, 3] + links[:, j, :3, :3] @ self.centre[j] - at
            out += np.cross(lever, [0, 0, -GRAVITY * self.mass[j]])
        lever = flange[:, :3, 3] + flange[:, :3, :3] @ self.tool_centre - at
        heavy = self.design.tool_mass + self.concealed.payload
        return np.asarray(out + np.cross(lever, [0, 0, -GRAVITY * heavy]))

    def base_turn(self, q: Array) -> Array:
        """(N, 3) rad of the pedestal under all weights."""
        return self.concealed.base * self.moment(q, np.zeros((len(q), 3)), -1) * np.array([1.0, 1.3, 0.2])

    def stands(self, q: Array) -> tuple[Array, Array]:
        """Frames of links and flange where the arm really stands when the encoders say q (N, 6)."""
        hidden = self.concealed
        q = q + hidden.zero
        for joint, order, size, phase in hidden.waves:
            q = q.copy()
            q[:, joint] += size * np.sin(order * q[:, joint] + phase)
        for joint, dragged, ratio in hidden.coupled:
            q = q.copy()
            q[:, dragged] += ratio * q[:, joint]
        bend, base, link = np.zeros_like(q), None, None
        for _ in range(SETTLED):
            there = q + bend
            torque = self.weight_torque(there)
            if hidden.balancer is not None:
                torque[:, 1] += balance(hidden.balancer, there[:, 1])
            if hidden.base:
                base = self.base_turn(there)
            if hidden.link is not None:
                i, c = hidden.link
                R, p = (self.frames(there)[0][:, i, :3, k] for k in (slice(0, 3), 3))
                middle = p + R @ (0.5 * self.along[i])
                link = c * np.einsum("nji,nj->ni", R, self.moment(there, middle, i))
            bend = torque / (self.spring * hidden.spring_factor)
        return self.frames(q + bend, link, base)


def balance(of: tuple[float, float, float, float, float], q2: Array) -> Array:
    """(N,) N·m of a spring between a crank on link 2 and the column."""
    crank, column, preload, rate, angle = of
    at = q2 + angle
    length = np.sqrt(crank**2 + column**2 + 2 * crank * column * np.cos(at))
    force = preload + rate * (length - (column - crank))
    return np.asarray(force * crank * column * np.sin(at) / length)

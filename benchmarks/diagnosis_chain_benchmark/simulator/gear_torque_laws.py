"""How the torque in a gear depends on its twist: contacts, slipping elements, creeping elements, levers.

A law gives torque and slope for a trial twist δ (B,) at joint angle q (B,); what it remembers changes only when an
equilibrium is accepted (``commit``). None of them is written as a compliance, a play operator or a power of torque.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Law:
    """Torque over twist."""

    remembers = False

    def start(self, batch: int) -> Array:
        """Memory (B, m) of a gear that was never loaded."""
        return np.zeros((batch, 0))

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        """Torque (B,) N·m and its slope (B,) N·m/rad after ``hold`` (B,) s at this load."""
        raise NotImplementedError

    def commit(self, twist: Array, q: Array, memory: Array, hold: Array) -> Array:
        """Memory after this equilibrium."""
        return memory

    def scaled(self, factor: float) -> Law:
        """The same gear with every stiffness times ``factor``."""
        raise NotImplementedError


@dataclass(frozen=True)
class Spring(Law):
    """Linear gear."""

    k: float  # N·m/rad

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        return self.k * twist, np.full_like(twist, self.k)

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor)


@dataclass(frozen=True)
class Pins(Law):
    """Pins of a cycloidal stage that come into contact one after the other: τ = k₀ δ + Σ k_i s(|δ| − g_i) sgn δ.

    s(x) is a contact smoothed over its roughness; the stiffness climbs from k₀ to k₀ + Σ k_i.
    """

    k0: float  # N·m/rad before the first gap closes
    k: Array  # (m,) N·m/rad of each pin
    gap: Array  # (m,) rad of twist where it meets
    rough: float  # rad

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        tau, slope = self.k0 * twist, np.full_like(twist, self.k0)
        for k, g in zip(self.k, self.gap, strict=True):
            for sign in (1.0, -1.0):
                x = sign * twist - g
                root = np.hypot(x, self.rough)
                # zero at zero twist: the smoothing's own tail cancels between the two flanks
                tau = tau + sign * 0.5 * k * (x + root)
                slope = slope + 0.5 * k * (1.0 + x / root)
        return tau, slope

    def scaled(self, factor: float) -> Law:
        return replace(self, k0=self.k0 * factor, k=self.k * factor)


@dataclass(frozen=True)
class Clearance(Law):
    """Teeth with clearance: nothing but seal drag inside ±b, Hertzian flanks beyond, in series with the gear's twist.

    τ = k_s δ + k [s(δ − b) − s(−δ − b)], s(x) = ½ (x + √(x² + ε²)).
    """

    k: float  # N·m/rad, flanks and shafts
    b: float  # rad, half the clearance
    seal: float  # fraction of k left inside
    rough: float = 2e-6  # rad

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        up, down = twist - self.b, -twist - self.b
        ru, rd = np.hypot(up, self.rough), np.hypot(down, self.rough)
        tau = self.seal * self.k * twist + 0.5 * self.k * (1.0 - self.seal) * ((up + ru) - (down + rd))
        slope = self.seal * self.k + 0.5 * self.k * (1.0 - self.seal) * ((1.0 + up / ru) + (1.0 + down / rd))
        return tau, slope

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor)


@dataclass(frozen=True)
class Slips(Law):
    """Many dry contacts beside the gear spring (Iwan): each a spring that slides at its own limit.

    τ = k δ + Σ clip(k_i (δ − z_i), ±f_i); a committed element that slid takes z_i with it.
    """

    k: float  # N·m/rad of the gear
    stiff: Array  # (m,) N·m/rad
    limit: Array  # (m,) N·m

    remembers = True

    def start(self, batch: int) -> Array:
        return np.zeros((batch, len(self.stiff)))

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        pull = self.stiff * (twist[:, None] - memory)
        sticks = np.abs(pull) < self.limit
        tau = self.k * twist + np.clip(pull, -self.limit, self.limit).sum(axis=1)
        return tau, self.k + (sticks * self.stiff).sum(axis=1)

    def commit(self, twist: Array, q: Array, memory: Array, hold: Array) -> Array:
        pull = np.clip(self.stiff * (twist[:, None] - memory), -self.limit, self.limit)
        return np.asarray(twist[:, None] - pull / self.stiff)

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor, stiff=self.stiff * factor, limit=self.limit * factor)


def iwan(k: float, share: float, reach: float, elements: int = 24) -> Slips:
    """Slipping elements, together ``share``·k stiff at first, the last one sliding at ``reach`` rad.

    Softer elements slide later (density ∝ x^-0.4), so the loop is slender at small and full at large amplitude.
    """
    x = reach * ((np.arange(elements) + 0.5) / elements) ** 1.4
    weight = x**-0.4
    stiff = share * k * weight / weight.sum()
    return Slips(k, stiff, stiff * x)


@dataclass(frozen=True)
class BoucWen(Law):
    """τ = k δ + h z, dz = [1 − |z|ⁿ (β sgn(z dδ) + γ)] dδ / d, n = 1.3.

    z saturates at ±1, so that h is the torque of the drag; β + γ = 1.
    """

    k: float  # N·m/rad
    h: float  # N·m
    d: float  # rad of twist over which the drag builds up
    beta: float = 0.65
    n: float = 1.3

    remembers = True

    def start(self, batch: int) -> Array:
        return np.zeros((batch, 2))  # twist and z when last at rest

    def _drag(self, twist: Array, memory: Array) -> tuple[Array, Array]:
        # after a dozen d the drag is saturated, however far the trial goes
        way = np.clip(twist - memory[:, 0], -12.0 * self.d, 12.0 * self.d)
        steps = int(np.clip(np.ceil(12.0 * np.abs(way).max() / self.d), 2, 144))
        h, z = way / steps, memory[:, 1]

        def slope(y: Array) -> Array:
            return np.asarray((1.0 - np.abs(y) ** self.n * (self.beta * np.sign(y * h) + 1.0 - self.beta)) / self.d)

        for _ in range(steps):
            z = z + h * slope(z + 0.5 * h * slope(z))
        return z, slope(z)

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        z, slope = self._drag(twist, memory)
        return self.k * twist + self.h * z, self.k + self.h * np.maximum(slope, 0.0)

    def commit(self, twist: Array, q: Array, memory: Array, hold: Array) -> Array:
        return np.stack([twist, self._drag(twist, memory)[0]], axis=1)

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor, h=self.h * factor)


@dataclass(frozen=True)
class Creeping(Law):
    """Gear spring with a row of Kelvin–Voigt elements: δ = τ/k + Σ x_i, T_i ẋ_i + x_i = κ_i τ/k.

    Several T_i from seconds to minutes look like creep by a power of time.
    """

    k: float  # N·m/rad at once
    kappa: Array  # (m,) further compliance as a share of 1/k
    tau: Array  # (m,) s

    remembers = True

    def start(self, batch: int) -> Array:
        return np.zeros((batch, len(self.kappa)))

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        fade = np.exp(-hold[:, None] / self.tau)
        soft = (1.0 + (self.kappa * (1.0 - fade)).sum(axis=1)) / self.k
        return (twist - (memory * fade).sum(axis=1)) / soft, 1.0 / soft

    def commit(self, twist: Array, q: Array, memory: Array, hold: Array) -> Array:
        fade = np.exp(-hold[:, None] / self.tau)
        tau, _ = self.torque(twist, q, memory, hold)
        return np.asarray(memory * fade + self.kappa * (1.0 - fade) * tau[:, None] / self.k)

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor)


@dataclass(frozen=True)
class Screw(Law):
    """A joint moved by a screw between two pivots: stiffness k_s r(q)², r = a b sin(q + φ)/s, in parallel with a gear.

    s² = a² + b² − 2 a b cos(q + φ) is the length of the screw.
    """

    k: float  # N·m/rad that does not depend on q
    k_screw: float  # N/m
    a: float  # m
    b: float  # m
    phi: float  # rad

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        angle = q + self.phi
        s = np.sqrt(self.a**2 + self.b**2 - 2 * self.a * self.b * np.cos(angle))
        k = self.k + self.k_screw * (self.a * self.b * np.sin(angle) / s) ** 2
        return k * twist, k

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor, k_screw=self.k_screw * factor)


@dataclass(frozen=True)
class Bumpy(Law):
    """A gear whose stiffness changes around its turn: a sector carries less (eccentric ring, a soft casting)."""

    k: float  # N·m/rad
    depth: float  # share missing in the middle of the soft sector
    centre: float  # rad
    width: float  # rad

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        k = self.k * (1.0 - self.depth / np.cosh((q - self.centre) / self.width))
        return k * twist, k

    def scaled(self, factor: float) -> Law:
        return replace(self, k=self.k * factor)


@dataclass(frozen=True)
class Balancer(Law):
    """A gear with a spring between two bodies beside it: coil, or gas in a cylinder, anchored at two points.

    The spring's length s(q) follows from the points; it turns the joint by −F(s) ds/dq. Coil: F = F₀ + k (s − s₀),
    gas: F = F₀ (V₀/(V₀ − A (s − s₀)))^1.3, which is stiffer the longer it is drawn.
    """

    gear: Law
    axis: Array  # (3,) unit
    fixed: Array  # (3,) m, anchor on the body before, from the joint
    moving: Array  # (3,) m, anchor on the body after, from the joint, at q = 0
    force: float  # N at length s0, the shortest
    rate: float  # N/m
    s0: float  # m
    gas: bool = False

    @property
    def remembers(self) -> bool:  # type: ignore[override]
        return self.gear.remembers

    def start(self, batch: int) -> Array:
        return self.gear.start(batch)

    def commit(self, twist: Array, q: Array, memory: Array, hold: Array) -> Array:
        return self.gear.commit(twist, q, memory, hold)

    def pull(self, angle: Array) -> tuple[Array, Array]:
        """Torque (B,) N·m of the spring alone at the true angle, and its slope."""
        along = np.outer(np.ones_like(angle), self.axis) * (self.axis @ self.moving)
        across = self.moving - self.axis * (self.axis @ self.moving)
        side = np.cross(self.axis, across)
        arm = along + np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * side
        line = arm - self.fixed
        s = np.linalg.norm(line, axis=1)
        turn = np.cross(self.axis, arm)
        ds = np.einsum("bc,bc->b", line, turn) / s
        bend = np.cross(self.axis, turn)
        dds = (np.einsum("bc,bc->b", turn, turn) + np.einsum("bc,bc->b", line, bend) - ds**2) / s
        stroke = s - self.s0
        if self.gas:
            volume = 1.3 * self.force / self.rate  # stroke that would press it to nothing
            F = self.force * (1.0 - np.minimum(stroke / volume, 0.9)) ** -1.3
            slope = 1.3 * F / (volume * (1.0 - np.minimum(stroke / volume, 0.9)))
        else:
            F, slope = self.force + self.rate * stroke, np.full_like(s, self.rate)
        return -F * ds, -(slope * ds**2 + F * dds)

    def torque(self, twist: Array, q: Array, memory: Array, hold: Array) -> tuple[Array, Array]:
        tau, slope = self.gear.torque(twist, q, memory, hold)
        pull, along = self.pull(q + twist)
        return tau - pull, slope - along

    def scaled(self, factor: float) -> Law:
        return replace(self, gear=self.gear.scaled(factor))


def twist_at(law: Law, tau: Array, q: Array, memory: Array, hold: float, guess: Array | None = None) -> Array:
    """Twist (B,) rad at given torques (B,) N·m: Newton, kept inside a bracket by bisection (laws are monotone)."""
    x = np.zeros_like(tau) if guess is None else guess.copy()
    low, high = np.full_like(tau, -0.2), np.full_like(tau, 0.2)
    wait = np.full_like(tau, hold)
    for _ in range(60):
        f, slope = law.torque(x, q, memory, wait)
        off = f - tau
        low, high = np.where(off < 0, x, low), np.where(off > 0, x, high)
        if np.abs(off).max() < 1e-9 * (1.0 + np.abs(tau).max()):
            break
        new = x - off / slope
        x = np.where((new > low) & (new < high), new, 0.5 * (low + high))
    return x

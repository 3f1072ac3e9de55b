"""Equilibrium of the whole arm under its weight, a wrench at the tool and whatever pulls at it; Newton's method.

Every degree of freedom balances: Q_d(x; loads) = force of its own spring at x_d. The geometric stiffness of dumas2011
(K_C) is nothing special here: it is the Hessian of the loads, evaluated where the arm really stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.arm_model import Arm, Model, build
from simulator.serial_chain import Loads, Posture

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Memory:
    """What the gears and hinges remember."""

    joints: tuple[Array, ...]
    hinges: tuple[Array, ...]


@dataclass(frozen=True)
class Setting:
    """Readings to solve together (B of them)."""

    encoder: Array  # (B, 6) rad
    wrench: Array  # (B, 6) N, N·m at the tip, base axes
    lever: Array | None = None  # (B, 3) m, tip frame: where the force really acts
    hold: Array | None = None  # (B,) s at this load
    growth: dict[int, tuple[Array, Array]] = field(default_factory=dict)  # link: lengthening (B,) m, bow (B, 2) rad
    gravity: float = 1.0
    joint_error: Array | None = None  # (B, 6) rad, of the controller's return to the pose


@dataclass(frozen=True)
class Equilibrium:
    """Where it settles."""

    x: Array  # (B, n)
    posture: Posture
    position: Array  # (B, 3) m in base
    rotation: Array  # (B, 3, 3)
    torque: Array  # (B, 6) N·m that the gears carry
    residual: float  # largest imbalance over the largest load


class Statics:
    """Solves one arm; the chain is assembled once."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.model: Model = build(arm)
        self.unmix = np.linalg.inv(arm.mix)

    @property
    def remembers(self) -> bool:
        return any(law.remembers for law in self.arm.laws) or any(law.remembers for _, law in self.model.hinge)

    def start(self, batch: int) -> Memory:
        return Memory(
            tuple(law.start(batch) for law in self.arm.laws), tuple(law.start(batch) for _, law in self.model.hinge)
        )

    def rest(self, setting: Setting) -> Array:
        """(B, n) coordinates with no spring strained."""
        x = np.zeros((len(setting.encoder), len(self.model.chain)))
        x[:, self.model.joint] = self._angles(setting)
        for link, (length, bow) in setting.growth.items():
            first, bends = self.model.growth[link]
            x[:, first] = length
            x[:, list(bends)] = bow
        return x

    def settle(self, setting: Setting, memory: Memory | None = None, guess: Array | None = None) -> Equilibrium:
        """Newton with step halving, each reading on its own.

        Raises:
            RuntimeError: an equilibrium was not found; a case that does not converge must not be written.
        """
        model, B = self.model, len(setting.encoder)
        memory = memory if memory is not None else self.start(B)
        hold = setting.hold if setting.hold is not None else np.full(B, 1e9)
        q = self._angles(setting)
        fixed = np.zeros(len(model.chain), bool)
        for first, bends in model.growth.values():
            fixed[[first, *bends]] = True
        free = np.flatnonzero(~fixed)
        x = self.rest(setting)
        if guess is not None:
            x[:, free] = guess[:, free]
        g, K, torque = self._balance(x, q, setting, memory, hold)
        scale = max(float(np.abs(g).max()), 1.0)
        size = np.abs(g[:, free]).max(axis=1)
        damping = np.ones(B)
        step = np.linalg.solve(K[:, free][:, :, free], g[:, free, None])[..., 0]
        for _ in range(120):
            if size.max() < 1e-10 * scale:
                break
            trial = x.copy()
            trial[:, free] += damping[:, None] * step
            g_new, K_new, torque_new = self._balance(trial, q, setting, memory, hold)
            new = np.abs(g_new[:, free]).max(axis=1)
            better = (new < size) | (new < 1e-10 * scale) | (damping < 1e-3)
            x[better], torque[better] = trial[better], torque_new[better]
            size = np.where(better, new, size)
            damping = np.where(better, 1.0, 0.4 * damping)
            if better.any():
                # where the trial was refused the old tangent and residual still hold
                step[better] = np.linalg.solve(K_new[better][:, free][:, :, free], g_new[better][:, free, None])[..., 0]
        else:
            if size.max() > 1e-6 * scale:
                raise RuntimeError(f"no equilibrium: imbalance {size.max():.3g} of {scale:.3g}")
        posture = model.chain.forward(x)
        position, rotation = posture.tip()
        return Equilibrium(x, posture, position, rotation, torque, float(size.max() / scale))

    def commit(self, x: Array, setting: Setting, memory: Memory) -> Memory:
        """What is remembered after an equilibrium."""
        hold = setting.hold if setting.hold is not None else np.full(len(x), 1e9)
        q = self._angles(setting)
        twist = (x[:, self.model.joint] - q) @ self.unmix.T
        joints = tuple(
            law.commit(twist[:, i], q[:, i], m, hold)
            for i, (law, m) in enumerate(zip(self.arm.laws, memory.joints, strict=True))
        )
        hinges = tuple(
            law.commit(x[:, d], np.zeros(len(x)), m, hold)
            for (d, law), m in zip(self.model.hinge, memory.hinges, strict=True)
        )
        return Memory(joints, hinges)

    def loads(self, posture: Posture, setting: Setting) -> Loads:
        """Everything that pulls at the arm."""
        loads = posture.gravity(setting.gravity)
        position, rotation = posture.tip()
        if setting.lever is not None:
            position = position + np.einsum("bij,bj->bi", rotation, setting.lever)
        last = len(self.model.chain)
        loads.add(last, position, setting.wrench[:, :3], setting.wrench[:, 3:])
        for hose in self.arm.hoses:
            frame = self.model.frames[hose.body]
            at = posture.point(frame, hose.local)
            loads.add(frame, at, hose.pull(at))
        return loads

    def _angles(self, setting: Setting) -> Array:
        q = self.arm.true_angles(setting.encoder)
        return q if setting.joint_error is None else q + setting.joint_error

    def _balance(self, x: Array, q: Array, setting: Setting, memory: Memory, hold: Array) -> tuple[Array, Array, Array]:
        """Imbalance (B, n), its negative slope (B, n, n), gear torques (B, 6)."""
        model = self.model
        posture = model.chain.forward(x)
        Q, H = posture.generalised(self.loads(posture, setting))
        n = len(model.chain)
        force = model.stiff * x
        K = np.broadcast_to(np.diag(model.stiff), (len(x), n, n)).copy()
        if len(model.plate):
            assert self.arm.plate is not None
            place = np.zeros((len(x), 6))
            which = [5] if len(model.plate) == 1 else list(range(6))
            place[:, which] = x[:, model.plate]
            f, k = self.arm.plate.force(place)
            force[:, model.plate] = f[:, which]
            K[:, model.plate[:, None], model.plate] = k[:, which][:, :, which]
        for (d, law), m in zip(model.hinge, memory.hinges, strict=True):
            force[:, d], K[:, d, d] = law.torque(x[:, d], np.zeros(len(x)), m, hold)
        twist = (x[:, model.joint] - q) @ self.unmix.T
        tau, slope = np.empty_like(twist), np.empty_like(twist)
        for i, (law, m) in enumerate(zip(self.arm.laws, memory.joints, strict=True)):
            tau[:, i], slope[:, i] = law.torque(twist[:, i], q[:, i], m, hold)
        torque = tau @ self.unmix
        force[:, model.joint] = torque
        K[:, model.joint[:, None], model.joint] = np.einsum("ki,bk,kj->bij", self.unmix, slope, self.unmix)
        return Q - force, K - H, torque

"""Static equilibrium of a batch of postures: Newton on the bodies, gear windups in an outer iteration.

A serial chain is statically determinate, so the torque of a joint hardly depends on its windup: the outer iteration
rest = q + extra(τ) contracts by about load/stiffness (1e-3) each time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bushing_simulator.bushing_bodies import MultibodyChain, PointLoad, Posture, move_posture, solve_block_tridiagonal
from bushing_simulator.gear_laws import Drive, GearLaw


@dataclass
class Equilibrium:
    """Solution of one load step."""

    posture: Posture
    torque: np.ndarray  # (N, 6) N·m about the joint axes, that the drives carry
    residual: float  # N, N·m, largest component of the force balance


def solve_bodies(
    chain: MultibodyChain, start: Posture, rest: np.ndarray, loads: list[PointLoad], growth: np.ndarray | None
) -> tuple[Posture, np.ndarray, float]:
    """Return posture, bushing wrenches (N, B, 6) and residual at given rest angles (N, 6) in rad."""
    posture, best = start, np.inf
    for _ in range(60):
        residual, diagonal, lower, wrench = chain.compute_balance(posture, rest, loads, growth)
        size = float(np.max(np.abs(residual)))
        if size < 2e-4 or (size < 2e-2 and size > 0.5 * best):  # round-off: 1e11 N/m times 1e-15 m
            return posture, wrench, size
        best = min(best, size)
        posture = move_posture(posture, solve_block_tridiagonal(diagonal, lower, -residual))
    raise RuntimeError(f"no equilibrium: residual {size:.3g} N after 60 iterations")


@dataclass
class Arm:
    """A chain, its gears, and where the forces and readings are."""

    chain: MultibodyChain
    laws: list[GearLaw]
    joint_bodies: list[int]  # body moved by each joint
    tool_body: int
    tcp: np.ndarray  # (3,) m, in the tool body
    tool_rotation: np.ndarray  # (3, 3), TCP axes in the tool body

    def reset(self, count: int) -> None:
        """Forget the history of all gears."""
        for law in self.laws:
            law.reset(count)

    def find_rest_angles(self, drive: Drive) -> np.ndarray:
        """Return encoder angle plus the extra windup of each law (N, 6)."""
        rest = drive.angle.copy()
        for law in self.laws:
            rest[:, law.joint] += law.compute_extra(drive)
        return rest

    def solve_step(
        self,
        drive: Drive,
        loads: list[PointLoad],
        start: Posture | None = None,
        growth: np.ndarray | None = None,
    ) -> Equilibrium:
        """Return the equilibrium under loads; ``drive.torque`` is updated, the history is not."""
        rest = self.find_rest_angles(drive)
        posture = start if start is not None else self.chain.place_at_rest(rest, growth)
        for _ in range(25):
            posture, wrench, residual = solve_bodies(self.chain, posture, rest, loads, growth)
            drive.torque = np.stack([wrench[:, b, 3:] @ self.chain.bodies[b].axis for b in self.joint_bodies], axis=1)
            new = self.find_rest_angles(drive)
            change = float(np.max(np.abs(new - rest)))
            rest = new
            if change < 2e-10:
                return Equilibrium(posture, drive.torque, residual)
        raise RuntimeError(f"gear windups do not settle: last change {change:.3g} rad")

    def advance(self, drive: Drive) -> None:
        """Keep the gears' states at the end of a load step."""
        for law in self.laws:
            law.advance(drive)

    def find_tcp(self, posture: Posture, point: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return place (N, 3) of the TCP (or another point of the tool body) and rotation (N, 3, 3) of the TCP axes."""
        R = posture.rotations[:, self.tool_body]
        place = posture.positions[:, self.tool_body] + R @ (self.tcp if point is None else point)
        return place, R @ self.tool_rotation

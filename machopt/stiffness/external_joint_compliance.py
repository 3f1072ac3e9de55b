"""Compliance of external joints: the joints and bodies of rails and positioners (stiffness.yaml, ``external_joints``).

A wrench w on the tool at the TCP has its reaction −w on the part at the same place. A rail's joint or carriage moves
the
tool, a positioner's moves the part in the opposite direction, so both add to the motion of the tool *relative to the
part*:

    C = Σ_i s_i s_iᵀ / k_i + Σ_i G_i C_i G_iᵀ

with s_i = (a × (p − o), a) of a joint that rotates about the line (o, a), (a, 0) of one that slides, p the TCP, and G_i
the transform of a body's own compliance to the TCP (:mod:`machopt.stiffness.terms.body_spring`). C depends on the
external joints and the TCP position, not on the arm's posture: one matrix per point of the path.

Weight bends the same springs. It does so independently of the process, so no index includes it. Relevant is the
settlement of part and base compared with home, where they were measured
(:meth:`ExternalJointCompliance.compute_gravity_settling`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.stiffness import ExternalJointSpring
from machopt.kinematics.machine import Machine, compute_line_exponential
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.stiffness.terms.term_interface import LoadedArm

STANDARD_GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class KnownCompliance:
    """Known compliance at the TCP, as an additional term of :class:`machopt.stiffness.arm_stiffness.ElasticState`."""

    matrix: Array  # (M, 6, 6) SI, base_link axes

    @property
    def retained_share(self) -> float | None:
        """None: a positive compliance reduces nothing."""
        return None

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """Return the (M, 6) twist in m, rad.

        Args:
            under: not used.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            small: not used.
        """
        return np.asarray(np.einsum("...ij,...j->...i", self.matrix, wrench))


@dataclass(frozen=True)
class CompliantPart:
    """One compliant joint or body."""

    line: int  # of the chain
    name: str
    matrix: Array  # (M, 6, 6) compliance at the TCP, base_link axes


@dataclass(frozen=True)
class ExternalJointCompliance:
    """Springs of the external joints of a machine; lines k of the chain."""

    machine: Machine
    springs: tuple[tuple[int, ExternalJointSpring], ...]  # with the line of each

    @classmethod
    def build(cls, machine: Machine, springs: tuple[ExternalJointSpring, ...]) -> ExternalJointCompliance | None:
        """Return the springs; None where nothing is compliant and nothing has a mass.

        Args:
            machine: chain of the cell.
            springs: springs of its external joints.

        Raises:
            ValueError: a spring of a joint that the machine does not have; readers refuse such a file.
        """
        return cls(machine, tuple((machine.names.index(s.joint), s) for s in springs)) if springs else None

    def compute_compliance(self, external: Array, position: Array) -> Array:
        """Return the (M, 6, 6) compliance at the TCP in base_link axes.

        Args:
            external: (M, E) rad or m, external joints.
            position: (M, 3) m, TCP in base_link.
        """
        out = np.zeros((len(position), 6, 6))
        for part in self.list_parts(external, position):
            out += part.matrix
        return out

    def list_parts(self, external: Array, position: Array) -> tuple[CompliantPart, ...]:
        """Return the summands of :meth:`compute_compliance`, each with its compliant part.

        Args:
            external: (M, E) rad or m, external joints.
            position: (M, 3) m, TCP in base_link.
        """
        out = []
        for line, spring in self.springs:
            before, body = self._compute_carrier_motion(external, line)
            if np.isfinite(spring.stiffness):
                s = self._compute_line_twist(line, before, position)
                out.append(
                    CompliantPart(
                        line, f"external joint {spring.joint}", s[:, :, None] * s[:, None, :] / spring.stiffness
                    )
                )
            if spring.compliance.any():
                G = _build_twist_transform(body, spring.at, position)
                C = G @ spring.compliance @ np.swapaxes(G, 1, 2)
                out.append(CompliantPart(line, f"the body on external joint {spring.joint}", C))
        return tuple(out)

    def compute_uncertain_twists(self, external: Array, position: Array) -> Array:
        """Return (M, K, 6) s·√σ of the K joints with uncertain stiffness, σ that of 1/k.

        1 σ of each moves the TCP under a wrench w by (s √σ)(s √σ)ᵀw.

        Args:
            external: (M, E) rad or m, external joints.
            position: (M, 3) m, TCP in base_link.
        """
        every = [(line, s) for line, s in self.springs if s.std]
        out = np.zeros((len(position), len(every), 6))
        for n, (line, spring) in enumerate(every):
            out[:, n] = np.sqrt(spring.compliance_sigma) * self._compute_line_twist(
                line, self._compute_carrier_motion(external, line)[0], position
            )
        return out

    def compute_gravity_settling(self, external: Array, place: Array, arm: Array) -> Array:
        """Return the displacement of the tool relative to the part by weight, through these springs.

        Args:
            external: (M, E) rad or m.
            place: (M, 3) m, the TCP in the workpiece frame.
            arm: (M, 6) N, N·m, weight of the arm and its tool on base_link, about its origin and in its axes.

        Returns:
            (M, 3) m in workpiece axes.
        """
        m = self.machine
        T = m.compute_T_base_workpiece(external)
        R = T[:, :3, :3]
        p = np.einsum("mij,mj->mi", R, place) + T[:, :3, 3]
        pull = -STANDARD_GRAVITY * m.compute_T_world_base(external)[:, 2, :3]  # m/s², base_link axes
        weights = {}
        for line, s in self.springs:
            body = self._compute_carrier_motion(external, line)[1]
            c = body[:, :3, 3] + (0.0 if s.com is None else body[:, :3, :3] @ s.com)
            weights[line] = s.mass * np.concatenate([pull, np.cross(c - p, pull)], axis=1)
        arm_at_tcp = np.concatenate([arm[:, :3], arm[:, 3:] - np.cross(p, arm[:, :3])], axis=1)
        out = np.zeros((len(p), 3))
        for part in self.list_parts(external, p):
            rail = part.line >= m.positioner
            carried_weight = arm_at_tcp if rail else np.zeros_like(arm)
            for line, weight in weights.items():
                if m.positioner <= part.line <= line if rail else line <= part.line:  # this spring carries the body too
                    carried_weight = carried_weight + weight
            moved = np.einsum("mij,mj->mi", part.matrix[:, :3], carried_weight)
            out += moved if rail else -moved
        return np.asarray(np.einsum("mji,mj->mi", R, out))

    def _compute_line_twist(self, line: int, before: Array, position: Array) -> Array:
        """Return (M, 6) the TCP twist per unit of a joint whose carrier is moved by ``before`` (M, 4, 4)."""
        m = self.machine
        a = before[:, :3, :3] @ m.axis[line]
        if m.slides[line]:
            return np.concatenate([a, np.zeros_like(a)], axis=1)
        o = before[:, :3, :3] @ m.point[line] + before[:, :3, 3]
        return np.concatenate([np.cross(a, position - o), a], axis=1)

    def _compute_carrier_motion(self, external: Array, line: int) -> tuple[Array, Array]:
        """Return (M, 4, 4) the motions of a joint's carrier and of its link from zero, in the present base_link."""
        m, external = self.machine, np.asarray(external, float)
        back = invert_transform(m.compute_T_world_base(external)) @ m.T_world_base_zero
        carried = range(m.positioner - 1, line, -1) if line < m.positioner else range(m.positioner, line)
        for k in carried:
            back = back @ self._compute_line_positions(external, k)
        assert m.bodies is not None
        return np.asarray(back), np.asarray(back @ self._compute_line_positions(external, line) @ m.bodies[line])

    def _compute_line_positions(self, external: Array, k: int) -> Array:
        m = self.machine
        return compute_line_exponential(m.axis[k], m.point[k], bool(m.slides[k]), external[:, m.column[k] - 6])


def _build_twist_transform(body: Array, at: Array, position: Array) -> Array:
    """Return (M, 6, 6) G that transforms a twist at ``at`` (3,) in a body (M, 4, 4) to the TCP at positions (M, 3)."""
    R = body[:, :3, :3]
    r = position - (R @ at + body[:, :3, 3])
    out = np.zeros((len(R), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = R
    cross = np.zeros((len(R), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -r[:, 2], r[:, 1], -r[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    out[:, :3, 3:] = -cross @ R
    return out

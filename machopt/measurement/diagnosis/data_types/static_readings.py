"""A recording of an arm at rest, ready for laws: states, torques, and in which order things happened.

``deflection``: a reading is the arm under load against the same arm without it, so a law φ counts as
φ(with load) − φ(without). ``absolute``: a reading is where the arm is, so φ counts as it is, weight included.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.effects.protocol import JointLoading
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.stiffness.terms import LinearTerm

Ints = NDArray[np.int64]
BODY_BEHIND_FLANGE = 7  # the first body of what is behind the flange


@dataclass(frozen=True)
class GearLoadHistory:
    """K ≥ N states of all joints: before the readings of each cycle stands the arm without load."""

    torque: Array  # (K, 6) N·m
    time_gap: Array  # (K,) s since the state before, as :func:`machopt.effects.joint.creep.filter_first_order` takes it
    segment_start: Ints  # (K,) 1: nothing before counts
    reading_states: Ints  # (N,) state of each reading
    unloaded_states: Ints  # (N,) unloaded state of its cycle

    def select_joint(self, j: int, angle: Array) -> JointLoading:
        """Of joint j, whose angles are (N,) rad; without load it stands where the first reading of the cycle is."""
        q = np.empty(len(self.time_gap))
        q[self.unloaded_states[::-1]] = angle[::-1]
        q[self.reading_states] = angle
        return JointLoading(self.torque[:, j], q, self.time_gap, self.segment_start)

    def compute_reading_values(self, states: Array, differences: bool) -> Array:
        """(N, …) what the readings see of (K, …): a load test counts from the unloaded state of the cycle."""
        return np.asarray(
            states[self.reading_states] - states[self.unloaded_states] if differences else states[self.reading_states]
        )


@dataclass(frozen=True)
class InclinometerSetup:
    """An inclinometer on a link."""

    link: int  # the joint that moves it; 0: base_link
    present: NDArray[np.bool_]  # (N, 2) where it was read


@dataclass(frozen=True, kw_only=True)
class StaticReadings:
    """N readings of an arm at rest, base_link axes, SI."""

    recording: Recording
    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    masses: RobotMasses | None  # None: the URDF has none, weight is unknown
    state: ArmState  # (N, …) at the TCP, with bodies, at the encoder's joints
    wrench: Array  # (N, 6) N, N·m on the robot at the TCP; zero where nothing is recorded
    dimensions: int  # 3 or 6
    is_difference: bool  # deflection: loaded less unloaded
    compliance: Array  # (6,) rad/(N·m) of the first base fit: what sensor errors act through, with ``bodies``
    session: Ints  # (N,)
    visit: Ints  # (N,)
    cycle: Ints  # (N,) unique over poses and sessions
    histories: dict[str, GearLoadHistory] = field(
        default_factory=dict, compare=False
    )  # histories by memory, found before
    springs_only_compliance: Array | None = (
        None  # (6,) rad/(N·m) of the springs with nothing beside them; None: ``compliance``
    )
    bodies: Array | None = None  # (N, 6, 6) compliance at the TCP of bodies found before; None: none was
    inclinometer: InclinometerSetup | None = None  # two more coordinates: rotation of a link about base x and y

    def __len__(self) -> int:
        return len(self.wrench)

    @cached_property
    def load_torque(self) -> Array:
        """(N, 6) N·m, Jᵀw."""
        return np.asarray(np.einsum("nci,nc->ni", self.state.J, self.wrench))

    @cached_property
    def weight_torque(self) -> Array:
        """(N, 6) N·m of links and tool; zero where masses are unknown."""
        if self.masses is None:
            return np.zeros((len(self), 6))
        return compute_gravity_torque(self.robot, self.masses, self.state)[0]

    @property
    def torque(self) -> Array:
        """(N, 6) N·m that the joints bear."""
        return self.load_torque + self.weight_torque

    @cached_property
    def order(self) -> Ints:
        """(N,) rows in the order they were measured: session, then time, then row."""
        time = self.recording.time
        when = np.arange(len(self), dtype=float) if time is None else time
        return np.lexsort((np.arange(len(self)), when, self.session))

    @cached_property
    def cycles(self) -> tuple[Ints, ...]:
        """Rows of each load cycle in the order they were measured, cycles in order too."""
        label = self.cycle[self.order]
        starts = np.flatnonzero(np.diff(label, prepend=label[0] - 1))
        return tuple(np.split(self.order, starts[1:]))

    def project_to_measured(self, twist: Array, first: int) -> Array:
        """What is recorded of twists that begin somewhere in the arm.

        Args:
            twist: (N, 6, …) m, rad at the TCP.
            first: the first body that they move: 0 base_link, i link i, BEHIND what is behind the flange. A link that
                bends counts as moved: the inclinometer is taken to sit at its far end.

        Returns:
            (N, D, …) m, rad; zero where an inclinometer sits before that, or was not read.
        """
        own = twist[:, : self.dimensions]
        if self.inclinometer is None:
            return own
        there = self.inclinometer.present & (first <= self.inclinometer.link)
        tilt = twist[:, 3:5] * there.reshape(there.shape + (1,) * (twist.ndim - 2))
        return np.concatenate([own, tilt], axis=1)

    def lift_joint_twist(self, joint: int, twist: Array) -> Array:
        """What a twist of one joint does to the reading.

        Args:
            joint: 0-based.
            twist: (N,) or (N, p) rad per unit of each coefficient, already as the reading counts it (see ``counted``).

        Returns:
            (N, D, p) m, rad.
        """
        t = twist[:, None] if twist.ndim == 1 else twist
        return np.asarray(self.project_to_measured(self.state.J[:, :, joint], joint + 1)[:, :, None] * t[:, None, :])

    def compute_displacement(self, wrench: Array) -> Array:
        """(N, D) displacement that a wrench (N, 6) at the TCP causes through the compliance found so far."""
        J = self.state.J
        tau = np.einsum("nci,nc->ni", J, wrench)
        twist = np.asarray(np.einsum("nci,ni->nc", J, tau * self.compliance))
        if self.bodies is not None:
            twist += np.einsum("ncd,nd->nc", self.bodies, wrench)
        if self.inclinometer is None:
            return twist[:, : self.dimensions]
        k = self.inclinometer.link  # the joints behind it do not turn it
        twist[:, 3:] = np.einsum("nci,ni->nc", J[:, 3:, :k], (tau * self.compliance)[:, :k])
        rotation = np.einsum("nci,ni->nc", J[:, 3:], tau * self.compliance)[:, : self.dimensions - 3]
        return np.concatenate([twist[:, :3], rotation, twist[:, 3:5] * self.inclinometer.present], axis=1)

    def compute_term_response(self, term: LinearTerm) -> Array:
        """(N, D, P) of a linear elastic term under the recorded wrench (weight apart)."""
        return term.compute_response(self.state, self.wrench)[:, : self.dimensions]

"""Static readings prepared for laws: arm states, torques, and the order of events.

``deflection``: a reading is the loaded arm relative to the unloaded arm. A law φ contributes φ(loaded) − φ(unloaded).
``absolute``: a reading is a pose of the arm. A law contributes φ, including gravity.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import MOST_JOINTS, is_on_arm
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.effects.protocol import JointLoading
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
BODY_BEHIND_FLANGE = MOST_JOINTS + 1  # index of the first body attached to the flange, behind any link


@dataclass(frozen=True)
class GearLoadHistory:
    """Sequence of K ≥ N states of all joints. Each cycle begins with the unloaded arm before its readings."""

    torque: Array  # (K, n) N·m
    time_gap: Array  # (K,) s since the state before, as :func:`machopt.effects.joint.creep.filter_first_order` takes it
    segment_start: Ints  # (K,) 1: a load history begins
    reading_states: Ints  # (N,) state of each reading
    unloaded_states: Ints  # (N,) unloaded state of its cycle

    def select_joint(self, j: int, angle: Array) -> JointLoading:
        """Return the loading of one joint. The unloaded state has the angle of the cycle's first reading.

        Args:
            j: Joint index, 0-based.
            angle: (N,) joint angles of the readings, rad.

        Returns:
            Loading in K states.
        """
        q = np.empty(len(self.time_gap))
        q[self.unloaded_states[::-1]] = angle[::-1]
        q[self.reading_states] = angle
        return JointLoading(self.torque[:, j], q, self.time_gap, self.segment_start)

    def compute_reading_values(self, states: Array, differences: bool) -> Array:
        """Select the values of the readings from the values of all states.

        Args:
            states: (K, …) values of all states.
            differences: Whether readings are relative to the unloaded state of their cycle.

        Returns:
            (N, …) values of the readings.
        """
        return np.asarray(
            states[self.reading_states] - states[self.unloaded_states] if differences else states[self.reading_states]
        )


@dataclass(frozen=True)
class InclinometerSetup:
    """Inclinometer mounted on a link."""

    link: int  # index of the joint that moves the link; 0: base_link
    present: NDArray[np.bool_]  # (N, 2) True if measured


@dataclass(frozen=True, kw_only=True)
class StaticReadings:
    """N readings of an arm at rest, base_link axes, SI."""

    recording: Recording
    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    masses: RobotMasses | None  # None: not in the URDF, weight unknown
    state: ArmState  # (N, …) at the TCP, with bodies, at the encoder angles
    wrench: Array  # (N, 6) N, N·m on the robot at the TCP; zero where nothing is recorded
    dimensions: int  # 3 or 6
    is_difference: bool  # deflection: loaded minus unloaded
    compliance: (
        Array  # (n,) rad/(N·m) of the first base fit; with ``bodies`` the compliance through which sensor errors act
    )
    session: Ints  # (N,)
    visit: Ints  # (N,)
    cycle: Ints  # (N,) unique over poses and sessions
    histories: dict[str, GearLoadHistory] = field(
        default_factory=dict, compare=False
    )  # cache of load histories by kind
    springs_only_compliance: Array | None = (
        None  # (n,) rad/(N·m), springs fitted without other effects; None: ``compliance``
    )
    bodies: Array | None = None  # (N, 6, 6) compliance at the TCP of bodies found earlier; None: none
    inclinometer: InclinometerSetup | None = None  # adds two coordinates: rotation of a link about base x and y

    def __len__(self) -> int:
        return len(self.wrench)

    @property
    def joint_count(self) -> int:
        """Number of joints of the arm, n."""
        return len(self.robot.joints)

    def list_places(self, places: Iterable[str]) -> tuple[str, ...]:
        """Return the places that this arm has.

        Args:
            places: Locations of an effect.
        """
        return tuple(p for p in places if is_on_arm(p, self.joint_count))

    @cached_property
    def load_torque(self) -> Array:
        """Joint torques (N, n) N·m of the recorded load, Jᵀw."""
        return np.asarray(np.einsum("nci,nc->ni", self.state.J, self.wrench))

    @cached_property
    def weight_torque(self) -> Array:
        """Joint torques (N, n) N·m of link and tool weights; zero if masses are unknown."""
        if self.masses is None:
            return np.zeros((len(self), self.joint_count))
        return compute_weight_torque(self.robot, self.masses, self.state)

    @property
    def torque(self) -> Array:
        """Total joint torques (N, n) N·m."""
        return self.load_torque + self.weight_torque

    @cached_property
    def order(self) -> Ints:
        """Row indices (N,) in the order of measurement: session, then time, then row."""
        time = self.recording.time
        when = np.arange(len(self), dtype=float) if time is None else time
        return np.lexsort((np.arange(len(self)), when, self.session))

    @cached_property
    def cycles(self) -> tuple[Ints, ...]:
        """Row indices of each load cycle, cycles and rows in the order of measurement."""
        label = self.cycle[self.order]
        starts = np.flatnonzero(np.diff(label, prepend=label[0] - 1))
        return tuple(np.split(self.order, starts[1:]))

    def project_to_measured(self, twist: Array, first: int) -> Array:
        """Project twists of the TCP to the measured coordinates.

        Args:
            twist: (N, 6, …) m, rad at the TCP.
            first: First body that moves: 0 base_link, i link i, :data:`BODY_BEHIND_FLANGE` the tool. A bending link
                counts as moved: the inclinometer is assumed at its far end.

        Returns:
            (N, D, …) m, rad; zero for an inclinometer that is mounted before that body or was not read.
        """
        own = twist[:, : self.dimensions]
        if self.inclinometer is None:
            return own
        there = self.inclinometer.present & (first <= self.inclinometer.link)
        tilt = twist[:, 3:5] * there.reshape(there.shape + (1,) * (twist.ndim - 2))
        return np.concatenate([own, tilt], axis=1)

    def lift_joint_twist(self, joint: int, twist: Array) -> Array:
        """Compute the change of the readings caused by a twist of one joint.

        Args:
            joint: Joint index, 0-based.
            twist: (N,) or (N, p) rad per unit of each coefficient, as the readings count it (see
                :meth:`GearLoadHistory.compute_reading_values`).

        Returns:
            (N, D, p) m, rad.
        """
        t = twist[:, None] if twist.ndim == 1 else twist
        return np.asarray(self.project_to_measured(self.state.J[:, :, joint], joint + 1)[:, :, None] * t[:, None, :])

    def compute_displacement(self, wrench: Array) -> Array:
        """Compute the displacement that a wrench causes through the compliance identified so far.

        Args:
            wrench: (N, 6) wrench at the TCP, N and N·m.

        Returns:
            (N, D) m, rad.
        """
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

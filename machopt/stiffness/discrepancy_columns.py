"""Possible errors of a stiffness model as columns: the twist of the TCP per unit of each *suspect*.

Prediction errors at unseen poses do not identify the missing physics, but any missing effect acts through some
interface of the arm. Suspects are small free compliances at each of them, with the springs' own errors first:

=================  ==========================================================================  ===============
name               effect                                                                      unit
=================  ==========================================================================  ===============
``joint j``        another compliance of the joint                                             rad/(N·m)
``term n p``       another coefficient p of the file's n-th term                               SI
``coupling i-j``   the torque of one joint rotates the other                                   rad/(N·m)
``cos j, sin j``   a compliance of joint j that changes with its angle                         rad/(N·m)
``play j``, …      tanh of the joint's whole torque over 0.05 … 1 of ``torque`` j              rad
``loop j``         tanh of the load's torque at the joint over 0.05 of ``torque`` j                 rad
``base a``, …      compliance of base, link end or tool along (x y z), about (rx …)            m/N, rad/(N·m)
``loaded``         share of the effect of weight and load on posture and lever arms            1
=================  ==========================================================================  ===============

Covariance of these errors: :mod:`machopt.measurement.identification.assessment.model_discrepancy`; their effect
on a job: :mod:`machopt.planning.uncertainty.stiffness_uncertainty`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.discrepancy_names import (
    AXES,
    COS,
    COUPLING,
    JOINT,
    LOADED,
    SIN,
    TERM,
    format_body_name,
    format_joint_name,
    format_joint_pair_name,
    format_term_name,
    parse_discrepancy_name,
)
from machopt.data_types.effect_locations import format_link_location, parse_link_location
from machopt.dynamics.gravity_torque import compute_gravity_torque, compute_weight_torque
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import cross_product
from machopt.stiffness.kinetostatic_indices import compute_geometric_stiffness
from machopt.stiffness.terms.term_interface import LinearTerm

ROTATION_AXES = AXES[3:]
PLAY_COLUMN = "play"
TYPICAL_PLAY_RAD = 0.34 * np.pi / 10800.0  # rad, half the play of a gear that has some: 0.3 to 1 arcmin is usual
# Share of a joint's torque at which its tanh has gone over. Evenly apart (2.7 times), so that a law that bends anywhere
# between lies near their sum: with two of them a knee between passed for known, and its interval for too narrow.
CURVE_SMOOTHING = {PLAY_COLUMN: 0.05, "slack": 0.13, "knee": 0.35, "bow": 1.0}
LOOP_COLUMN = "loop"  # hysteresis loop of a gear: an angle towards the load's torque, whatever the weight does
LOOP_SMOOTHING = 0.05  # share of the joint's torque at which the loop is open
COUPLED_JOINTS = ((2, 3), (4, 5), (5, 6), (4, 6))


def list_elastic_columns(joints: int = 6) -> tuple[str, ...]:
    """Return the suspects that are linear in the load.

    Args:
        joints: Number of joints of the arm.
    """
    bodies = [("base", AXES), *((format_link_location(i), ROTATION_AXES) for i in range(1, joints)), ("tool", AXES)]
    return (
        *(format_joint_pair_name(i, j) for i, j in COUPLED_JOINTS),
        *(format_joint_name(word, j) for j in range(1, joints + 1) for word in (COS, SIN)),
        *(format_body_name(body, axis) for body, axes in bodies for axis in axes),
    )


def list_gear_columns(joints: int = 6) -> tuple[str, ...]:
    """Return the suspects that depend on the size of the load.

    Args:
        joints: Number of joints of the arm.
    """
    return tuple(format_joint_name(word, j) for j in range(1, joints + 1) for word in CURVE_SMOOTHING)


@dataclass(frozen=True, kw_only=True)
class DiscrepancyColumns:
    """Suspects of an arm's stiffness model.

    Raises:
        InputError: an unknown name.
    """

    robot: Robot
    T_flange_tcp: Array
    names: tuple[str, ...]
    torque: Array  # (6,) N·m, the joints' typical torque under the load tests
    terms: tuple[LinearTerm, ...] = ()  # terms of the file, with their values
    masses: RobotMasses | None = None
    geometric: bool = (
        False  # the file includes the effect of the load alone on lever arms: ``loaded`` is the remaining part
    )

    def __post_init__(self) -> None:
        joints = len(self.robot.joints)
        known = {
            *list_elastic_columns(joints),
            *list_gear_columns(joints),
            *(format_joint_name(JOINT, j) for j in range(1, joints + 1)),
            *(format_joint_name(LOOP_COLUMN, j) for j in range(1, joints + 1)),
            LOADED,
        }
        known |= {format_term_name(n, p) for n, t in enumerate(self.terms) for p in range(len(t.coefficients))}
        wrong = [n for n in self.names if n not in known]
        if wrong:
            raise InputError(f"found {wrong[0]!r}; no such part of this arm may be missing", where="discrepancy.parts")

    def compute_columns(
        self, state: ArmState, k: Array, wrench: Array, *, small: bool = False, weight: Array | None = None
    ) -> Array:
        """Return the (M, 6, K) twist of the TCP in base_link axes per unit of each suspect.

        Args:
            state: M configurations with bodies.
            k: (M, 6) N·m/rad of the model.
            wrench: (M, 6) N, N·m at the TCP.
            small: the tangent under weight, for an infinitesimal load.
            weight: (M, 6) N·m, torque of weight, if already known.
        """
        J = state.J
        load = np.einsum("mci,mc->mi", J, wrench)
        if weight is None:
            weight = self.compute_weight_torque(state)
        out = np.empty((len(load), 6, len(self.names)))
        cached: dict[int, Array] = {}
        for n, name in enumerate(self.names):
            part = parse_discrepancy_name(name)
            word = part.kind
            if word in (JOINT, COS, SIN, LOOP_COLUMN, *CURVE_SMOOTHING):
                (j,) = part.numbers
                out[:, :, n] = (
                    J[:, :, j] * self._compute_joint_rotation(word, j, load, weight, state.q, small=small)[:, None]
                )
            elif word == COUPLING:
                i, j = part.numbers
                out[:, :, n] = J[:, :, i] * load[:, j, None] + J[:, :, j] * load[:, i, None]
            elif word == TERM:
                t, p = part.numbers
                if t not in cached:
                    cached[t] = np.asarray(
                        self.terms[t].compute_response_under_weight(state, wrench, weight, small=small)
                    )
                out[:, :, n] = cached[t][:, :, p]
            elif word == LOADED:
                out[:, :, n] = self._compute_load_coupling(state, k, wrench, weight, small=small)
            else:
                out[:, :, n] = self._compute_body_twist(word, part.axis, state, wrench)
        return out

    def compute_weight_torque(self, state: ArmState) -> Array:
        """Return the (M, 6) torque in N·m of weight at the joints; zero where no mass is known.

        Args:
            state: M configurations with bodies.
        """
        if self.masses is None:
            return np.zeros(state.q.shape)
        return compute_weight_torque(self.robot, self.masses, state)

    def _compute_load_coupling(self, state: ArmState, k: Array, wrench: Array, weight: Array, *, small: bool) -> Array:
        """Return the (M, 6) additional twist because weight bends the arm, and because the load changes lever arms.

        J' (K − K_C)⁻¹ J'ᵀw − J K⁻¹ Jᵀw to first order in K_C, J' at the joints bent by the weight; minus the same
        of an arm without weight where the file includes that.
        """
        J = state.J
        turn = np.einsum("mci,mc->mi", J, wrench) / k
        if self.geometric and not small:
            turn = turn + np.einsum("mij,mj->mi", compute_geometric_stiffness(J, wrench), turn) / k
        rotated = np.einsum("mci,mi->mc", J, turn)
        H = np.zeros((len(k), k.shape[1], k.shape[1]))
        if self.masses is not None:
            state = self.robot.compute_state(state.q + weight / k, self.T_flange_tcp, bodies=True)
            H = H + compute_gravity_torque(self.robot, self.masses, state)[1]
        J = state.J
        if not small:
            H = H + compute_geometric_stiffness(J, wrench)
        turn = np.einsum("mci,mc->mi", J, wrench) / k
        turn = turn + np.einsum("mij,mj->mi", H, turn) / k
        return np.asarray(np.einsum("mci,mi->mc", J, turn) - rotated)

    def _compute_joint_rotation(self, word: str, j: int, load: Array, weight: Array, q: Array, *, small: bool) -> Array:
        """Return the (M,) rotation of joint j in rad per unit; an infinitesimal load opens no loop."""
        if word == LOOP_COLUMN:
            open_loop = np.tanh(load[:, j] / (LOOP_SMOOTHING * self.torque[j]))
            return np.zeros_like(open_loop) if small else np.asarray(open_loop)
        if word not in CURVE_SMOOTHING:
            if word == JOINT:
                return np.asarray(load[:, j])
            return np.asarray((np.cos(q[:, j]) if word == COS else np.sin(q[:, j])) * load[:, j])
        scale = CURVE_SMOOTHING[word] * self.torque[j]
        before = np.tanh(weight[:, j] / scale)
        if small:
            return np.asarray((1.0 - before**2) / scale * load[:, j])
        return np.asarray(np.tanh((weight[:, j] + load[:, j]) / scale) - before)

    def _compute_body_twist(self, place: str, axis: int, state: ArmState, wrench: Array) -> Array:
        """Return the (M, 6) twist of the TCP for a compliance of one body along or about one of its axes at q = 0."""
        if state.R_bodies is None or state.p_bodies is None:
            raise ValueError("an ArmState with bodies is needed")
        body, at = locate_compliance(self.robot, place)
        R = state.R_bodies[:, body]
        r = state.T_base_tool[:, :3, 3] - state.p_bodies[:, body] - R @ at
        a = R[:, :, axis % 3]
        force = wrench[:, :3]
        if axis < 3:
            shift = a * np.einsum("mi,mi->m", a, force)[:, None]
            return np.concatenate([shift, np.zeros_like(shift)], axis=1)
        turn = a * np.einsum("mi,mi->m", a, wrench[:, 3:] + cross_product(r, force))[:, None]
        return np.concatenate([cross_product(turn, r), turn], axis=1)


def compute_lever(robot: Robot, T_base_tool: Array, state: ArmState, place: str) -> float:
    """Return the typical distance in m of the TCP from the location of a body's compliance.

    Args:
        robot: kinematic model.
        T_base_tool: (M, 4, 4) tool poses.
        state: the same M configurations with bodies.
        place: "base", "tool" or a link.

    Raises:
        ValueError: the state has no bodies.
    """
    if state.R_bodies is None or state.p_bodies is None:
        raise ValueError("an ArmState with bodies is needed")
    body, at = locate_compliance(robot, place)
    r = T_base_tool[:, :3, 3] - state.p_bodies[:, body] - state.R_bodies[:, body] @ at
    return float(np.sqrt(np.mean(np.sum(r**2, axis=1))))


def locate_compliance(robot: Robot, place: str) -> tuple[int, Array]:
    """Return the body index, and the location (3,) m of its compliance in base_link at q = 0.

    Args:
        robot: kinematic model.
        place: "base", "tool" or a link.
    """
    if place == "base":
        return 0, np.zeros(3)
    if place == "tool":
        return len(robot.joints), np.asarray(robot.T_base_flange_zero[:3, 3])
    link = parse_link_location(place)
    return link, np.asarray([*robot.point, robot.T_base_flange_zero[:3, 3]][link])


def compute_typical_sizes(s: DiscrepancyColumns, state: ArmState, k: Array, names: Sequence[str]) -> Array:
    """Return the (K,) size of each suspect if it were as compliant as the adjacent joints.

    Args:
        s: suspects of the arm.
        state: M configurations with bodies.
        k: (6,) N·m/rad, joint stiffness.
        names: suspects.
    """
    c = 1.0 / np.asarray(k, float)  # (6,)
    out = []
    for name in names:
        part = parse_discrepancy_name(name)
        word = part.kind
        if word in (JOINT, COS, SIN):
            out.append(c[part.numbers[0]])
        elif word in CURVE_SMOOTHING:
            out.append(c[part.numbers[0]] * s.torque[part.numbers[0]])
        elif word == COUPLING:
            i, j = part.numbers
            out.append(np.sqrt(c[i] * c[j]))
        elif word == LOADED:
            out.append(1.0)
        else:
            near = locate_compliance(s.robot, word)[0]
            soft = float(np.mean(c[:3])) if near == 0 else float(np.mean(c[near - 1 : near + 1]))
            long = compute_lever(s.robot, state.T_base_tool, state, word)
            out.append(soft if AXES[part.axis] in ROTATION_AXES else soft * (0.3 * long) ** 2)
    return np.array(out)

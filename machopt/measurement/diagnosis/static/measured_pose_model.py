"""Nominal model of measured poses: encoders → corrected angles → equilibrium → tracker reading.

A recording may contain several reflectors on the flange (one per reading) and several tracker stations. The *point*
of a reading is the reflector or the TCP. States refer to that point, and the recorded load is referred to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import format_joint_location
from machopt.data_types.kinematic_corrections import KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.parameter_keys import build_joint_spring_key
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.effects import prior_scales
from machopt.effects.protocol import JOINTS
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types import reflectors_and_tracker_frames
from machopt.measurement.diagnosis.data_types.diagnosis_problem import BaseUnknown
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import as_built_joint_frames
from machopt.measurement.diagnosis.static import unknown_link_masses
from machopt.measurement.diagnosis.static.measured_pose_hypothesis_catalogue import (
    compute_column_span,
    compute_remaining_share,
)
from machopt.measurement.identification.data_quality.unit_checks import GENERIC_STIFFNESS
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import (
    convert_quaternion_to_matrix,
    convert_to_rotation_vector,
    convert_vector_to_rotation,
    skew_matrix,
)

EQUILIBRIUM_STEPS = 4  # fixed-point iterations for the loaded equilibrium; each reduces the error a thousandfold
REPEATED_EQUILIBRIUM_STEPS = 2  # iterations from the equilibrium of a previous fit
STEPS = 5  # iterations of the robust first fit


@dataclass(frozen=True)
class FirstPoseFit:
    """Result of the first fit: tracker frames in base_link (about the centroid of the points), targets, compliances."""

    shift: Array  # (F, 3) m
    turn: Array  # (F, 3) rad
    target: Array  # (T, 3) m, flange axes, offset from the nominal position or the cell's TCP
    compliance: Array  # (n,) rad/(N·m)


@dataclass(frozen=True)
class CorrectedArm:
    """Arm with found corrections about which the model is linearised."""

    robot: Robot
    kinematics: KinematicCorrections


@dataclass(frozen=True)
class BaseStep:
    """Vector of base unknowns, separated by kind."""

    springs: dict[int, float]  # by joint, 0-based
    shift: Array  # (F, 3) m; zero for known frames
    turn: Array  # (F, 3)
    target: Array  # (T, 3)


class NominalPoseModel:
    """Nominal model of a recording of measured poses."""

    def __init__(
        self,
        recording: Recording,
        cell: Cell,
        robot: Robot,
        masses: RobotMasses | None,
        fixed_joints: frozenset[int],
        about: CorrectedArm | None = None,
    ) -> None:
        """Build the model.

        Args:
            recording: Measured poses.
            cell: Robot cell.
            robot: Kinematic model of the arm.
            masses: Link and tool masses, or None.
            fixed_joints: Joints (1-based) with the cell's spring, not refitted.
            about: Corrected arm to linearise about; None: the cell's own kinematics.
        """
        assert recording.position is not None  # checked by the caller
        self.recording, self.cell, self.masses, self.kept_springs = recording, cell, masses, fixed_joints
        self.encoders = robot  # uncorrected arm: reference of inclinometers
        self.robot = robot if about is None else about.robot
        known = build_encoder_correction(cell.kinematics if about is None else about.kinematics)
        self.angles = recording.q if known is None else known.compute_true_angles(recording.q)
        self.position = recording.position
        self.rotation = None if recording.quaternion is None else convert_quaternion_to_matrix(recording.quaternion)
        self.D = 3 if self.rotation is None else 6
        self.settled: Array | None = None  # (N, n) rad, equilibrium of the last prediction
        self.free = recording.registration == "fit"  # tracker frames are fitted
        self.placed = self.free or bool(recording.targets)  # target positions are fitted
        self.frame_index, self.reflector_index = (
            reflectors_and_tracker_frames.index_tracker_frames(recording),
            reflectors_and_tracker_frames.index_reflectors(recording),
        )
        self.frame_count, self.targets = int(self.frame_index.max()) + 1, max(len(recording.targets), 1)
        T = cell.tool.T_flange_tcp
        self.places = (
            reflectors_and_tracker_frames.list_reflector_positions(recording, T) - T[:3, 3]
        )  # (T, 3) m, flange axes, relative to the TCP
        state = robot.compute_state(self.angles, T)
        self.wrench = _convert_wrench_to_base(recording, robot, T, self.angles, state)  # about the TCP
        self.middle = state.T_base_tool[:, :3, 3].mean(axis=0)
        nominal = None if cell.stiffness is None else 1.0 / cell.stiffness.joints
        self.nominal = np.full(len(robot.joints), 1.0 / GENERIC_STIFFNESS) if nominal is None else nominal
        if robot.slides is not None:  # rigid along its axis: a constant weight shifts all points like a frame
            self.nominal = np.where(robot.slides, 0.0, self.nominal)
        # under gravity alone, joint deflections depend on the angles, as frames and harmonics do
        self.weight_alone = cell.stiffness is not None and float(np.abs(self.wrench).max()) == 0.0

    def find_undetermined_springs(self, frame: FirstPoseFit) -> frozenset[int]:
        """Find joints (1-based) whose springs gravity alone deflects, indistinguishably from frame errors.

        Joint deflection by gravity follows from the joint angles, as the effect of a displaced frame does. A spring
        that the joint frames almost absorb could become very soft or negative to imitate gear harmonics. It keeps the
        cell's value.

        Args:
            frame: Current fit of frames, targets and compliances.
        """
        if not self.weight_alone:
            return frozenset()
        state, p, R = self.predict(frame)
        columns, unknowns = self.columns(state, p)
        readings = self.build_readings(state, frame, frame.compliance)
        rest = columns[:, :, [u.spring_joint is None for u in unknowns]]
        frames = [
            as_built_joint_frames.compute_frame_columns(readings, where) for where in readings.list_places(JOINTS)
        ]
        Q = compute_column_span(np.concatenate([rest, *frames], axis=2))
        least = thresholds.SHARES.negligible * compute_robust_spread(self.residual(frame, p, R)[:, :3])
        bend = state.J[:, : self.D] * (self.nominal * self.compute_torque(state))[:, None, :]
        shown = [
            compute_remaining_share(bend[:, :, j : j + 1], Q) * float(np.sqrt(np.mean(bend[:, :3, j] ** 2)))
            for j in range(len(self.robot.joints))
        ]
        return frozenset(j + 1 for j in range(len(shown)) if shown[j] < least)

    def compute_load(self, state: ArmState) -> Array:
        """Return the recorded load (N, 6) N, N·m referred to the measured points.

        Args:
            state: Arm state at the loaded equilibrium.
        """
        if not self.recording.targets or not self.wrench.any():
            return self.wrench
        lever = -np.einsum("nij,nj->ni", self._compute_flange_rotation(state), self.places[self.reflector_index])
        return np.concatenate([self.wrench[:, :3], self.wrench[:, 3:] + np.cross(lever, self.wrench[:, :3])], axis=1)

    def compute_torque(self, state: ArmState) -> Array:
        """Return the joint torques (N, n) N·m of load and weight.

        Args:
            state: Arm state at the loaded equilibrium.
        """
        tau = np.einsum("nci,nc->ni", state.J, self.compute_load(state))
        return np.asarray(tau if self.masses is None else tau + compute_weight_torque(self.robot, self.masses, state))

    def predict(self, frame: FirstPoseFit) -> tuple[ArmState, Array, Array]:
        """Predict the arm state and the measured points at the loaded equilibrium.

        Args:
            frame: Current fit of frames, targets and compliances.

        Returns:
            State, points (N, 3) m and TCP orientations (N, 3, 3) in base_link.
        """
        T = self.cell.tool.T_flange_tcp.copy()
        if not self.recording.targets:
            T[:3, 3] += frame.target[0]
        theta = self.angles if self.settled is None else self.settled
        for _ in range(EQUILIBRIUM_STEPS if self.settled is None else REPEATED_EQUILIBRIUM_STEPS):
            state = self._move_state_to_points(self.robot.compute_state(theta, T, bodies=True), frame)
            theta = self.angles + frame.compliance * self.compute_torque(state)
        self.settled = theta
        state = self._move_state_to_points(self.robot.compute_state(theta, T, bodies=True), frame)
        return state, state.T_base_tool[:, :3, 3], state.T_base_tool[:, :3, :3]

    def residual(self, frame: FirstPoseFit, p: Array, R: Array) -> Array:
        """Return measured (transformed to base_link) minus predicted values.

        Args:
            frame: Current fit of frames, targets and compliances.
            p: (N, 3) predicted points, m, base_link.
            R: (N, 3, 3) predicted TCP orientations.

        Returns:
            (N, D) m and rotation vectors in base axes, rad.
        """
        Q = convert_vector_to_rotation(frame.turn)[self.frame_index]
        away = self.position - frame.shift[self.frame_index] - self.middle
        seen = self.middle + np.einsum("nji,nj->ni", Q, away)
        if self.rotation is None:
            return np.asarray(seen - p)
        turned = np.swapaxes(Q, 1, 2) @ self.rotation @ np.swapaxes(R, -1, -2)
        return np.concatenate([seen - p, convert_to_rotation_vector(turned)], axis=1)

    def columns(self, state: ArmState, p: Array) -> tuple[Array, list[BaseUnknown]]:
        """Return the base columns and unknowns: springs, translation and rotation of each frame, position of each
        target.

        Args:
            state: Arm state at the loaded equilibrium.
            p: (N, 3) predicted points, m, base_link.

        Returns:
            (N, D, P) columns, and the unknowns.
        """
        parts, unknowns = [], []
        fitted = [j for j in range(len(self.robot.joints)) if j + 1 not in self.kept_springs]
        bend = state.J * self.compute_torque(state)[:, None, :] if fitted else state.J
        for j in fitted:
            if np.sqrt(np.mean(bend[:, :3, j] ** 2)) * self.nominal[j] > thresholds.LIMITS.displacement:
                parts.append(bend[:, : self.D, j : j + 1])
                known = prior_scales.COMPLIANCE.scale * self.nominal[j] if self.cell.stiffness is not None else None
                where, key = format_joint_location(j + 1), build_joint_spring_key(j + 1)
                built = (
                    (thresholds.SHARES.minority * self.nominal[j], prior_scales.COMPLIANCE.scale * self.nominal[j])
                    if self.weight_alone
                    else None
                )
                unknowns.append(
                    BaseUnknown(
                        name=f"joint {j + 1}",
                        unit="rad/(N·m)",
                        lower=0.0,
                        location=where,
                        prior=known,
                        key=key,
                        plausible_range=built,
                    )
                )
        parts += self._build_frame_columns(p) if self.free else []
        parts += self._build_reflector_columns(state) if self.placed else []
        unknowns += self._list_frame_unknowns() if self.free else []
        unknowns += self._list_reflector_unknowns() if self.placed else []
        return np.concatenate(parts, axis=2) if parts else np.zeros((len(p), self.D, 0)), unknowns

    def split_unknowns(self, unknowns: Sequence[BaseUnknown], x: Array) -> BaseStep:
        """Separate a vector of base unknowns by kind.

        Args:
            unknowns: Base unknowns of the columns.
            x: (P,) values, SI.
        """
        springs = {u.spring_joint - 1: float(v) for u, v in zip(unknowns, x, strict=True) if u.spring_joint is not None}
        rest = x[len(springs) :]
        frames = rest[: 6 * self.frame_count].reshape(-1, 6) if self.free else np.zeros((self.frame_count, 6))
        target = rest[rest.size - 3 * self.targets :].reshape(-1, 3) if self.placed else np.zeros((self.targets, 3))
        return BaseStep(springs, frames[:, :3], frames[:, 3:], target)

    def build_start_values(self, unknowns: Sequence[BaseUnknown], frame: FirstPoseFit) -> Array:
        """Return start values: totals for springs and targets, zero for frames, which are fitted as steps.

        Args:
            unknowns: Base unknowns of the columns.
            frame: Current fit of frames, targets and compliances.
        """
        springs = [frame.compliance[u.spring_joint - 1] for u in unknowns if u.spring_joint is not None]
        frames = np.zeros(6 * self.frame_count if self.free else 0)
        return np.concatenate([springs, frames, frame.target.reshape(-1) if self.placed else []])

    def fit_base(self, loose: float = 1.0) -> FirstPoseFit:
        """Fit compliances, tracker frames and targets by Gauss–Newton with Huber weights.

        Args:
            loose: Factor on the uncertainty of nominal target positions.
        """
        frame = FirstPoseFit(
            np.zeros((self.frame_count, 3)),
            np.zeros((self.frame_count, 3)),
            np.zeros((self.targets, 3)),
            self.nominal.copy(),
        )
        for _ in range(STEPS):
            state, p, R = self.predict(frame)
            r = self.residual(frame, p, R)
            B, unknowns = self.columns(state, p)
            totals = self.build_start_values(unknowns, frame)
            now = np.where([u.spring_joint is not None for u in unknowns], totals, 0.0)  # others are fitted as steps
            x = self._robust(r + B @ now, B, unknowns, totals, loose)
            frame = self._compute_displacement(frame, self.split_unknowns(unknowns, x))
        return frame

    def count_undetermined_directions(self, columns: Array, unknowns: Sequence[BaseUnknown]) -> int:
        """Count the directions of frames and reflectors that only nominal positions determine.

        Args:
            columns: (N, D, P) base columns.
            unknowns: Base unknowns of the columns.
        """
        rest = columns[:, :3, [u.spring_joint is None for u in unknowns]].reshape(3 * len(columns), -1)
        size = np.linalg.norm(rest, axis=0)
        if not rest.shape[1]:
            return 0
        s = np.linalg.svd(rest / np.maximum(size, 1e-300), compute_uv=False)
        return int(np.sum(s < thresholds.SHARES.rank * s[0]))

    def build_readings(self, state: ArmState, frame: FirstPoseFit, springs: Array) -> StaticReadings:
        """Build the static readings for laws: bodies and Jacobian at the loaded arm, joint angles of the encoders.

        Unstated weights make springs too soft in a fit, and would then be searched through these springs. The
        compliances are therefore limited to a factor around the cell's.

        Args:
            state: Arm state at the loaded equilibrium.
            frame: Current fit of frames, targets and compliances.
            springs: (6,) joint compliances, rad/(N·m).
        """
        near = thresholds.RATIOS.double if self.cell.stiffness is not None else thresholds.RATIOS.implausible
        _, session = np.unique(self.recording.session, return_inverse=True)
        none = np.zeros(len(self.angles), np.int64)
        T = self.cell.tool.T_flange_tcp.copy()
        if not self.recording.targets:
            T[:3, 3] += frame.target[0]
        return StaticReadings(
            recording=self.recording,
            robot=self.robot,
            T_flange_tcp=T,
            masses=self.masses,
            state=replace(state, q=self.recording.q),
            wrench=self.compute_load(state),
            dimensions=self.D,
            is_difference=False,
            compliance=np.clip(
                springs, self.nominal / near, np.inf if self.cell.stiffness is None else near * self.nominal
            ),
            session=session.reshape(-1).astype(np.int64),
            visit=none,
            cycle=none,
        )

    def build_notes(self, frame: FirstPoseFit) -> tuple[str, ...]:
        """Return notes on the fitted frames and targets, and on missing masses.

        Args:
            frame: Current fit of frames, targets and compliances.
        """
        out = []
        for n, name in enumerate(reflectors_and_tracker_frames.list_frame_labels(self.recording)) if self.free else ():
            shift, turn = (", ".join(f"{1e3 * v:.3f}" for v in a[n]) for a in (frame.shift, frame.turn))
            of = f"the tracker frame of stand {name}" if self.frame_count > 1 else "the tracker frame"
            beside = (
                "" if self.recording.targets else f" and the target by ({_format_mm(frame.target[0])}) mm in the flange"
            )
            out.append(
                f"a first robust fit moved {of} by ({shift}) mm and ({turn}) mrad about the middle of the "
                f"points{beside}; {'it is' if self.recording.targets else 'both are'} refitted with every explanation"
            )
        if self.recording.targets:
            each = "; ".join(
                f"{t.name} by ({_format_mm(at)})" for t, at in zip(self.recording.targets, frame.target, strict=True)
            )
            out.append(f"the reflectors sit beside their nominal places in flange, in mm: {each}; refitted likewise")
        if self.masses is None:
            out.append("the URDF has no masses, so the deflection under weight is not modelled")
        elif unknown_link_masses.list_links_without_mass(self.masses):
            out.append(
                f"{unknown_link_masses.describe_missing_masses(self.masses)}, whose own weight is not modelled; "
                f"all that is stated is"
            )
        if self.cell.kinematics is not None:
            out.append("the cell's kinematic corrections are counted; what is found comes on top of them")
        return tuple(out)

    def _compute_flange_rotation(self, state: ArmState) -> Array:
        return np.asarray(state.T_base_tool[:, :3, :3] @ self.cell.tool.T_flange_tcp[:3, :3].T)

    def _move_state_to_points(self, state: ArmState, frame: FirstPoseFit) -> ArmState:
        """Return a TCP state referred to the measured points."""
        if not self.recording.targets:
            return state
        beside = np.einsum(
            "nij,nj->ni", self._compute_flange_rotation(state), (self.places + frame.target)[self.reflector_index]
        )
        T, J = state.T_base_tool.copy(), state.J.copy()
        T[:, :3, 3] += beside
        J[:, :3] += np.swapaxes(np.cross(np.swapaxes(J[:, 3:], 1, 2), beside[:, None]), 1, 2)
        return replace(state, T_base_tool=T, J=J)

    def _build_frame_columns(self, p: Array) -> list[Array]:
        frame = np.zeros((len(p), 6, 6))
        frame[:, :, :] = np.eye(6)
        frame[:, :3, 3:] = -skew_matrix(p - self.middle)
        if self.frame_count == 1:
            return [frame[:, : self.D]]
        return [frame[:, : self.D] * (self.frame_index == n)[:, None, None] for n in range(self.frame_count)]

    def _build_reflector_columns(self, state: ArmState) -> list[Array]:
        target = np.zeros((len(state.q), self.D, 3))
        target[:, :3] = self._compute_flange_rotation(state)
        if self.targets == 1:
            return [target]
        return [target * (self.reflector_index == n)[:, None, None] for n in range(self.targets)]

    def _list_frame_unknowns(self) -> list[BaseUnknown]:
        out = []
        for name in reflectors_and_tracker_frames.list_frame_labels(self.recording):
            of = f" of stand {name}" if self.frame_count > 1 else ""
            out += [BaseUnknown(name=f"registration {a}{of}", unit="m", location="registration") for a in "xyz"]
            out += [BaseUnknown(name=f"registration turn {a}{of}", unit="rad", location="registration") for a in "xyz"]
        return out

    def _list_reflector_unknowns(self) -> list[BaseUnknown]:
        if not self.recording.targets:
            return [BaseUnknown(name=f"target {a}", unit="m", location="tool") for a in "xyz"]
        sigma = self.recording.uncertainty.target or prior_scales.TARGET_POSITION.scale
        return [
            BaseUnknown(name=f"target {t.name} {a}", unit="m", location="tool", prior=sigma)
            for t in self.recording.targets
            for a in "xyz"
        ]

    def _robust(self, y: Array, B: Array, unknowns: Sequence[BaseUnknown], totals: Array, loose: float) -> Array:
        scale = np.array([1.0] * 3 + [thresholds.LIMITS.lever] * 3)[: self.D]
        A, b = (B * scale[:, None]).reshape(y.size, B.shape[2]), (y * scale).reshape(-1)
        spring = np.array([u.spring_joint is not None for u in unknowns], bool)
        size = np.array([1.0 if u.spring_joint is None else self.nominal[u.spring_joint - 1] for u in unknowns])
        nest = np.array([u.spring_joint is None and u.prior is not None for u in unknowns], bool)
        lean = np.where(spring, 1.0 / prior_scales.FIRST_FIT_COMPLIANCE.scale, 0.0)
        placed = [unknowns[k].prior or prior_scales.TARGET_POSITION.scale for k in np.flatnonzero(nest).tolist()]
        lean[nest] = 1.0 / (loose * np.array(placed))
        to = np.where(nest, -lean * totals, 0.0)  # steps towards nominal positions
        lower = np.array([u.lower for u in unknowns])
        weight, x = np.ones(len(y)), np.zeros(len(unknowns))
        for _ in range(8):
            rows = np.repeat(weight, self.D)
            sigma = compute_robust_spread((b - A @ x).reshape(-1, self.D)) if x.any() else compute_robust_spread(y)
            M = np.concatenate([A * size * rows[:, None] / sigma, np.diag(lean)])
            whole = np.column_stack([M, np.concatenate([b * rows / sigma, to])])
            small = np.asarray(np.linalg.qr(whole, mode="r"))  # equivalent least-squares problem with few rows
            x = size * lsq_linear(small[:, :-1], small[:, -1], (lower / size, np.inf)).x
            error = np.linalg.norm((b - A @ x).reshape(-1, self.D), axis=1)
            limit = (
                thresholds.LEVELS.two_sigma * compute_robust_spread((b - A @ x).reshape(-1, self.D)) * np.sqrt(self.D)
            )
            weight = np.sqrt(np.minimum(1.0, limit / np.maximum(error, 1e-12)))
        return x

    def _compute_displacement(self, frame: FirstPoseFit, step: BaseStep) -> FirstPoseFit:
        compliance = frame.compliance.copy()
        for j, value in step.springs.items():
            compliance[j] = value
        Q = convert_vector_to_rotation(frame.turn)
        return FirstPoseFit(
            frame.shift + np.einsum("fij,fj->fi", Q, step.shift),
            convert_to_rotation_vector(Q @ convert_vector_to_rotation(step.turn)),
            frame.target + step.target,
            compliance,
        )


def compute_robust_spread(r: Array) -> float:
    """Compute the robust standard deviation of a coordinate.

    Args:
        r: (N, D) values, m.

    Returns:
        Standard deviation, m, above zero.
    """
    return max(1.4826 * float(np.median(np.abs(r - np.median(r, axis=0)))), 1e-9)


def _format_mm(at: Array) -> str:
    return ", ".join(f"{1e3 * v:.3f}" for v in at)


def _convert_wrench_to_base(
    recording: Recording, robot: Robot, T_flange_tcp: Array, q: Array, state: ArmState
) -> Array:
    """Return the recorded wrench (N, 6) at the TCP in base axes; zero if none is recorded."""
    if recording.wrench is None:
        return np.zeros((len(q), 6))
    wrench = recording.wrench.copy()
    R, p = state.T_base_tool[:, :3, :3], state.T_base_tool[:, :3, 3]
    if recording.wrench_frame == "tool":
        wrench = np.concatenate([np.einsum("nij,nj->ni", R, wrench[:, a : a + 3]) for a in (0, 3)], axis=1)
    if recording.wrench_point is not None:
        flange = robot.compute_fk(q)
        at = flange[:, :3, 3] + np.einsum("nij,j->ni", flange[:, :3, :3], recording.wrench_point)
        wrench[:, 3:] += np.cross(at - p, wrench[:, :3])
    return wrench

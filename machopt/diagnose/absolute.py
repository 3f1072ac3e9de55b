"""Measured TCP poses at known joints: where the arm is, not how far it gives; shows geometry, weight and heat.

y is the measured TCP less what the encoders say, with what is known counted exactly: finite rotations, corrections that
the cell's kinematics.yaml holds, the equilibrium under weight and load at a first fit (K_C and all). Columns of the
base: joint compliances under weight and load, and with ``registration: fit`` a small twist of the tracker frame about
the middle of the points and the target's place in the flange. Coefficients of compliances and target are totals; the
frame's twist is what a first robust fit left over.

What may explain the rest: :mod:`machopt.diagnose.absolute_catalogue`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from machopt.arrays import Array
from machopt.diagnose import calibrated, held, laws_geometry, loads
from machopt.diagnose.absolute_catalogue import LEVER, catalogue, left, spanned
from machopt.diagnose.problem import Catalogue, Family, Problem, Unknown
from machopt.diagnose.readings import Readings
from machopt.domain.cell import Cell
from machopt.domain.parameters import joint_spring
from machopt.domain.recording import Recording
from machopt.domain.stiffness import Term
from machopt.effects.protocol import JOINTS
from machopt.errors import InputError
from machopt.model.correction import correction_of
from machopt.model.gravity import gravity_torque
from machopt.model.robot import ArmState, Masses, Robot
from machopt.se3 import quaternion_matrix, rotation_from_vector, rotation_vector, skew

Ints = NDArray[np.int64]
SETTLED = 4  # fixed-point steps to the loaded equilibrium; each is a thousand times nearer than the one before
STEPS = 5  # of the robust first fit
PRIOR = 1.0  # relative 1 sigma of the cell's stiffness, which the first fit leans on where weight says nothing
STIFFEST = 0.2  # times the cell's compliance: less, or a spring that pushes back, is what frames and waves make of it
SEEN = 0.02  # of what the first fit leaves: a spring that gives less beside all frames would take up anything else
SOFT = 1e-6  # rad/(N·m), where the cell has no stiffness


@dataclass(frozen=True)
class _Frame:
    """What the first fit found: the tracker frame in base_link (about the middle of the points) and the target."""

    shift: Array  # (3,) m
    turn: Array  # (3,) rad
    target: Array  # (3,) m, in the flange's axes, beside the cell's TCP
    compliance: Array  # (6,) rad/(N·m)


def build(
    recording: Recording,
    cell: Cell,
    robot: Robot,
    masses: Masses | None,
    rng: np.random.Generator,
    terms: tuple[Term, ...] = (),
    found: Mapping[int, float] | None = None,
    kept: frozenset[int] = frozenset(),
) -> tuple[Problem, Catalogue, tuple[str, ...]]:
    """Equations and hypotheses of measured TCP poses.

    y = p_measured − p(q), p(q) the TCP by the encoder's joints; y ≈ B x, B the columns of the base.

    Args:
        recording: kind "absolute", N readings, as corrected by the record checks.
        cell: its TCP, stiffness (where the first fit starts) and kinematic corrections.
        robot: the arm whose joints ``recording.q`` are.
        masses: of links and tool; None where the URDF has none: then weight bends nothing.
        rng: nothing here is drawn at random; part of every channel's signature.
        terms: of the cell's stiffness, that count as known.
        found: compliance rad/(N·m) of joints, from 1, beside what was found before; None: nothing was looked for yet.
        kept: joints, from 1, whose springs are the cell's and not refitted.

    Returns:
        Problem (D = 3, or 6 with rotation vectors in base axes where quaternions are recorded), catalogue, notes.

    Raises:
        InputError: another kind of recording, or one without measured positions.

    Source: Klimchik et al. arXiv 1311.6810 (elasto-static calibration: y = J Δπ + J C Jᵀ w).
    Invalid: for a tracker frame turned by more than some degrees against base_link (register it first).
    """
    if recording.kind != "absolute" or recording.position is None:
        raise InputError(
            f"is a recording of kind {recording.kind!r}; measured poses are of kind 'absolute' with x_mm, y_mm, z_mm",
            file=recording.source,
        )
    model = _Model(recording, cell, robot, masses, kept)
    frame = model.first_fit()
    unseen = model.unseen(frame)
    if not unseen <= kept:
        model = _Model(recording, cell, robot, masses, kept | unseen)
        frame = model.first_fit()
    state, p, R = model.predict(frame)
    y = model.residual(frame, p, R)
    base, unknowns = model.columns(state, p)
    totals = np.zeros(len(unknowns))
    for n, u in enumerate(unknowns):
        if u.spring is not None:
            totals[n] = frame.compliance[u.spring - 1]
        elif u.location == "tool":
            totals[n] = frame.target["xyz".index(u.name[-1])]
    y = y + base @ totals
    springs = frame.compliance.copy()
    for joint, compliance in (found or {}).items():
        if joint not in model.kept:
            springs[joint - 1] = compliance
    readings = model.readings(state, frame, springs)
    y = y - held.at_rest(readings, terms)[:, : model.D]
    visit, replicate = _labels(recording, readings.wrench)
    stated = recording.uncertainty
    families = [Family("translation", (0, 1, 2), "mm", 1e3, stated.displacement)]
    if model.D == 6:
        families.append(Family("rotation", (3, 4, 5), "mrad", 1e3, stated.rotation))
    loaded = bool(np.abs(readings.wrench).max() > 0.0)
    problem = Problem(
        "position",
        y,
        base,
        tuple(unknowns),
        tuple(families),
        recording.pose,
        visit,
        visit,
        readings.session,
        replicate,
        recording.line,
        np.arange(1, len(recording) + 1),
        scale=readings.through(readings.wrench) if loaded else None,
        time=recording.time,
    )
    readings = replace(readings, visit=visit, cycle=visit)
    return problem, catalogue(readings, problem), model.notes(frame)


class _Model:
    """The nominal model of a recording: encoders → corrected angles → equilibrium → TCP in the tracker's frame."""

    def __init__(
        self, recording: Recording, cell: Cell, robot: Robot, masses: Masses | None, kept: frozenset[int]
    ) -> None:
        assert recording.position is not None  # build checks it
        self.recording, self.cell, self.robot, self.masses, self.kept = recording, cell, robot, masses, kept
        known = correction_of(cell.kinematics)
        self.angles = recording.q if known is None else known.true_angles(recording.q)
        self.position = recording.position
        self.rotation = None if recording.quaternion is None else quaternion_matrix(recording.quaternion)
        self.D = 3 if self.rotation is None else 6
        self.free = recording.registration == "fit"
        state = robot.state(self.angles, cell.tool.T_flange_tcp)
        self.wrench = _in_base(recording, robot, cell.tool.T_flange_tcp, self.angles, state)
        self.middle = state.T_base_tool[:, :3, 3].mean(axis=0)
        nominal = None if cell.stiffness is None else 1.0 / cell.stiffness.joints
        self.nominal = np.full(6, SOFT) if nominal is None else nominal
        # weight alone turns a joint by what its angles fix, as frames and waves do: a fit of these bends any spring
        self.weight_alone = cell.stiffness is not None and float(np.abs(self.wrench).max()) == 0.0

    def unseen(self, frame: _Frame) -> frozenset[int]:
        """Joints, from 1, whose springs nothing but weight bends, by less than tells them from the frames.

        What weight does to a joint follows from the joints' angles, as what a frame elsewhere does. A spring of which
        the frames of all joints leave next to nothing is free to be rubber, or to push back, for the sake of gears'
        waves; it stays the cell's.
        """
        if not self.weight_alone:
            return frozenset()
        state, p, R = self.predict(frame)
        columns, unknowns = self.columns(state, p)
        readings = self.readings(state, frame, frame.compliance)
        rest = columns[:, :, [u.spring is None for u in unknowns]]
        frames = [laws_geometry.twists(readings, where) for where in JOINTS]
        Q = spanned(np.concatenate([rest, *frames], axis=2))
        least = SEEN * _spread(self.residual(frame, p, R)[:, :3])
        bend = state.J[:, : self.D] * (self.nominal * self.torque(state))[:, None, :]
        shown = [left(bend[:, :, j : j + 1], Q) * float(np.sqrt(np.mean(bend[:, :3, j] ** 2))) for j in range(6)]
        return frozenset(j + 1 for j in range(6) if shown[j] < least)

    def torque(self, state: ArmState) -> Array:
        """(N, 6) N·m of load and weight."""
        tau = np.einsum("nci,nc->ni", state.J, self.wrench)
        return np.asarray(tau if self.masses is None else tau + gravity_torque(self.robot, self.masses, state)[0])

    def predict(self, frame: _Frame) -> tuple[ArmState, Array, Array]:
        """State at the loaded equilibrium, TCP (N, 3) and its rotation (N, 3, 3) in base_link."""
        T = self.cell.tool.T_flange_tcp.copy()
        T[:3, 3] += frame.target
        theta = self.angles
        for _ in range(SETTLED):
            state = self.robot.state(theta, T, bodies=True)
            theta = self.angles + frame.compliance * self.torque(state)
        state = self.robot.state(theta, T, bodies=True)
        return state, state.T_base_tool[:, :3, 3], state.T_base_tool[:, :3, :3]

    def residual(self, frame: _Frame, p: Array, R: Array) -> Array:
        """(N, D) measured, brought to base_link, less predicted; m and rotation vectors in base axes."""
        Q = rotation_from_vector(frame.turn)
        seen = self.middle + (self.position - frame.shift - self.middle) @ Q  # Qᵀ from the left
        if self.rotation is None:
            return np.asarray(seen - p)
        return np.concatenate([seen - p, rotation_vector(Q.T @ self.rotation @ np.swapaxes(R, -1, -2))], axis=1)

    def columns(self, state: ArmState, p: Array) -> tuple[Array, list[Unknown]]:
        """(N, D, P) of the base."""
        parts, unknowns = [], []
        bend = state.J * self.torque(state)[:, None, :]
        for j in range(6):
            if (
                j + 1 not in self.kept
                and np.sqrt(np.mean(bend[:, :3, j] ** 2)) * self.nominal[j] > calibrated.RESTING.least_bend
            ):
                parts.append(bend[:, : self.D, j : j + 1])
                known = calibrated.RESTING.rubber * self.nominal[j] if self.cell.stiffness is not None else None
                where, key = f"joint:{j + 1}", joint_spring(j + 1)
                built = (
                    (STIFFEST * self.nominal[j], calibrated.RESTING.rubber * self.nominal[j])
                    if self.weight_alone
                    else None
                )
                unknowns.append(Unknown(f"joint {j + 1}", "rad/(N·m)", 0.0, where, known, key, built))
        if self.free:
            frame = np.zeros((len(p), 6, 6))
            frame[:, :, :] = np.eye(6)
            frame[:, :3, 3:] = -skew(p - self.middle)
            parts.append(frame[:, : self.D])
            unknowns += [Unknown(f"registration {a}", "m", location="registration") for a in "xyz"]
            unknowns += [Unknown(f"registration turn {a}", "rad", location="registration") for a in "xyz"]
            target = np.zeros((len(p), self.D, 3))
            flange = state.T_base_tool[:, :3, :3] @ self.cell.tool.T_flange_tcp[:3, :3].T
            target[:, :3] = flange
            parts.append(target)
            unknowns += [Unknown(f"target {a}", "m", location="tool") for a in "xyz"]
        return np.concatenate(parts, axis=2) if parts else np.zeros((len(p), self.D, 0)), unknowns

    def first_fit(self) -> _Frame:
        """Compliances, tracker frame and target by Gauss–Newton with Huber weights; where the rest starts from."""
        frame = _Frame(np.zeros(3), np.zeros(3), np.zeros(3), self.nominal.copy())
        for _ in range(STEPS):
            state, p, R = self.predict(frame)
            r = self.residual(frame, p, R)
            B, unknowns = self.columns(state, p)
            now = np.array([self._value(frame, u) for u in unknowns])
            x = self._robust(r + B @ now, B, unknowns)
            frame = self._moved(frame, unknowns, x)
        return frame

    def _value(self, frame: _Frame, u: Unknown) -> float:
        """Compliances are fitted as totals, so that they stay above zero; the frame and the target as steps."""
        return 0.0 if u.spring is None else float(frame.compliance[u.spring - 1])

    def _robust(self, y: Array, B: Array, unknowns: Sequence[Unknown]) -> Array:
        scale = np.array([1.0] * 3 + [LEVER] * 3)[: self.D]
        A, b = (B * scale[:, None]).reshape(y.size, B.shape[2]), (y * scale).reshape(-1)
        size = np.array([self.nominal[int(u.location[6:]) - 1] if u.lower == 0.0 else 1.0 for u in unknowns])
        lean = np.where([u.lower == 0.0 for u in unknowns], 1.0 / PRIOR, 0.0)
        lower = np.array([u.lower for u in unknowns])
        weight, x = np.ones(len(y)), np.zeros(len(unknowns))
        for _ in range(8):
            rows = np.repeat(weight, self.D)
            spread = _spread((b - A @ x).reshape(-1, self.D)) if x.any() else _spread(y)
            M = np.concatenate([A * size * rows[:, None] / spread, np.diag(lean)])
            whole = np.column_stack([M, np.concatenate([b * rows / spread, lean])])
            small = np.asarray(np.linalg.qr(whole, mode="r"))  # the same least squares in a few rows
            x = size * lsq_linear(small[:, :-1], small[:, -1], (lower / size, np.inf)).x
            error = np.linalg.norm((b - A @ x).reshape(-1, self.D), axis=1)
            limit = calibrated.RESTING.heavy * _spread((b - A @ x).reshape(-1, self.D)) * np.sqrt(self.D)
            weight = np.sqrt(np.minimum(1.0, limit / np.maximum(error, 1e-12)))
        return x

    def _moved(self, frame: _Frame, unknowns: Sequence[Unknown], x: Array) -> _Frame:
        step = dict(zip((u.name for u in unknowns), x, strict=True))
        compliance = frame.compliance.copy()
        for u, value in zip(unknowns, x, strict=True):
            if u.spring is not None:
                compliance[u.spring - 1] = value
        shift, turn, target = (
            np.array([step.get(f"{name}{a}", 0.0) for a in "xyz"])
            for name in ("registration ", "registration turn ", "target ")
        )
        Q = rotation_from_vector(frame.turn)
        return _Frame(
            frame.shift + Q @ shift, rotation_vector(Q @ rotation_from_vector(turn)), frame.target + target, compliance
        )

    def readings(self, state: ArmState, frame: _Frame, springs: Array) -> Readings:
        """For the laws: bodies and Jacobian where the loaded arm stands, joints as the encoders say.

        Weights that nobody stated make springs soft in a fit that does not know of them, and what they do would then be
        looked for through springs that are soft because of them. So none counts as far from the cell's.
        """
        near = calibrated.RESTING.near_cell if self.cell.stiffness is not None else 1.0 / calibrated.RESTING.rigid
        _, session = np.unique(self.recording.session, return_inverse=True)
        none = np.zeros(len(self.angles), np.int64)
        T = self.cell.tool.T_flange_tcp.copy()
        T[:3, 3] += frame.target
        return Readings(
            self.recording,
            self.robot,
            T,
            self.masses,
            replace(state, q=self.recording.q),
            self.wrench,
            self.D,
            False,
            np.clip(springs, self.nominal / near, np.inf if self.cell.stiffness is None else near * self.nominal),
            session.reshape(-1).astype(np.int64),
            none,
            none,
        )

    def notes(self, frame: _Frame) -> tuple[str, ...]:
        out = []
        if self.free:
            shift, turn, target = (
                ", ".join(f"{1e3 * v:.3f}" for v in a) for a in (frame.shift, frame.turn, frame.target)
            )
            out.append(
                f"a first robust fit moved the tracker frame by ({shift}) mm and ({turn}) mrad about the middle of the "
                f"points and the target by ({target}) mm in the flange; both are refitted with every explanation"
            )
        if self.masses is None:
            out.append("the URDF has no masses, so the deflection under weight is not modelled")
        if self.cell.kinematics is not None:
            out.append("the cell's kinematic corrections are counted; what is found comes on top of them")
        return tuple(out)


def _spread(r: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(r - np.median(r, axis=0)))), 1e-9)


def _in_base(recording: Recording, robot: Robot, T_flange_tcp: Array, q: Array, state: ArmState) -> Array:
    """(N, 6) recorded wrench at the TCP in base axes; zero where none is recorded."""
    if recording.wrench is None:
        return np.zeros((len(q), 6))
    wrench = recording.wrench.copy()
    R, p = state.T_base_tool[:, :3, :3], state.T_base_tool[:, :3, 3]
    if recording.wrench_frame == "tool":
        wrench = np.concatenate([np.einsum("nij,nj->ni", R, wrench[:, a : a + 3]) for a in (0, 3)], axis=1)
    if recording.wrench_point is not None:
        flange = robot.fk(q)
        at = flange[:, :3, 3] + np.einsum("nij,j->ni", flange[:, :3, :3], recording.wrench_point)
        wrench[:, 3:] += np.cross(at - p, wrench[:, :3])
    return wrench


def _labels(recording: Recording, wrench: Array) -> tuple[Ints, Ints]:
    """Arrival of each reading (pose × cycle × session), and which readings repeat each other: same pose, same load."""
    key = np.stack([recording.session, recording.pose, recording.cycle], axis=1)
    visit = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    size = np.array([max(float(np.abs(wrench[:, a : a + 3]).max()), 1e-9) for a in (0, 3)])
    w = wrench / loads.same(size, calibrated.RESTING.same_load, recording.uncertainty)
    if np.abs(wrench).max() == 0.0:
        w = np.zeros_like(wrench)
    replicate = np.full(len(recording), -1, np.int64)
    n = 0
    for pose in np.unique(recording.pose):
        rows = np.flatnonzero(recording.pose == pose)
        while len(rows):
            near = np.abs(w[rows] - w[rows[0]]).max(axis=1) < 1.0
            if near.sum() > 1:
                replicate[rows[near]] = n
                n += 1
            rows = rows[~near]
    return visit, replicate

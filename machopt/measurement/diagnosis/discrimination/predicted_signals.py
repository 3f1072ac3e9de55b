"""Predicted readings of each law of a diagnosis at poses and loads that were not measured yet.

Deflection: a load test is a cycle up to the full load and back, with a reading after each step if a law depends on
the load history; otherwise one reading at full load. Position: the arm at rest, with or without load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.effects import registry
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.reading_noise import HOLD, ReadingNoise
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.discrimination.open_hypotheses import NO_EFFECT, CandidateLaw, OpenDiagnosis
from machopt.measurement.diagnosis.effect_columns import user_hypotheses
from machopt.measurement.diagnosis.static import load_test_channel, measured_pose_channel
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_to_quaternion

Ints = NDArray[np.int64]

UP_AND_DOWN = (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)
CYCLE_GAP = 1e4  # s between cycles: their order is not known yet, so each starts from a relaxed arm
PARAMETER_TOLERANCE = 1e-3  # relative tolerance between the parameters of a law here and in the diagnosis
EQUILIBRIUM_STEPS = 3  # fixed-point iterations for the equilibrium under weight
SHAPES = 2  # additional shapes of a refitted rival during the selection of readings
FORMS = 8  # shapes of each law that a finished design is checked against


@dataclass(frozen=True)
class PredictedCases:
    """N load cases of K steps each, with D coordinates per step."""

    steps: tuple[float, ...]  # share of the full load at each reading of a cycle
    dimensions: int
    base: Array  # (N, K·D, P) base columns, always refitted
    hypotheses: tuple[EffectHypothesis, ...]
    count: int

    def columns(self, h: EffectHypothesis, shape: tuple[float, ...]) -> Array:
        """Return the columns of a law at the cases.

        Args:
            h: Hypothesis.
            shape: Its shape.

        Returns:
            (N, K·D, p).
        """
        return _reshape_by_case(h.columns(shape), self.count)


@dataclass(frozen=True)
class PredictedLaw:
    """Law of the diagnosis at the poses of the plan."""

    candidate_law: CandidateLaw
    signal: Array  # (N, K·D) m, rad, predicted with the fitted coefficients
    columns: tuple[Array, ...]  # (N, K·D, p) columns for refitting, at its shape and at others


def select_load_steps(candidate_laws: Sequence[CandidateLaw]) -> tuple[float, ...]:
    """Select the load steps that a set of laws requires.

    Args:
        candidate_laws: Candidate laws.

    Returns:
        Steps as shares of the full load.
    """
    curved = {
        e.file_word
        for e in registry.select_joint_torque_effects()
        if e.has_memory or any(law.includes_weight for law in e.joint_laws)
    }
    return UP_AND_DOWN if any(s.effect in curved for s in candidate_laws) else (1.0,)


@dataclass(frozen=True, kw_only=True)
class DiagnosedArm:
    """An arm whose diagnosis is open, with the models that predict its readings."""

    found: OpenDiagnosis
    cell: Cell
    robot: Robot
    masses: RobotMasses | None  # of links and tool; None if unknown
    compliance: Array  # (6,) rad/(N·m), joint compliance of the diagnosis


def predict_load_tests(
    arm: DiagnosedArm, cases: LoadCases, q: Array, steps: tuple[float, ...], dimensions: int
) -> PredictedCases:
    """Build the cases of load tests.

    Args:
        arm: Arm with its open diagnosis.
        cases: N combinations of pose and load.
        q: (N, 6) joint angles of each case, rad.
        steps: Load steps of a cycle.
        dimensions: 3 (positions) or 6 (poses).

    Returns:
        The cases with base columns and hypotheses.
    """
    N = len(cases)
    readings = _build_readings(arm, _build_cycles(arm.found, cases, q, steps, dimensions))
    laws = [
        *load_test_channel.build_load_test_catalogue(readings, None).hypotheses,
        *user_hypotheses.build_user_hypotheses(user_hypotheses.load_hypothesis_sources(), readings),
    ]
    J = readings.state.J[:, :dimensions]
    base = J * readings.load_torque[:, None, :]
    return PredictedCases(steps, dimensions, _reshape_by_case(base, N), tuple(laws), N)


def _build_cycles(
    open_diagnosis: OpenDiagnosis, cases: LoadCases, q: Array, steps: tuple[float, ...], dimensions: int
) -> Recording:
    """Return a recording of one cycle per case without displacements; each starts from a relaxed arm."""
    N, K = len(cases), len(steps)
    factor = np.tile(np.array(steps), N)
    case = np.repeat(np.arange(N), K)
    branch = np.tile(np.where(np.arange(K) <= int(np.argmax(steps)), 1, -1), N).astype(np.int8)
    return Recording(
        kind="deflection",
        source="plan",
        q=np.repeat(q, K, axis=0),
        pose=case,
        cycle=case,
        session=np.zeros(N * K, np.int64),
        line=np.arange(1, N * K + 1),
        wrench=np.repeat(cases.wrench, K, axis=0) * factor[:, None],
        displacement=np.zeros((N * K, dimensions)),
        time=case * CYCLE_GAP + HOLD * np.tile(np.arange(1, K + 1), N),
        branch=branch,
        wrench_frame="tool" if open_diagnosis.wrench_frame == "tool" else "base",
        displacement_frame="tool" if open_diagnosis.displacement_frame == "tool" else "base",
    )


def _build_readings(arm: DiagnosedArm, recording: Recording) -> StaticReadings:
    """Return the readings of load tests; every cycle is a visit of its own."""
    assert recording.wrench is not None
    assert recording.displacement is not None
    T = arm.cell.tool.T_flange_tcp
    return StaticReadings(
        recording=recording,
        robot=arm.robot,
        T_flange_tcp=T,
        masses=arm.masses,
        state=arm.robot.compute_state(recording.q, T, bodies=True),
        wrench=recording.wrench,
        dimensions=recording.displacement.shape[1],
        is_difference=True,
        compliance=arm.compliance,
        session=recording.session,
        visit=recording.cycle,
        cycle=recording.cycle,
    )


def predict_measured_poses(
    arm: DiagnosedArm, cases: LoadCases, q: Array, dimensions: int, rng: np.random.Generator
) -> PredictedCases:
    """Build the cases of measured poses, with the load of each case or without load.

    Args:
        arm: Arm with its open diagnosis.
        cases: N combinations of pose and load.
        q: (N, 6) joint angles of each case, rad.
        dimensions: 3 (positions) or 6 (poses).
        rng: Random generator of the channel set-up.

    Returns:
        The cases with base columns and hypotheses.
    """
    T, robot, masses = arm.cell.tool.T_flange_tcp, arm.robot, arm.masses
    theta = q
    for _ in range(EQUILIBRIUM_STEPS):
        state = robot.compute_state(theta, T)
        tau = np.einsum("nci,nc->ni", state.J, cases.wrench)
        if masses is not None:
            tau = tau + compute_weight_torque(robot, masses, robot.compute_state(theta, T, bodies=True))
        theta = q + arm.compliance * tau
    pose = robot.compute_fk(theta, T)
    N = len(cases)
    recording = Recording(
        kind="absolute",
        source="plan",
        q=q,
        pose=cases.pose,
        cycle=np.arange(N),
        session=np.zeros(N, np.int64),
        line=np.arange(1, N + 1),
        wrench=cases.wrench,
        position=pose[:, :3, 3],
        quaternion=convert_to_quaternion(pose[:, :3, :3]) if dimensions == 6 else None,
        registration="fit" if arm.found.registration == "fit" else "fixed",
    )
    problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(recording, arm.cell, robot, masses, rng)
    return PredictedCases((1.0,), dimensions, _reshape_by_case(problem.base, N), catalogue.hypotheses, N)


def predict_law(candidate_law: CandidateLaw, at: PredictedCases, coordinates: float) -> PredictedLaw | None:
    """Predict a law at the poses of the plan.

    Args:
        candidate_law: Candidate law of the diagnosis.
        at: The cases.
        coordinates: Share of the rows of a reading that are translations.

    Returns:
        The law; None if the catalogue of these cases does not contain it.
    """
    if candidate_law is NO_EFFECT:
        return PredictedLaw(candidate_law, np.zeros(at.base.shape[:2]), (np.zeros((*at.base.shape[:2], 0)),))
    if candidate_law.rms is not None:
        h = next((h for h in at.hypotheses if h.location == candidate_law.location), None)
    else:
        h = next((h for h in at.hypotheses if h.name == candidate_law.name and candidate_law.law in ("", h.law)), None)
    if h is None:
        return None
    if candidate_law.coefficients:
        x, shape = np.array(candidate_law.coefficients), candidate_law.shape
        if not _has_same_meaning(h, x, shape, candidate_law.correction):
            return None
        columns = at.columns(h, shape)
    else:
        shape = h.shapes[len(h.shapes) // 2]
        columns = at.columns(h, shape)
        sized = _scale_coefficients(h, candidate_law, shape, columns, coordinates)
        if sized is None:
            return None
        x = sized
    others = [s for s in _select_inner_shapes(h.shapes) if s != shape]
    return PredictedLaw(candidate_law, columns @ x, (columns, *(at.columns(h, s) for s in others)))


def list_law_columns(candidate_law: CandidateLaw, at: PredictedCases) -> tuple[Array, ...]:
    """List the columns of every law of an effect at its place, over its shape grid, as diagnose refits a rival.

    Args:
        candidate_law: Candidate law.
        at: The cases.

    Returns:
        Columns (N, K·D, p) for each law and shape.
    """
    laws = [h for h in at.hypotheses if h.name == candidate_law.name]
    return tuple(at.columns(h, s) for h in laws for s in _select_spread_shapes(h.shapes, FORMS))


def compute_case_noise(cases: LoadCases, noise: ReadingNoise, steps: tuple[float, ...]) -> tuple[Array, Array]:
    """Compute the noise covariances of the cases.

    The steps of a cycle share the cycle error and the load error. Each step has its own instrument error.

    Args:
        cases: N load cases.
        noise: Noise of a reading.
        steps: Load steps of a cycle.

    Returns:
        (N, K·D, K·D) covariance of each case, and (K·D, K·D) covariance shared by the readings of a pose.
    """
    D, K, n = noise.dimensions, len(steps), noise.cycles
    rows = np.ones(D) if noise.targets is None else np.repeat([1.0, 1.0 / noise.targets], 3)
    instrument = noise.covariance(np.zeros((1, D)))[0] - np.diag(noise.cycle**2 / n * rows**2)
    cycle = np.diag(noise.cycle**2 / n * rows**2)
    moved = (np.array(steps)[None, :, None] * cases.twist[:, None, :D]).reshape(len(cases), K * D)
    own = np.kron(np.eye(K), instrument) + np.kron(np.ones((K, K)), cycle)
    gain = noise.force**2 * moved[:, :, None] * moved[:, None, :]
    return own + gain, np.asarray(np.kron(np.ones((K, K)), noise.shared()))


def _scale_coefficients(
    h: EffectHypothesis, stand: CandidateLaw, shape: tuple[float, ...], columns: Array, share: float
) -> Array | None:
    """Return coefficients of a law of which only the size or the resulting motion is known; all columns equally
    weighted.
    """
    each = np.sqrt(np.mean(columns**2, axis=(0, 1)))
    if not np.all(each > 0.0):
        return None
    x = np.asarray(1.0 / each)
    if stand.rms is not None:
        made = float(np.sqrt(np.mean((columns @ x) ** 2) / share))
        return np.asarray(x * stand.rms / made)
    unit = abs(next(iter(h.quantities(x, shape).values())).value)
    if stand.size is None or not (np.isfinite(unit) and unit > 0.0):
        return None
    return np.asarray(x * stand.size / unit)


def _select_inner_shapes(shapes: tuple[tuple[float, ...], ...]) -> list[tuple[float, ...]]:
    """Return some shapes spread over the grid without its ends."""
    if len(shapes) <= SHAPES:
        return list(shapes)
    return [shapes[int(k)] for k in np.linspace(0, len(shapes) - 1, SHAPES + 2)[1:-1]]


def _select_spread_shapes(shapes: tuple[tuple[float, ...], ...], most: int) -> list[tuple[float, ...]]:
    """Return shapes spread over the grid, including its ends."""
    return [shapes[int(k)] for k in np.unique(np.linspace(0, len(shapes) - 1, min(most, len(shapes))).round())]


def _has_same_meaning(
    h: EffectHypothesis, x: Array, shape: tuple[float, ...], stated: Mapping[str, Any] | None
) -> bool:
    """Return whether coefficients and shape state the same parameters here as in the diagnosis.

    Laws of the registry have absolute parameters. User-defined laws may be relative to the recording that they were
    fitted to.
    """
    made = h.correction(x, shape)
    if stated is None or made is None:
        return True
    here, wanted = _flatten_parameters(made.parameters), _flatten_parameters(stated)
    return len(here) == len(wanted) and bool(np.allclose(here, wanted, rtol=PARAMETER_TOLERANCE, atol=0.0))


def _flatten_parameters(value: Any) -> Array:
    """Return all numbers of nested parameters, keys in order."""
    if isinstance(value, Mapping):
        parts = [_flatten_parameters(value[k]) for k in sorted(value)]
    elif isinstance(value, list | tuple):
        parts = [_flatten_parameters(v) for v in value]
    elif isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return np.array([float(value)])
    else:
        return np.zeros(0)
    return np.concatenate(parts) if parts else np.zeros(0)


def _reshape_by_case(columns: Array, count: int) -> Array:
    """Reshape (N K, D, p) to (N, K·D, p)."""
    return columns.reshape(count, -1, columns.shape[2])

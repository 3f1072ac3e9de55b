"""What each law of a diagnosis would show at poses and under loads that nobody has measured yet.

Deflection: a load test is a cycle, up to the full load and back, with a reading after each step where a law asks how
the load came there; one reading at full load where none does. Position: the arm stands still, with or without a load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
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
CYCLE_GAP = 1e4  # s between cycles: in which order they come is not known yet, so none feels the one before
PARAMETER_TOLERANCE = 1e-3  # relative, of the parameters of a law here and where it was fitted
EQUILIBRIUM_STEPS = 3  # fixed-point steps to the arm's place under weight
SHAPES = 2  # further shapes that a refitted rival may take while readings are chosen
FORMS = 8  # shapes of each of its laws that a finished design is held against


@dataclass(frozen=True)
class PredictedCases:
    """N cases of K steps each, D coordinates a step."""

    steps: tuple[float, ...]  # share of the full load at each reading of a cycle
    dimensions: int
    base: Array  # (N, K·D, P) refitted whatever is true
    hypotheses: tuple[EffectHypothesis, ...]
    count: int

    def columns(self, h: EffectHypothesis, shape: tuple[float, ...]) -> Array:
        """(N, K·D, p) of a law."""
        return _reshape_by_case(h.columns(shape), self.count)


@dataclass(frozen=True)
class PredictedLaw:
    """A law of the diagnosis at the poses of the plan."""

    candidate_law: CandidateLaw
    signal: Array  # (N, K·D) m, rad that it adds as fitted
    columns: tuple[Array, ...]  # (N, K·D, p) that it may refit, at its shape and at others


def select_load_steps(stands: Sequence[CandidateLaw]) -> tuple[float, ...]:
    """The readings of a load cycle that these laws ask for."""
    curved = {
        e.file_word
        for e in registry.select_joint_torque_effects()
        if e.has_memory or any(law.includes_weight for law in e.joint_laws)
    }
    return UP_AND_DOWN if any(s.effect in curved for s in stands) else (1.0,)


def predict_load_tests(
    found: OpenDiagnosis,
    cases: LoadCases,
    q: Array,
    robot: Robot,
    T_flange_tcp: Array,
    masses: RobotMasses | None,
    compliance: Array,
    steps: tuple[float, ...],
    dimensions: int,
) -> PredictedCases:
    """Cases of a load test.

    Args:
        found: the diagnosis.
        cases: N poses × loads.
        q: (N, 6) rad of each case.
        robot, T_flange_tcp, masses: the arm.
        compliance: (6,) rad/(N·m) as the diagnosis has it.
        steps: of a cycle.
        dimensions: 3 or 6.
    """
    N, K = len(cases), len(steps)
    factor = np.tile(np.array(steps), N)
    wrench = np.repeat(cases.wrench, K, axis=0) * factor[:, None]
    case = np.repeat(np.arange(N), K)
    branch = np.tile(np.where(np.arange(K) <= int(np.argmax(steps)), 1, -1), N).astype(np.int8)
    time = case * CYCLE_GAP + HOLD * np.tile(np.arange(1, K + 1), N)
    recording = Recording(
        kind="deflection",
        source="plan",
        q=np.repeat(q, K, axis=0),
        pose=case,
        cycle=case,
        session=np.zeros(N * K, np.int64),
        line=np.arange(1, N * K + 1),
        wrench=wrench,
        displacement=np.zeros((N * K, dimensions)),
        time=time,
        branch=branch,
        wrench_frame="tool" if found.wrench_frame == "tool" else "base",
        displacement_frame="tool" if found.displacement_frame == "tool" else "base",
    )
    readings = StaticReadings(
        recording=recording,
        robot=robot,
        T_flange_tcp=T_flange_tcp,
        masses=masses,
        state=robot.compute_state(recording.q, T_flange_tcp, bodies=True),
        wrench=wrench,
        dimensions=dimensions,
        is_difference=True,
        compliance=compliance,
        session=np.zeros(N * K, np.int64),
        visit=case,
        cycle=case,
    )
    laws = [
        *load_test_channel.build_load_test_catalogue(readings, None).hypotheses,
        *user_hypotheses.build_user_hypotheses(user_hypotheses.load_hypothesis_sources(), readings),
    ]
    J = readings.state.J[:, :dimensions]
    base = J * readings.load_torque[:, None, :]
    return PredictedCases(steps, dimensions, _reshape_by_case(base, N), tuple(laws), N)


def predict_measured_poses(
    found: OpenDiagnosis,
    cases: LoadCases,
    q: Array,
    cell: Cell,
    robot: Robot,
    masses: RobotMasses | None,
    compliance: Array,
    dimensions: int,
    rng: np.random.Generator,
) -> PredictedCases:
    """Cases of measured poses, with the load of each case or none."""
    T, c = cell.tool.T_flange_tcp, compliance
    theta = q
    for _ in range(EQUILIBRIUM_STEPS):
        state = robot.compute_state(theta, T)
        tau = np.einsum("nci,nc->ni", state.J, cases.wrench)
        if masses is not None:
            tau = tau + compute_gravity_torque(robot, masses, robot.compute_state(theta, T, bodies=True))[0]
        theta = q + c * tau
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
        registration="fit" if found.registration == "fit" else "fixed",
    )
    problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(recording, cell, robot, masses, rng)
    return PredictedCases((1.0,), dimensions, _reshape_by_case(problem.base, N), catalogue.hypotheses, N)


def predict_law(stand: CandidateLaw, at: PredictedCases, coordinates: float) -> PredictedLaw | None:
    """A law at the poses of the plan; None where the catalogue does not have it there.

    Args:
        stand: of the diagnosis.
        at: the cases.
        coordinates: rows of a reading that are translations, as a share.
    """
    if stand is NO_EFFECT:
        return PredictedLaw(stand, np.zeros(at.base.shape[:2]), (np.zeros((*at.base.shape[:2], 0)),))
    if stand.rms is not None:
        h = next((h for h in at.hypotheses if h.location == stand.location), None)
    else:
        h = next((h for h in at.hypotheses if h.name == stand.name and stand.law in ("", h.law)), None)
    if h is None:
        return None
    if stand.coefficients:
        x, shape = np.array(stand.coefficients), stand.shape
        if not _has_same_meaning(h, x, shape, stand.correction):
            return None
        columns = at.columns(h, shape)
    else:
        shape = h.shapes[len(h.shapes) // 2]
        columns = at.columns(h, shape)
        sized = _scale_coefficients(h, stand, shape, columns, coordinates)
        if sized is None:
            return None
        x = sized
    others = [s for s in _select_inner_shapes(h.shapes) if s != shape]
    return PredictedLaw(stand, columns @ x, (columns, *(at.columns(h, s) for s in others)))


def list_law_columns(stand: CandidateLaw, at: PredictedCases) -> tuple[Array, ...]:
    """(N, K·D, p) of every law of its effect at its place, as diagnose refits a rival, at shapes over the grid."""
    laws = [h for h in at.hypotheses if h.name == stand.name]
    return tuple(at.columns(h, s) for h in laws for s in _select_spread_shapes(h.shapes, FORMS))


def compute_case_noise(cases: LoadCases, noise: ReadingNoise, steps: tuple[float, ...]) -> tuple[Array, Array]:
    """(N, K·D, K·D) own error of each case, and (K·D, K·D) of what readings of a pose share.

    The steps of a cycle share the cycle's error and that of the load; each has the instrument's by itself.
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
    """Coefficients of a law of which only the size, or the motion it makes, is known; all columns alike."""
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
    """Some shapes spread over the grid, its ends left out."""
    if len(shapes) <= SHAPES:
        return list(shapes)
    return [shapes[int(k)] for k in np.linspace(0, len(shapes) - 1, SHAPES + 2)[1:-1]]


def _select_spread_shapes(shapes: tuple[tuple[float, ...], ...], most: int) -> list[tuple[float, ...]]:
    """Shapes spread over the grid, with its ends."""
    return [shapes[int(k)] for k in np.unique(np.linspace(0, len(shapes) - 1, min(most, len(shapes))).round())]


def _has_same_meaning(
    h: EffectHypothesis, x: Array, shape: tuple[float, ...], stated: Mapping[str, Any] | None
) -> bool:
    """Coefficients and shape state here what they stated where they were fitted.

    Those of the registry are absolute; a user's own may count in shares of what it was fitted to.
    """
    made = h.correction(x, shape)
    if stated is None or made is None:
        return True
    here, wanted = _flatten_parameters(made.parameters), _flatten_parameters(stated)
    return len(here) == len(wanted) and bool(np.allclose(here, wanted, rtol=PARAMETER_TOLERANCE, atol=0.0))


def _flatten_parameters(value: Any) -> Array:
    """Every number of nested parameters, keys in order."""
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
    """(N K, D, p) → (N, K·D, p)."""
    return columns.reshape(count, -1, columns.shape[2])

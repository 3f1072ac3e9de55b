"""Friction hypotheses beyond Coulomb and viscous friction, for each joint: competing laws of the motor torque.

The base has for each joint an offset, Coulomb friction c z and viscous friction d q̇. z is the direction of motion
after a short presliding displacement (:mod:`machopt.effects.joint.presliding_direction`). Coulomb
friction that differs with the direction equals an offset plus Coulomb friction. It cannot be separated from an
unmodelled load, so it stays in the base.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import minimize_scalar

from machopt.effects import parameter_conversion, registry
from machopt.effects.joint.presliding_direction import compute_presliding_direction
from machopt.effects.protocol import Effect, FrictionLaw, FrictionState, JointSpeedRange
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, LawCurve, Quantity, Shape
from machopt.measurement.diagnosis.effect_columns.motion_columns import (
    MotionModel,
    build_binned_curve,
    build_joint_law_hypothesis,
)
from machopt.numerics.array_types import Array

FrictionReversal = tuple[float, float]
# shape of friction reversal in the base: presliding displacement in rad (m), or speed in rad/s (m/s) of a tanh
REVERSAL_SHAPES = (
    (0.0, 0.0),
    (2e-5, 0.0),
    (5e-5, 0.0),
    (1e-4, 0.0),
    (2e-4, 0.0),
    (5e-4, 0.0),
    (1e-3, 0.0),
    (0.0, 0.001),
    (0.0, 0.003),
    (0.0, 0.01),
    (0.0, 0.03),
    (0.0, 0.1),
    (0.0, 0.3),
)
STEPS = 10  # refinement steps between two of these
REVERSAL_WIDTH_FACTOR = 1.6  # factor by which the reversal width of the base may be wrong in either direction
SMOOTH, PATH = (0.0, 0.003), (5e-5, 0.0)  # representative shape of the respective other kind
IMMEDIATE_REVERSAL = REVERSAL_SHAPES[0]
WARMING_TIMES = (15.0, 60.0, 300.0)  # s


def compute_friction_direction(scene: MotionModel, joint: int, turn: FrictionReversal) -> Array:
    """Compute the direction of a joint's friction.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        turn: Reversal shape: presliding displacement in rad (m), and speed in rad/s (m/s) of a tanh; one of
            them is zero.

    Returns:
        (M,) −1 to 1.
    """
    return compute_reversal_signal(scene, scene.motion.v[:, joint], turn)


def build_reversal_uncertainty_columns(scene: MotionModel, joint: int, turn: FrictionReversal) -> list[Array]:
    """Build columns that absorb a small error of the reversal shape, in its width and in its kind.

    Without them the residual at a reversal would be mistaken for a friction peak at low speed.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        turn: Reversal shape: presliding displacement in rad (m), and speed in rad/s (m/s) of a tanh; one of
            them is zero.

    Returns:
        Columns (M,) that are present in several time blocks.
    """
    wider, narrower = (
        (REVERSAL_WIDTH_FACTOR * path, REVERSAL_WIDTH_FACTOR * speed)
        for path, speed in (turn, (t / REVERSAL_WIDTH_FACTOR**2 for t in turn))
    )
    z = compute_friction_direction(scene, joint, turn)
    off = [compute_friction_direction(scene, joint, PATH if turn[1] > 0.0 else SMOOTH) - z]
    if turn != REVERSAL_SHAPES[0]:
        off.insert(
            0, compute_friction_direction(scene, joint, wider) - compute_friction_direction(scene, joint, narrower)
        )
    return [x for x in off if _is_in_several_intervals(scene, x)]


def _is_in_several_intervals(scene: MotionModel, x: Array) -> bool:
    """Return whether a signal (M,) is present in more than one time block; a single reversal cannot be
    cross-validated.
    """
    m = scene.motion
    power = np.bincount(
        np.unique(m.group, return_inverse=True)[1], m.subtract_period_mean(m.average_blocks(x[:, None]))[:, 0] ** 2
    )
    return bool(power.sum() - power.max() > thresholds.SHARES.minority * power.sum())


def compute_reversal_signal(scene: MotionModel, v: Array, turn: FrictionReversal) -> Array:
    """Compute the friction direction of a speed, after a presliding displacement or as a tanh of the speed.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        v: (M,) speed, rad/s.
        turn: Reversal shape: presliding displacement in rad (m), and speed in rad/s (m/s) of a tanh; one of
            them is zero.

    Returns:
        (M,) −1 to 1.
    """
    path, speed = turn
    if speed > 0:
        return np.asarray(np.tanh(v / speed))
    return compute_presliding_direction(v, 1.0 / scene.motion.rate, scene.segment_start, path)


def fit_breakaway(scene: MotionModel, joint: int, y: Array, other_columns: Array) -> FrictionReversal:
    """Fit the reversal shape of a joint's friction, together with Coulomb and viscous friction and inertia.

    A slightly wrong reversal shape leaves a residual that resembles a friction peak at low speed. The best of
    :data:`REVERSAL_SHAPES` is therefore refined between its neighbours.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        y: (N,) torque of the joint, N·m.
        other_columns: (N, p) further columns that the torque may contain.

    Returns:
        The reversal shape.
    """
    power = _build_residual_function(scene, joint, y, other_columns)
    best, found = np.inf, REVERSAL_SHAPES[0]
    for turn in REVERSAL_SHAPES:
        left = power(turn)
        if len(y) * np.log(max(best, 1e-300) / max(left, 1e-300)) > thresholds.LEVELS.gain_two_sigma:
            best, found = left, turn
    return min((found, *_refine_breakaway(found, power)), key=power)


def _build_residual_function(
    scene: MotionModel, joint: int, y: Array, other_columns: Array
) -> Callable[[FrictionReversal], float]:
    """Return a function that computes the residual sum of squares for a reversal shape, all other columns refitted."""
    m = scene.motion
    own = m.subtract_period_mean(m.average_blocks(np.stack([np.ones(len(m.q)), m.v[:, joint], m.a[:, joint]], axis=1)))
    rest = np.concatenate([own, other_columns], axis=1)

    def power(turn: FrictionReversal) -> float:
        z = m.subtract_period_mean(m.average_blocks(compute_friction_direction(scene, joint, turn)[:, None]))
        return float(np.sum(fit_least_squares(y, np.concatenate([rest, z], axis=1))[0] ** 2))

    return power


def describe_gradual_reversal(
    scene: MotionModel, joint: int, turn: FrictionReversal, y: Array, other_columns: Array
) -> str:
    """Describe friction that reverses gradually, if the data exclude an immediate reversal as of Coulomb friction.

    The distance between two samples at a reversal limits what can be resolved.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        turn: Reversal shape: presliding displacement in rad (m), and speed in rad/s (m/s) of a tanh; one of
            them is zero.
        y: (N,) torque of the joint, N·m.
        other_columns: (N, p) further columns that the torque may contain.

    Returns:
        Text; empty if an immediate reversal is possible.
    """
    path, speed = turn
    between = float(np.sqrt(np.mean(scene.motion.a[:, joint] ** 2))) / scene.motion.rate  # rad/s (m/s)
    if speed <= between and 2.0 * path <= between / scene.motion.rate:
        return ""
    power = _build_residual_function(scene, joint, y, other_columns)
    if len(y) * np.log(power(IMMEDIATE_REVERSAL) / max(power(turn), 1e-300)) < thresholds.LEVELS.min_gain:
        return ""
    if scene.prismatic[joint]:
        over = f"{1e3 * speed:.2g} mm/s" if speed > 0.0 else f"a path of {1e3 * path:.2g} mm"
    else:
        over = f"{np.degrees(speed):.2g} deg/s" if speed > 0.0 else f"a path of {1e3 * path:.2g} mrad"
    return f"friction that turns over gradually, over {over},"


def _refine_breakaway(
    turn: FrictionReversal, power: Callable[[FrictionReversal], float]
) -> tuple[FrictionReversal, ...]:
    """Return refined shapes near one of :data:`REVERSAL_SHAPES`; none for immediate reversal."""
    kind = 0 if turn[0] > 0.0 else 1
    if turn[kind] == 0.0:
        return ()
    grid = sorted(t[kind] for t in REVERSAL_SHAPES if t[kind] > 0.0)
    n = grid.index(turn[kind])
    least, most = grid[n - 1] if n else grid[n] / 4.0, grid[n + 1] if n + 1 < len(grid) else 3.0 * grid[n]
    ends = np.log([least, most])

    def made(log: float) -> FrictionReversal:
        size = float(np.exp(log))
        return (size, 0.0) if kind == 0 else (0.0, size)

    found = minimize_scalar(lambda x: power(made(x)), bounds=ends, method="bounded", options={"maxiter": STEPS})
    return (made(float(found.x)),)


def fit_least_squares(y: Array, X: Array) -> tuple[Array, Array]:
    """Solve a linear least-squares problem with column scaling.

    Args:
        y: (N,) target.
        X: (N, p) columns.

    Returns:
        Residual (N,) and coefficients (p,).
    """
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    x = np.linalg.lstsq(X / size, y, rcond=1e-10)[0] / size
    return y - X @ x, x


def list_warming_shapes(scene: MotionModel) -> tuple[Shape, ...]:
    """List the shapes of joint warm-up that the recording can show.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        (0,) for the recorded temperature, or time constants (T,) in s of a rise from the start of each session.
    """
    T = scene.recording.temperature
    if T is not None and np.ptp(T) > 1.0:
        return ((0.0,),)
    lasting = float(np.ptp(scene.motion.time))
    return tuple((t,) for t in WARMING_TIMES if t < lasting)


def compute_joint_warmth(scene: MotionModel, constant: float) -> Array:
    """Compute the warm-up state of the joints.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        constant: Time constant, s; zero uses the recorded temperature.

    Returns:
        (M,) 0 to 1.
    """
    m = scene.motion
    if constant == 0.0 and scene.recording.temperature is not None:
        T = scene.recording.temperature[m.index]
        return np.asarray((T - T.min()) / np.ptp(T))
    starts = np.flatnonzero(np.diff(m.session, prepend=-1))
    since = m.time - m.time[starts][m.session]
    return np.asarray(1.0 - np.exp(-since / constant))


def build_friction_hypotheses(scene: MotionModel, joint: int, turn: FrictionReversal) -> list[EffectHypothesis]:
    """Build the competing friction laws of one joint.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.
        joint: Joint index, 0-based.
        turn: Reversal shape: presliding displacement in rad (m), and speed in rad/s (m/s) of a tanh; one of
            them is zero.

    Returns:
        The hypotheses.
    """
    m = scene.motion
    if not scene.is_joint_moving(joint):
        return []
    v = m.v[:, joint]
    load = np.zeros_like(v) if scene.predicted is None else np.abs(scene.predicted[:, joint])
    heavy = max(float(np.quantile(load, 0.98)), 1e-9)
    loaded = scene.predicted is not None and bool(np.ptp(load) > thresholds.SHARES.small * heavy)
    pace = JointSpeedRange(float(np.quantile(np.abs(v), 0.98)), loaded, tuple(t for (t,) in list_warming_shapes(scene)))
    seen = FrictionState(
        speed=v,
        friction_direction=compute_friction_direction(scene, joint, turn),
        load=load,
        segment_start=scene.segment_start,
        time_step=1.0 / m.rate,
        warmth=lambda constant: compute_joint_warmth(scene, constant),
        is_prismatic=scene.prismatic[joint],
    )
    laws = ((e, law, law.grid(pace)) for e in registry.select_friction_effects() for law in e.friction_laws)
    return [
        _build_friction_hypothesis(scene, joint, e, law, seen, tuple(s[:1] for s in grid if s[1:] == rest), rest)
        for e, law, grid in laws
        for rest in dict.fromkeys(s[1:] for s in grid)
    ]


def _build_friction_hypothesis(
    scene: MotionModel,
    joint: int,
    effect: Effect,
    law: FrictionLaw,
    friction_state: FrictionState,
    grid: tuple[Shape, ...],
    shape: Shape,
) -> EffectHypothesis:
    """Return a law over its first shape parameter, which is refined between grid values; ``shape`` are the others."""
    unit = "N" if friction_state.is_prismatic else "N·m"

    def columns(s: Shape) -> Array:
        return law.columns(np.array(s + shape), friction_state)

    def sizes(x: Array, s: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(s + shape), friction_state)

    def line(x: Array, s: Shape) -> LawCurve:
        return build_binned_curve(
            scene,
            scene.motion.q[:, joint] if law.plots_over_angle else friction_state.speed,
            columns(s) @ x,
            f"speed of joint {joint + 1} in {'m' if friction_state.is_prismatic else 'rad'}/s",
            f"friction beyond Coulomb and viscous in {unit}",
        )

    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, len(law.coefficients)))
    return build_joint_law_hypothesis(
        scene,
        joint,
        effect.file_word,
        law.name,
        law.equation,
        columns,
        sizes,
        grid,
        lower=lower if np.isfinite(lower).any() else (),
        note=law.note,
        curve=line,
        family="friction",
    )

"""Channel of joint torques in motion: y = τ − RNEA(q, q̇, q̈) with the URDF's inertias and the cell's tool.

Always refitted for each joint: offset, Coulomb and viscous friction and motor inertia (no URDF states it). Also one
rotational inertia of the tool (no cell states it), and for currents without known torque constant a gain. Link masses
are those of the URDF within a tolerance (``link_scale``). Within it a scale of each is refitted, unless a payload is
the better explanation. If the data show clearly that several link masses are wrong, which no payload explains, this
is noted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.effect_locations import format_column_location, format_joint_location, format_link_location
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    CoordinateFamily,
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
    Ints,
    UntestableEffect,
)
from machopt.measurement.diagnosis.dynamic import drive_gain_and_coupling, unmodelled_torques
from machopt.measurement.diagnosis.dynamic.friction import (
    FrictionReversal,
    build_friction_hypotheses,
    build_reversal_uncertainty_columns,
    compute_friction_direction,
    describe_gradual_reversal,
    fit_breakaway,
    fit_least_squares,
)
from machopt.measurement.diagnosis.dynamic.link_mass_uncertainty import compute_coordinate_rms, estimate_link_mass_sigma
from machopt.measurement.diagnosis.dynamic.time_delays import build_channel_delay_hypotheses
from machopt.measurement.diagnosis.dynamic.torque_delay import DELAY_REVERSAL_SHAPES, estimate_torque_delay
from machopt.measurement.diagnosis.dynamic.torque_ripple_and_elastic_joints import (
    build_elastic_joint_hypotheses,
    build_ripple_hypotheses,
)
from machopt.measurement.diagnosis.effect_columns import gravity_compensator, payload
from machopt.measurement.diagnosis.effect_columns.motion_columns import MotionModel, build_joint_selector
from machopt.numerics.array_types import Array

# delayed friction and a long presliding displacement are similar at a single joint


def build_joint_torque_problem(scene: MotionModel) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
    """Build equations and catalogue of the torque channel.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        The problem and the hypotheses.

    Raises:
        InputError: The recording has no torque, or the URDF no inertias.
    """
    m, dynamics, rec = scene.motion, scene.dynamics, scene.recording
    if dynamics is None or scene.predicted is None or rec.torque is None:
        raise RecordingError(f"{rec.source}: the channel torque needs tau1_Nm … and a URDF with inertias")
    n = scene.joints
    measured = rec.torque[m.index, :n]
    needed = scene.predicted
    y = m.subtract_period_mean(m.average_blocks(measured - needed))
    P, T, L = dynamics.compute_regressors(m.q, m.v, m.a)
    # an unmodelled spring is out of phase with the rigid-body torque, too
    best, shared, rough = estimate_torque_delay(
        scene,
        measured,
        m.average_blocks(np.concatenate([P, gravity_compensator.compute_angle_only_torques(m.q)], axis=2)),
    )
    # a delay at a single joint imitates its friction and would smooth the reversals of all joints
    aligned = (
        m.subtract_period_mean(m.average_blocks(m.delay_cubic(measured, -best) - scene.predicted)) if shared else y
    )
    # torque of payload and link mass errors is not friction
    mass_columns = (
        m.subtract_period_mean(m.average_blocks(np.concatenate([P, L], axis=2)))
        if n > 1
        else np.zeros((len(aligned), n, 0))
    )
    paths = [
        fit_breakaway(scene, j, aligned[:, j], mass_columns[:, j])
        if scene.is_joint_moving(j)
        else DELAY_REVERSAL_SHAPES[0]
        for j in range(n)
    ]
    gradually = [
        describe_gradual_reversal(scene, j, paths[j], aligned[:, j], mass_columns[:, j])
        if scene.is_joint_moving(j)
        else ""
        for j in range(n)
    ]
    base, unknowns = _build_base_columns(scene, paths, gradually)
    if n > 1:
        scale = _equalise_noise(y, base, m.segment[m.starts][m.kept_blocks])
        scene = replace(scene, scale=scale, lift=build_joint_selector(m, n, scale=scale))
        y = y * scale
        base = base * scale[:, None]
        scene.notes.append(
            "torques are weighted by the noise of each joint: where only noise is left the error is the "
            "rms over joints in N·m; 1 N·m counts " + ", ".join(f"{s:.3g}" for s in scale) + " at joints 1 … " + str(n)
        )
    load = P
    P, T, L = (scene.average_coordinates(x) for x in (P, T, L))
    if np.abs(T).max() > 1e-9 and dynamics.tool_mass > 0:
        base = np.concatenate([base, T], axis=2)
        unknowns.append(
            BaseUnknown(
                name="tool inertia", unit="kg·m²", location="tool", description_if_unstated="inertia about its centre"
            )
        )
    if n > 1:
        balancer = [h.columns(h.shapes[0]) for h in gravity_compensator.build_torque_hypotheses(scene)[:1]]
        gains = (
            [] if scene.free_gains else [scene.column(j, needed[:, j]) for j in range(n) if scene.is_joint_moving(j)]
        )
        mass_sigma, mass_notes = estimate_link_mass_sigma(
            y, base, P, np.concatenate([P, *balancer, *gains], axis=2), L, m.group
        )
        scene.notes.extend(mass_notes)
        if mass_sigma > 0.0:
            base = np.concatenate([base, L], axis=2)
            unknowns += [
                BaseUnknown(
                    name=f"mass of link {b + 1}, relative",
                    unit="1",
                    location=format_link_location(b + 1),
                    prior=mass_sigma,
                )
                for b in dynamics.bodies
            ]
    problem = scene.problem(
        "torque",
        y,
        base,
        unknowns,
        CoordinateFamily(
            name="joint torque", columns=tuple(range(n)), unit="N" if all(scene.prismatic) else "N·m", factor=1.0
        ),
    )
    gain_error_torque = (
        {} if n == 1 or scene.free_gains else drive_gain_and_coupling.compute_gain_error_torque(scene, y, base, load, P)
    )
    return problem, _build_catalogue(scene, P, paths, best, rough, (aligned, mass_columns, gain_error_torque))


def _build_base_columns(
    scene: MotionModel, paths: list[FrictionReversal], gradually: Sequence[str] = ()
) -> tuple[Array, list[BaseUnknown]]:
    """Return base columns and unknowns; ``gradually`` describes joints whose friction reverses gradually."""
    m, n = scene.motion, scene.joints
    parts, unknowns = [], []
    for j in range(n):
        place, unit = format_joint_location(j + 1), "N" if scene.prismatic[j] else "N·m"
        speed, mass = ("N·s/m", "kg") if scene.prismatic[j] else ("N·m·s/rad", "kg·m²")
        signals = [np.ones(len(m.q))]
        unknowns.append(BaseUnknown(name=f"offset {j + 1}", unit=unit, location=place))
        if scene.is_joint_moving(j):
            signals += [compute_friction_direction(scene, j, paths[j]), m.v[:, j], m.a[:, j]]
            unknowns += [
                BaseUnknown(
                    name=f"Coulomb friction {j + 1}",
                    unit=unit,
                    location=place,
                    description_if_unstated=gradually[j] if gradually else "",
                ),
                BaseUnknown(name=f"viscous friction {j + 1}", unit=speed, location=place),
                BaseUnknown(
                    name=f"motor inertia {j + 1}", unit=mass, location=place, description_if_unstated="motor inertia"
                ),
            ]
            if scene.free_gains and scene.predicted is not None:
                signals.append(scene.predicted[:, j])
                unknowns.append(BaseUnknown(name=f"gain of current {j + 1} beyond the first", unit="1", location=place))
            more = build_reversal_uncertainty_columns(scene, j, paths[j])
            signals += more
            unknowns += [
                BaseUnknown(name=f"turn-over of friction {j + 1}, {k + 1}", unit=unit, location=place)
                for k in range(len(more))
            ]
        parts.append(scene.column(j, np.stack(signals, axis=1)))
    return np.concatenate(parts, axis=2), unknowns


def _equalise_noise(y: Array, base: Array, segment: Ints) -> Array:
    """Return factors (D,) that give all joint torques equal noise at constant overall rms; noise from neighbouring
    readings.
    """
    sigma = np.empty(y.shape[1])
    inside = np.diff(segment) == 0
    for j in range(y.shape[1]):
        step = np.diff(fit_least_squares(y[:, j], base[:, j])[0])[inside]
        sigma[j] = 1.4826 * float(np.median(np.abs(step - np.median(step)))) / np.sqrt(2.0)
    sigma = np.maximum(sigma, 1e-6 * max(float(sigma.max()), 1e-12))
    return np.asarray(np.sqrt(np.mean(sigma**2)) / sigma)


def _build_catalogue(
    scene: MotionModel,
    P: Array,
    paths: list[FrictionReversal],
    best: float,
    rough: Callable[[float], Array],
    drive: tuple[Array, Array, Mapping[int, Array]],
) -> HypothesisCatalogue:
    """Return the hypotheses.

    ``drive`` holds the inputs of
    :func:`machopt.measurement.diagnosis.dynamic.drive_gain_and_coupling.build_drive_hypotheses`.
    """
    n = scene.joints
    out: list[EffectHypothesis] = []
    assert scene.dynamics is not None  # checked by the caller
    inertia = scene.dynamics.compute_own_inertia(scene.motion.q)
    untestable: list[UntestableEffect] = []
    for j in range(n):
        if j in scene.joints_without_gain:
            untestable.append(
                UntestableEffect("joint_friction", format_joint_location(j + 1), "the torque of its current is unknown")
            )
            continue
        if scene.free_gains:
            untestable.append(
                UntestableEffect(
                    "units", format_column_location(f"tau{j + 1}_Nm"), "a gain of each current is refitted anyway"
                )
            )
        out += build_friction_hypotheses(scene, j, paths[j])
        out += build_ripple_hypotheses(scene, j)
        out += build_elastic_joint_hypotheses(scene, j, inertia)
    if n > 1:
        out += payload.build_motion_payload_hypotheses(scene, P)
        out += gravity_compensator.build_torque_hypotheses(scene)
        out += drive_gain_and_coupling.build_drive_hypotheses(scene, paths, *drive)
    else:
        untestable.append(UntestableEffect("payload", "tool", "one joint cannot tell a payload from its own inertia"))

    now = rough(0.0)

    def late(d: float) -> Array:
        return scene.average_coordinates(rough(d) - now)

    out += build_channel_delay_hypotheses(scene, "tau", late, best)
    out += build_channel_delay_hypotheses(scene, "q", late, best, sign=-1.0, penalty=2.0)
    nameless = tuple(h for j in range(n) for h in unmodelled_torques.build_unmodelled_torque_hypotheses(scene, j))
    return HypothesisCatalogue(tuple(out), tuple(untestable), list_motion_axes(scene), uncatalogued_hypotheses=nameless)


def compute_gear_load(scene: MotionModel) -> Array | None:
    """Compute the link-side torque from the rigid-body model, with a payload fitted to the recorded torque.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        (M, n) N·m; None if the model does not describe the recorded torque to 10 %, or the URDF has no
        inertias.
    """
    m, dynamics = scene.motion, scene.dynamics
    if dynamics is None or scene.predicted is None:
        return None
    if scene.recording.torque is None:
        return scene.predicted
    measured = scene.recording.torque[m.index, : scene.joints]
    y = m.subtract_period_mean(m.average_blocks(measured - scene.predicted))
    base, unknowns = _build_base_columns(scene, [DELAY_REVERSAL_SHAPES[1]] * scene.joints)
    P, T, _ = dynamics.compute_regressors(m.q, m.v, m.a)
    own = np.concatenate([P, T], axis=2)
    X = np.concatenate([base, scene.average_coordinates(own)], axis=2)
    weight = 1.0 / np.maximum(compute_coordinate_rms(y, base), 1e-12)
    A = (X * weight[:, None]).reshape(-1, X.shape[2])
    left, x = fit_least_squares((y * weight).reshape(-1), A)
    error = np.std(left.reshape(y.shape) / weight, axis=0)
    moving = [j for j in range(scene.joints) if scene.is_joint_moving(j)]
    if any(error[j] > thresholds.SHARES.relevant * np.ptp(measured[:, j]) for j in moving):
        return None
    return np.asarray(scene.predicted + own @ x[len(unknowns) :])


def list_motion_axes(scene: MotionModel) -> dict[str, Array]:
    """Return the axes along which a mismatch is located: time, session, joint angles, speeds, temperature.

    Args:
        scene: Motion model: recording, signals, kinematics, dynamics and the selected channel.

    Returns:
        Name → (N,) values, SI.
    """
    m = scene.motion
    out = {"time": m.average_blocks(m.time), "session": m.select_block_labels(m.session).astype(float)}
    for j in range(scene.joints):
        out[f"q{j + 1}"] = m.average_blocks(m.q[:, j])
        out[f"speed {j + 1}"] = m.average_blocks(m.v[:, j])
    if scene.recording.temperature is not None:
        out["temperature"] = m.average_blocks(scene.recording.temperature[m.index])
    return out

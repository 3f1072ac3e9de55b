"""Thermal drift in static readings: each registered drift law with the motion patterns of this arm.

Load-test readings are relative to the unloaded state of their cycle: only the drift since then is visible.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.effects import parameter_conversion, registry
from machopt.effects.protocol import DriftLaw, Effect, ThermalState
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Quantity, Shape
from machopt.measurement.diagnosis.data_types.static_readings import BODY_BEHIND_FLANGE, StaticReadings
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_frame_motion_matrix


def build_thermal_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build all drift laws that the recording can show.

    Args:
        r: Static readings.

    Returns:
        The hypotheses.
    """
    seen = build_thermal_state(r)
    laws = ((e, law, law.grid(seen)) for e in registry.select_drift_effects() for law in e.drift_laws)
    return [_build_thermal_hypothesis(seen, e, law, grid) for e, law, grid in laws if grid]


def _build_thermal_hypothesis(
    thermal_state: ThermalState, effect: Effect, law: DriftLaw, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, len(law.coefficients)))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape), thermal_state)

    return EffectHypothesis(
        effect=effect.file_word,
        location=effect.places[0],
        law=law.name,
        equation=law.equation,
        columns=lambda shape: law.columns(np.array(shape), thermal_state),
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        family="environment",
        note=effect.note,
        penalty=law.penalty,
    )


def build_thermal_state(r: StaticReadings) -> ThermalState:
    """Build times, temperatures and TCP motion patterns of the readings.

    Args:
        r: Static readings.

    Returns:
        The input of drift laws.
    """
    temperature, time = r.recording.temperature, r.recording.time
    rise = None
    if (
        temperature is not None and np.ptp(temperature) > 0.0 and not r.is_difference
    ):  # unloaded states have no recorded temperature
        rise = temperature - temperature[r.order[0]]
    since, before = (None, None) if time is None else _compute_session_time(r, time)
    return ThermalState(
        time_since_start=since,
        unloaded_time_since_start=before,
        temperature_rise=rise,
        casting_columns=compute_casting_columns(r),
        stand_columns=compute_stand_columns(r),
        is_relative=r.is_difference,
    )


def _compute_session_time(r: StaticReadings, time: Array) -> tuple[Array, Array | None]:
    """Return the times (N,) s since the session began, of the readings and of their unloaded reference states."""
    since, zero = np.zeros(len(r)), _estimate_unloaded_times(r, time) if r.is_difference else None
    for label in np.unique(r.session):
        rows = r.session == label
        start = time[rows].min() if zero is None else zero[rows].min()
        since[rows] = time[rows] - start
        if zero is not None:
            zero[rows] -= start
    return since, zero


def _estimate_unloaded_times(r: StaticReadings, time: Array) -> Array:
    """Return the times (N,) s of each cycle's unloaded state: one reading interval before its first reading."""
    gaps = np.concatenate([np.diff(time[rows]) for rows in r.cycles])
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    out = np.zeros(len(r))
    for rows in r.cycles:
        own = np.diff(time[rows])
        out[rows] = time[rows[0]] - (float(np.median(own)) if len(own) else usual)
    return out


def compute_casting_columns(r: StaticReadings) -> Array:
    """Compute the TCP motion per unit strain of the castings.

    Args:
        r: Static readings.

    Returns:
        (N, D, 3) m per unit strain of carousel, upper arm, and forearm with wrist.
    """
    assert r.state.R_bodies is not None  # readings come with bodies
    R = r.state.R_bodies
    points = [*r.robot.point, r.robot.T_base_flange_zero[:3, 3]]
    parts = []
    forearm = tuple(range(3, r.joint_count + 1))  # bodies that expand as one casting
    for group in ((1,), (2,), forearm):
        moved = np.zeros((len(r), 6))
        for i in group:
            moved[:, :3] += R[:, i] @ (points[i] - points[i - 1])
        parts.append(r.project_to_measured(moved, BODY_BEHIND_FLANGE))  # an expanding link does not rotate
    return np.stack(parts, axis=2)


def compute_stand_columns(r: StaticReadings) -> Array:
    """Compute the TCP motion per unit translation and rotation of the stand about the centroid of the points.

    Args:
        r: Static readings.

    Returns:
        (N, D, 6) m, rad per m and rad.
    """
    p = r.state.T_base_tool[:, :3, 3]
    return r.project_to_measured(
        compute_frame_motion_matrix(p, p.mean(axis=0)), BODY_BEHIND_FLANGE
    )  # motion of the tracker's stand: an inclinometer on the arm does not measure it

"""Drift with time and temperature, as resting readings see it: each law of the registry, with what this arm is made of.

A load test counts from the unloaded state of its cycle: it shows what has moved since.
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

FOREARM = (3, 4, 5, 6)  # bodies that one casting carries, and grow as one


def build_thermal_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """The laws of every drift that the record can show."""
    seen = build_thermal_state(r)
    laws = ((e, law, law.grid(seen)) for e in registry.select_drift_effects() for law in e.drift_laws)
    return [_build_thermal_hypothesis(seen, e, law, grid) for e, law, grid in laws if grid]


def _build_thermal_hypothesis(
    seen: ThermalState, effect: Effect, law: DriftLaw, grid: tuple[Shape, ...]
) -> EffectHypothesis:
    lower = tuple(least for _, _, least in parameter_conversion.list_coefficient_names(law, len(law.coefficients)))

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return law.sizes(x, np.array(shape), seen)

    return EffectHypothesis(
        effect=effect.file_word,
        location=effect.places[0],
        law=law.name,
        equation=law.equation,
        columns=lambda shape: law.columns(np.array(shape), seen),
        quantities=sizes,
        shapes=grid,
        lower=lower if np.isfinite(lower).any() else (),
        family="environment",
        note=effect.note,
        penalty=law.penalty,
    )


def build_thermal_state(r: StaticReadings) -> ThermalState:
    """What heat follows in these readings, and which way it moves the TCP."""
    temperature, time = r.recording.temperature, r.recording.time
    rise = None
    if temperature is not None and np.ptp(temperature) > 0.0 and not r.is_difference:  # unloaded states have none
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
    """(N,) s since each session began, of the readings and of the states that they count from."""
    since, zero = np.zeros(len(r)), _estimate_unloaded_times(r, time) if r.is_difference else None
    for label in np.unique(r.session):
        rows = r.session == label
        start = time[rows].min() if zero is None else zero[rows].min()
        since[rows] = time[rows] - start
        if zero is not None:
            zero[rows] -= start
    return since, zero


def _estimate_unloaded_times(r: StaticReadings, time: Array) -> Array:
    """(N,) s, when the unloaded state of each reading's cycle stood: as long before the first as readings are apart."""
    gaps = np.concatenate([np.diff(time[rows]) for rows in r.cycles])
    usual = float(np.median(gaps)) if len(gaps) else 0.0
    out = np.zeros(len(r))
    for rows in r.cycles:
        own = np.diff(time[rows])
        out[rows] = time[rows[0]] - (float(np.median(own)) if len(own) else usual)
    return out


def compute_casting_columns(r: StaticReadings) -> Array:
    """(N, D, 3) m per unit strain of the carousel, the upper arm, the forearm with the wrist."""
    assert r.state.R_bodies is not None  # readings come with bodies
    R = r.state.R_bodies
    points = [*r.robot.point, r.robot.T_base_flange_zero[:3, 3]]
    parts = []
    for group in ((1,), (2,), FOREARM):
        moved = np.zeros((len(r), 6))
        for i in group:
            moved[:, :3] += R[:, i] @ (points[i] - points[i - 1])
        parts.append(r.project_to_measured(moved, BODY_BEHIND_FLANGE))  # a link that grows turns nothing
    return np.stack(parts, axis=2)


def compute_stand_columns(r: StaticReadings) -> Array:
    """(N, D, 6) shift in m and turn in rad of the stand about the middle of the points."""
    p = r.state.T_base_tool[:, :3, 3]
    return r.project_to_measured(
        compute_frame_motion_matrix(p, p.mean(axis=0)), BODY_BEHIND_FLANGE
    )  # the tracker's: an inclinometer on the arm sees none of it

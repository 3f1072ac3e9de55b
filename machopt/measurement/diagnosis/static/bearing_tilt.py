"""Tilt of a main bearing across its joint axis: no effect of the catalogue, so a load test never reports it by name.

Joints of the catalogue rotate about their axes, and bodies deform between bearings. A bearing that is compliant
across the axis resembles a base or link nearby. One with clearance resembles backlash of a joint that has none. The
tilt follows the moment across the axis, including gravity: proportional to it, or free up to a stop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns.structural_compliance import compute_weight_wrench
from machopt.measurement.diagnosis.model_selection.unmodelled_slip_and_external_forces import (
    build_uncatalogued_hypothesis,
)
from machopt.numerics.array_types import Array

ELASTIC_TILT_LAW, BACKLASH_TILT_LAW = "tilts across its axis", "tilts across its axis until it seats"
MAX_BEARING_JOINTS = 3  # number of joints considered: wrist bearings have short lever arms
SEATING_SHARES = (0.05, 0.1, 0.2, 0.4)  # moment at the stop, relative to the largest load moment
TILT_DIRECTIONS: Shape = tuple(np.radians(np.arange(0.0, 180.0, 30.0)).tolist())  # rad, direction of the tilt axis
ANY_DIRECTION = -1.0  # tilt in the direction of the moment


@dataclass(frozen=True)
class _BearingLoad:
    """Load of one bearing, base_link axes, SI. The two directions across its axis move with the link before or behind
    the joint.
    """

    lever: Array  # (N, 3) from the joint to the TCP
    load: Array  # (N, 3) N·m of the recorded load
    weight: Array  # (N, 3) N·m of the carried weights
    across: Array  # (N, 2, 3) unit vectors across the axis

    def lift_rotation(self, turn: Array) -> Array:
        """Return the TCP twist of a rotation of the bearing.

        Args:
            turn: (N, 3) rotation vector, rad.

        Returns:
            (N, 6) m, rad.
        """
        return np.concatenate([np.cross(turn, self.lever), turn], axis=1)


def build_bearing_hypotheses(r: StaticReadings) -> list[EffectHypothesis]:
    """Build the bearing tilts of the first joints.

    Args:
        r: Readings of a load test.

    Returns:
        The hypotheses.
    """
    out = []
    for j in range(MAX_BEARING_JOINTS):
        behind, before = _build_bearing_load(r, j, j + 1), _build_bearing_load(r, j, j)
        out += [_build_elastic_tilt(r, j, b) for b in (before, behind)]
        out += [
            _build_backlash_tilt(r, j, before, ways=(ANY_DIRECTION, *TILT_DIRECTIONS)),
            _build_backlash_tilt(r, j, behind, ways=TILT_DIRECTIONS),
        ]
    return out


def _build_bearing_load(r: StaticReadings, j: int, body: int) -> _BearingLoad:
    """Return the load of joint ``j`` (0-based), with directions across the axis fixed in a body."""
    state = r.state
    assert state.R_bodies is not None  # readings come with bodies
    assert state.p_bodies is not None
    at = state.R_bodies[:, j] @ r.robot.point[j] + state.p_bodies[:, j]
    z, lever = state.J[:, 3:, j], state.T_base_tool[:, :3, 3] - at

    def moment(wrench: Array) -> Array:
        return np.asarray(wrench[:, 3:] + np.cross(lever, wrench[:, :3]))

    carried = np.zeros((len(r), 6)) if r.masses is None else compute_weight_wrench(r, r.masses.body >= j + 1)
    R = state.R_bodies[:, body]
    axis = R[0].T @ z[0]  # constant in all poses
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    across = np.stack([R @ u, R @ np.cross(axis, u)], axis=1)
    return _BearingLoad(lever, moment(r.wrench), moment(carried), across)


def _build_elastic_tilt(r: StaticReadings, j: int, bearing: _BearingLoad) -> EffectHypothesis:
    """Build a direction-dependent elastic tilt: three coefficients of a symmetric matrix."""
    about = np.einsum("nwc,nc->nw", bearing.across, bearing.load)
    pairs = list(combinations_with_replacement(range(2), 2))
    turns = [
        (bearing.across[:, a] * about[:, b, None] + bearing.across[:, b] * about[:, a, None]) / (2.0 if a == b else 1.0)
        for a, b in pairs
    ]
    columns = r.project_to_measured(np.stack([bearing.lift_rotation(t) for t in turns], axis=2), j + 1)
    return _build_bearing_hypothesis(j, ELASTIC_TILT_LAW, lambda shape: columns, ((),))


def _build_backlash_tilt(r: StaticReadings, j: int, bearing: _BearingLoad, ways: Shape) -> EffectHypothesis:
    """Build a tilt clearance with a stop at a share of the largest moment, about one axis or about any."""
    moment = np.linalg.norm(_project_across_axis(bearing, bearing.load), axis=1)
    largest = float(np.quantile(moment, 1.0 - thresholds.SHARES.negligible))

    def columns(shape: Shape) -> Array:
        seat, way = shape
        keep = _keep_whole_moment if way == ANY_DIRECTION else _build_moment_projection(bearing, way)
        there, loaded = (
            keep(_project_across_axis(bearing, bearing.weight)),
            keep(_project_across_axis(bearing, bearing.weight + bearing.load)),
        )
        turn = _compute_seated_share(loaded, seat * largest) - _compute_seated_share(there, seat * largest)
        return np.asarray(r.project_to_measured(bearing.lift_rotation(turn), j + 1)[:, :, None])

    return _build_bearing_hypothesis(
        j, BACKLASH_TILT_LAW, columns, tuple((s, w) for w in ways for s in SEATING_SHARES) if largest > 0.0 else ()
    )


def _project_across_axis(bearing: _BearingLoad, moment: Array) -> Array:
    """Return the part (N, 3) of a moment across the axis."""
    return np.asarray(np.einsum("nwc,nwk,nk->nc", bearing.across, bearing.across, moment))


def _keep_whole_moment(moment: Array) -> Array:
    return moment


def _build_moment_projection(bearing: _BearingLoad, way: float) -> Callable[[Array], Array]:
    """Return the projection of moments on one axis, ``way`` rad from the first direction."""
    axis = np.cos(way) * bearing.across[:, 0] + np.sin(way) * bearing.across[:, 1]
    return lambda moment: axis * np.einsum("nc,nc->n", axis, moment)[:, None]


def _compute_seated_share(moment: Array, seat: float) -> Array:
    """Return the share (N, 3) of the clearance: proportional to the moment up to ``seat`` N·m, then constant."""
    return np.asarray(moment / np.maximum(np.linalg.norm(moment, axis=1), seat)[:, None])


def _build_bearing_hypothesis(
    j: int, name: str, columns: Callable[[Shape], Array], shapes: tuple[Shape, ...]
) -> EffectHypothesis:
    note = f"tilts across the axis of joint {j + 1} by the moment there, as a main bearing that is loose or soft does"
    return replace(
        build_uncatalogued_hypothesis(format_joint_location(j + 1), name, note, columns, shapes), is_approximate=True
    )

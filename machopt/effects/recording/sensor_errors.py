"""Errors of recorded loads and displacements: zero offset, gain and axes of the force sensor, axes of the
displacement, point and direction of the load.

A law returns what acted in addition to the recorded values, per unit of each coefficient. It is either a wrench,
which moves the arm through the compliance identified so far, or a change of the displacement itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DEGREE, EXACT_FORM_UNCERTAINTY, Effect, Quantity, RecordedLoad
from machopt.effects.recording.force_sensor_laws import (
    FORCE,
    ForceAxisGain,
    ForceAxisNonlinearity,
    ForceZeroOffset,
    SensorAxisRotation,
    SensorErrorDefaults,
    build_axis_parameters,
    describe_offset,
    describe_vector,
)
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_frame_motion_matrix


@dataclass(frozen=True)
class LoadPointOffset(SensorErrorDefaults):
    """Offset of the point of load application from the TCP."""

    name = "hook beside the TCP"
    equation = "m = m_recorded + r × f, r constant in the tool"
    coefficients = build_axis_parameters("offset", "m", 1e-3)

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the moment per metre of offset along each tool axis.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N·m/m, in base_link axes.
        """
        f = recorded_load.wrench[:, :3]
        moment = np.stack([np.cross(recorded_load.tool[:, :, k], f) for k in range(3)], axis=2)
        return np.concatenate([np.zeros_like(moment), moment], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in mm; the first one is the size of the effect.
        """
        return describe_offset(values)


@dataclass(frozen=True)
class TcpOffset(SensorErrorDefaults):
    """Offset of both load point and measured target from the cell's TCP: the tool has another length."""

    name = "TCP elsewhere in the tool"
    equation = "m = m_recorded + r × f and δ_recorded = δ + θ × r, r constant in the tool"
    affected_quantity = "point"
    coefficients = build_axis_parameters("offset", "m", 1e-3)

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the displacement of the tool point per metre along each tool axis.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) m/m in the first three rows, in base_link axes.
        """
        return np.concatenate([recorded_load.tool, np.zeros_like(recorded_load.tool)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in mm; the first one is the size of the effect.
        """
        return describe_offset(values)


@dataclass(frozen=True)
class LoadDirectionError(SensorErrorDefaults):
    """Constant deviation of the load direction from the recorded direction; the magnitude is unchanged."""

    name = "pull askew"
    equation = "f along e + u instead of e, u constant in base_link"
    coefficients = build_axis_parameters("askew", "rad", DEGREE)

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the force across the recorded direction per radian of deviation.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N/rad, in base_link axes.
        """
        f = recorded_load.wrench[:, :3]
        size = np.linalg.norm(f, axis=1, keepdims=True)
        e = np.divide(f, size, out=np.zeros_like(f), where=size > 0)
        across = size[:, :, None] * (np.eye(3) - e[:, :, None] * e[:, None, :])
        return np.concatenate([across, np.zeros_like(across)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the angle of the deviation and its components along base_link.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in deg; the first one is the size of the effect.
        """
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(values))), "deg"),
            **describe_vector("askew", np.degrees(values), "deg"),
        }


@dataclass(frozen=True)
class TrackerFrameError(SensorErrorDefaults):
    """Error of the recorded tracker frame in base_link: a translation and a small rotation."""

    name = "the tracker's frame is displaced"
    equation = "p = T p_recorded, T a shift and a small turn about the middle of the points"
    affected_quantity = "position"
    coefficients = (*build_axis_parameters("shift", "m", 1e-3), *build_axis_parameters("about", "rad", DEGREE))

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the change of the measured positions per unit translation and rotation of the frame.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, D, 6) m, rad per m and rad, about the centroid of the points.
        """
        assert recorded_load.position is not None  # the law is used for measured poses only
        return compute_frame_motion_matrix(recorded_load.position, recorded_load.position.mean(axis=0))[
            :, : recorded_load.displacement.shape[1]
        ]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the rotation and the translation of the frame, with their components about and along base_link.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in deg and mm; the first one is the size of the effect.
        """
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(values[3:]))), "deg"),
            "shift": Quantity(1e3 * float(np.linalg.norm(values[:3])), "mm"),
            **describe_vector("about", np.degrees(values[3:]), "deg"),
            **describe_vector("shift", 1e3 * values[:3], "mm"),
        }


OFFSET = Effect(
    name="force_sensor_offset",
    noun="zero offset",
    short_noun="zero of the force sensor",
    sentence="The force sensor shows a load where none acts.",
    port="record",
    places=(FORCE,),
    record_laws=(ForceZeroOffset(),),
    form_uncertainty=EXACT_FORM_UNCERTAINTY,
)

GAIN = Effect(
    name="force_sensor_gain",
    noun="gain",
    short_noun="gain of the force sensor",
    sentence="The force sensor reads a share too much or too little.",
    port="record",
    places=(FORCE,),
    record_laws=(ForceAxisGain(), ForceAxisNonlinearity()),
    form_uncertainty=EXACT_FORM_UNCERTAINTY,
    plausible_sizes={"%": 60.0},
)

FRAME = Effect(
    name="force_sensor_frame",
    noun="misalignment",
    short_noun="axes of the force sensor",
    sentence="The force sensor's axes are turned against the recorded frame.",
    port="record",
    places=(FORCE,),
    record_laws=(SensorAxisRotation(),),
    form_uncertainty=EXACT_FORM_UNCERTAINTY,
    plausible_sizes={"deg": 25.0},
)

DISPLACEMENT = Effect(
    name="displacement_frame",
    noun="misalignment",
    short_noun="axes of the displacement",
    sentence="The measured displacements are turned against the recorded frame.",
    port="record",
    places=("sensor:displacement",),
    record_laws=(SensorAxisRotation("displacement"), TrackerFrameError()),
    form_uncertainty=EXACT_FORM_UNCERTAINTY,
    plausible_sizes={"deg": 25.0},
)

LOAD = Effect(
    name="load_geometry",
    noun="load geometry",
    short_noun="where or which way the load acted",
    sentence="The load acted elsewhere, or in another direction, than recorded.",
    port="record",
    places=(FORCE,),
    record_laws=(LoadPointOffset(), LoadDirectionError(), TcpOffset()),
    form_uncertainty=EXACT_FORM_UNCERTAINTY,
    plausible_sizes={"deg": 25.0, "mm": 1000.0},
    preposition="",
)

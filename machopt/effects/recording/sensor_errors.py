"""Errors of recorded loads and displacements: zero offset, gain and axes of the force sensor, axes of the
displacement, point and direction of the load.

A law returns what acted in addition to the recorded values, per unit of each coefficient. It is either a wrench,
which moves the arm through the compliance identified so far, or a change of the displacement itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DEGREE, EXACT_FORM_UNCERTAINTY, Effect, LawParameter, Quantity, RecordedLoad, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_frame_motion_matrix

FORCE = "sensor:force"
XYZ = "xyz"


def _build_axis_parameters(name: str, unit: str, factor: float = 1.0) -> tuple[LawParameter, ...]:
    return tuple(LawParameter(key=f"{name}_{a}", unit=unit, factor=factor) for a in XYZ)


class _SensorErrorDefaults:
    """Default implementations shared by most of these laws."""

    word = ""
    has_memory = False
    affected_quantity = "wrench"
    shape: tuple[LawParameter, ...] = ()

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class ForceZeroOffset(_SensorErrorDefaults):
    """Zero offset of the force sensor."""

    name = "zero of the force"
    equation = "w_recorded = w + b, b constant in the sensor"
    coefficients = _build_axis_parameters("offset", "N")

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the wrench per unit of offset along each sensor axis.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N per N, in base_link axes.
        """
        return np.concatenate([-seen.axes, np.zeros_like(seen.axes)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in N; the first one is the size of the effect.
        """
        return {"offset": Quantity(float(np.linalg.norm(values)), "N"), **_describe_vector("offset", values, "N")}


@dataclass(frozen=True)
class ForceAxisGain(_SensorErrorDefaults):
    """Gain error of one force axis. The coefficient is the excess relative to the recorded value."""

    name = "gain of one axis"
    equation = "f_k recorded = (1 + g) f_k"
    coefficients = (LawParameter(key="too_much", unit="1"),)
    shape = (LawParameter(key="axis", unit="1"),)  # 0, 1, 2

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the wrench per unit of the relative excess.

        Args:
            shape: (1,) sensor axis: 0, 1 or 2.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 1) N, in base_link axes.
        """
        e = seen.axes[:, :, int(shape[0])]
        part = -e * np.einsum("nc,nc->n", e, seen.wrench[:, :3])[:, None]
        return np.concatenate([part, np.zeros_like(part)], axis=1)[:, :, None]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the gain error with its sign, and the axis: positive where the sensor reads too much.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (1,) sensor axis: 0, 1 or 2.

        Returns:
            ``gain`` in % and ``axis`` (1 to 3).
        """
        x = float(values[0])
        gain = x / (1.0 - x) if x < 0.9 else 9.0  # g of f_recorded = (1 + g) f
        return {"gain": Quantity(100.0 * gain, "%"), "axis": Quantity(float(shape[0]) + 1.0, "")}

    def grid(self) -> tuple[Shape, ...]:
        return ((0.0,), (1.0,), (2.0,))


@dataclass(frozen=True)
class ForceAxisNonlinearity(_SensorErrorDefaults):
    """Nonlinear characteristic of one force axis: the gain error grows with the load."""

    name = "gain that grows with the load"
    equation = "f_k recorded = f_k (1 + g f_k), or f_k (1 + g |f_k|) where both sides bend alike"
    coefficients = (LawParameter(key="too_much_per_N", unit="1/N"),)
    shape = (LawParameter(key="axis", unit="1"), LawParameter(key="alike", unit="1"))  # 0, 1, 2; 0 or 1

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the wrench per unit of the coefficient.

        Args:
            shape: (2,) sensor axis (0, 1 or 2), and 1 if the error has the same sign for tension and compression,
                else 0.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 1) N², in base_link axes.
        """
        e = seen.axes[:, :, int(shape[0])]
        f = np.einsum("nc,nc->n", e, seen.wrench[:, :3])
        part = -e * (f * (np.abs(f) if shape[1] else f))[:, None]
        return np.concatenate([part, np.zeros_like(part)], axis=1)[:, :, None]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the growth of the gain error with the load, with its sign, and the axis.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (2,) sensor axis (0, 1 or 2), and the symmetry flag.

        Returns:
            ``gain_growth`` in %/kN, ``axis`` (1 to 3), and ``alike`` (1 where both signs of the force have the same
            error).
        """
        gain = 1e5 * float(values[0])  # % a kN, to first order
        return {
            "gain_growth": Quantity(gain, "%/kN"),
            "axis": Quantity(float(shape[0]) + 1.0, ""),
            "alike": Quantity(float(shape[1]), ""),
        }

    def grid(self) -> tuple[Shape, ...]:
        return tuple((axis, alike) for alike in (0.0, 1.0) for axis in (0.0, 1.0, 2.0))


@dataclass(frozen=True)
class SensorAxisRotation(_SensorErrorDefaults):
    """Rotation of the axes of the force sensor, or of the displacement, relative to the recorded frame."""

    affected_quantity: str = "wrench"
    name = "axes turned"
    coefficients = _build_axis_parameters("about", "rad", DEGREE)

    @property
    def equation(self) -> str:
        if self.affected_quantity == "displacement":
            return "δ_recorded = (I + [φ]×) δ"
        return "w_recorded = (I + [φ]×) w: C w breaks Maxwell reciprocity"

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the change of wrench or displacement per radian about each sensor axis.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N, N·m or (K, D, 3) m, rad per rad, in base_link axes.
        """
        of, sign = (seen.wrench, -1.0) if self.affected_quantity == "wrench" else (seen.displacement, 1.0)
        halves = range(0, of.shape[1], 3)
        turned = [
            np.concatenate([np.cross(seen.axes[:, :, k], of[:, a : a + 3]) for a in halves], axis=1) for k in range(3)
        ]
        return sign * np.stack(turned, axis=2)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the rotation angle and its components.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in deg; the first one is the size of the effect.
        """
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(values))), "deg"),
            **_describe_vector("about", np.degrees(values), "deg"),
        }


@dataclass(frozen=True)
class LoadPointOffset(_SensorErrorDefaults):
    """Offset of the point of load application from the TCP."""

    name = "hook beside the TCP"
    equation = "m = m_recorded + r × f, r constant in the tool"
    coefficients = _build_axis_parameters("offset", "m", 1e-3)

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the moment per metre of offset along each tool axis.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N·m/m, in base_link axes.
        """
        f = seen.wrench[:, :3]
        moment = np.stack([np.cross(seen.tool[:, :, k], f) for k in range(3)], axis=2)
        return np.concatenate([np.zeros_like(moment), moment], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in mm; the first one is the size of the effect.
        """
        return _describe_offset(values)


@dataclass(frozen=True)
class TcpOffset(_SensorErrorDefaults):
    """Offset of both load point and measured target from the cell's TCP: the tool has another length."""

    name = "TCP elsewhere in the tool"
    equation = "m = m_recorded + r × f and δ_recorded = δ + θ × r, r constant in the tool"
    affected_quantity = "point"
    coefficients = _build_axis_parameters("offset", "m", 1e-3)

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the displacement of the tool point per metre along each tool axis.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) m/m in the first three rows, in base_link axes.
        """
        return np.concatenate([seen.tool, np.zeros_like(seen.tool)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in mm; the first one is the size of the effect.
        """
        return _describe_offset(values)


@dataclass(frozen=True)
class LoadDirectionError(_SensorErrorDefaults):
    """Constant deviation of the load direction from the recorded direction; the magnitude is unchanged."""

    name = "pull askew"
    equation = "f along e + u instead of e, u constant in base_link"
    coefficients = _build_axis_parameters("askew", "rad", DEGREE)

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the force across the recorded direction per radian of deviation.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N/rad, in base_link axes.
        """
        f = seen.wrench[:, :3]
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
            **_describe_vector("askew", np.degrees(values), "deg"),
        }


@dataclass(frozen=True)
class TrackerFrameError(_SensorErrorDefaults):
    """Error of the recorded tracker frame in base_link: a translation and a small rotation."""

    name = "the tracker's frame stands elsewhere"
    equation = "p = T p_recorded, T a shift and a small turn about the middle of the points"
    affected_quantity = "position"
    coefficients = (*_build_axis_parameters("shift", "m", 1e-3), *_build_axis_parameters("about", "rad", DEGREE))

    def columns(self, shape: Array, seen: RecordedLoad) -> Array:
        """Return the change of the measured positions per unit translation and rotation of the frame.

        Args:
            shape: Empty; the law has no shape parameters.
            seen: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, D, 6) m, rad per m and rad, about the centroid of the points.
        """
        assert seen.position is not None  # the law is used for measured poses only
        return compute_frame_motion_matrix(seen.position, seen.position.mean(axis=0))[:, : seen.displacement.shape[1]]

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
            **_describe_vector("about", np.degrees(values[3:]), "deg"),
            **_describe_vector("shift", 1e3 * values[:3], "mm"),
        }


def _describe_offset(values: Array) -> dict[str, Quantity]:
    """Return magnitude and components of an offset in m as quantities in mm."""
    return {
        "offset": Quantity(1e3 * float(np.linalg.norm(values)), "mm"),
        **_describe_vector("offset", 1e3 * values, "mm"),
    }


def _describe_vector(name: str, x: Array, unit: str) -> dict[str, Quantity]:
    return {f"{name}_{a}": Quantity(float(v), unit) for a, v in zip(XYZ, x, strict=True)}


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

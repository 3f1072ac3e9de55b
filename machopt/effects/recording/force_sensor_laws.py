"""Laws of errors of a force sensor: zero offset, gain, nonlinearity and rotated axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import DEGREE, LawParameter, Quantity, RecordedLoad, Shape
from machopt.numerics.array_types import Array

FORCE = "sensor:force"
XYZ = "xyz"


def build_axis_parameters(name: str, unit: str, factor: float = 1.0) -> tuple[LawParameter, ...]:
    """Build one parameter for each axis of the sensor.

    Args:
        name: First part of the key.
        unit: Unit in files.
        factor: SI units per unit in files.
    """
    return tuple(LawParameter(key=f"{name}_{a}", unit=unit, factor=factor) for a in XYZ)


class SensorErrorDefaults:
    """Default implementations shared by most of these laws."""

    word = ""
    has_memory = False
    affected_quantity = "wrench"
    shape: tuple[LawParameter, ...] = ()

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class ForceZeroOffset(SensorErrorDefaults):
    """Zero offset of the force sensor."""

    name = "zero of the force"
    equation = "w_recorded = w + b, b constant in the sensor"
    coefficients = build_axis_parameters("offset", "N")

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the wrench per unit of offset along each sensor axis.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N per N, in base_link axes.
        """
        return np.concatenate([-recorded_load.axes, np.zeros_like(recorded_load.axes)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the magnitude and the components of the offset.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities in N; the first one is the size of the effect.
        """
        return {"offset": Quantity(float(np.linalg.norm(values)), "N"), **describe_vector("offset", values, "N")}


@dataclass(frozen=True)
class ForceAxisGain(SensorErrorDefaults):
    """Gain error of one force axis. The coefficient is the excess relative to the recorded value."""

    name = "gain of one axis"
    equation = "f_k recorded = (1 + g) f_k"
    coefficients = (LawParameter(key="too_much", unit="1"),)
    shape = (LawParameter(key="axis", unit="1"),)  # 0, 1, 2

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the wrench per unit of the relative excess.

        Args:
            shape: (1,) sensor axis: 0, 1 or 2.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 1) N, in base_link axes.
        """
        e = recorded_load.axes[:, :, int(shape[0])]
        part = -e * np.einsum("nc,nc->n", e, recorded_load.wrench[:, :3])[:, None]
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
class ForceAxisNonlinearity(SensorErrorDefaults):
    """Nonlinear characteristic of one force axis: the gain error grows with the load."""

    name = "gain that grows with the load"
    equation = "f_k recorded = f_k (1 + g f_k), or f_k (1 + g |f_k|) where both sides bend alike"
    coefficients = (LawParameter(key="too_much_per_N", unit="1/N"),)
    shape = (LawParameter(key="axis", unit="1"), LawParameter(key="alike", unit="1"))  # 0, 1, 2; 0 or 1

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the wrench per unit of the coefficient.

        Args:
            shape: (2,) sensor axis (0, 1 or 2), and 1 if the error has the same sign for tension and compression,
                else 0.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 1) N², in base_link axes.
        """
        e = recorded_load.axes[:, :, int(shape[0])]
        f = np.einsum("nc,nc->n", e, recorded_load.wrench[:, :3])
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
class SensorAxisRotation(SensorErrorDefaults):
    """Rotation of the axes of the force sensor, or of the displacement, relative to the recorded frame."""

    affected_quantity: str = "wrench"
    name = "axes turned"
    coefficients = build_axis_parameters("about", "rad", DEGREE)

    @property
    def equation(self) -> str:
        if self.affected_quantity == "displacement":
            return "δ_recorded = (I + [φ]×) δ"
        return "w_recorded = (I + [φ]×) w: C w breaks Maxwell reciprocity"

    def columns(self, shape: Array, recorded_load: RecordedLoad) -> Array:
        """Return the change of wrench or displacement per radian about each sensor axis.

        Args:
            shape: Empty; the law has no shape parameters.
            recorded_load: Recorded loads and predicted displacements of K readings.

        Returns:
            (K, 6, 3) N, N·m or (K, D, 3) m, rad per rad, in base_link axes.
        """
        of, sign = (
            (recorded_load.wrench, -1.0) if self.affected_quantity == "wrench" else (recorded_load.displacement, 1.0)
        )
        halves = range(0, of.shape[1], 3)
        turned = [
            np.concatenate([np.cross(recorded_load.axes[:, :, k], of[:, a : a + 3]) for a in halves], axis=1)
            for k in range(3)
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
            **describe_vector("about", np.degrees(values), "deg"),
        }


def describe_offset(values: Array) -> dict[str, Quantity]:
    """Return magnitude and components of an offset as quantities in mm.

    Args:
        values: (3,) m.
    """
    return {
        "offset": Quantity(1e3 * float(np.linalg.norm(values)), "mm"),
        **describe_vector("offset", 1e3 * values, "mm"),
    }


def describe_vector(name: str, x: Array, unit: str) -> dict[str, Quantity]:
    """Return the components of a vector as quantities.

    Args:
        name: First part of each key.
        x: (3,) components in the unit.
        unit: Unit in files.
    """
    return {f"{name}_{a}": Quantity(float(v), unit) for a, v in zip(XYZ, x, strict=True)}

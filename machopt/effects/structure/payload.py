"""Payload that differs from the cell's: in mass, in centre of mass, or in both.

Weight and inertia of the payload are linear in its mass and its first moments. A channel supplies the sensitivity of
its readings to one kilogram at a reference point and to one kilogram metre along each flange axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.effects.protocol import Effect, LawParameter, Quantity, Shape, ToolSideLoad
from machopt.numerics.array_types import Array

MOMENTS = tuple(LawParameter(key=f"moment_{a}_kgm", unit="kg·m") for a in "xyz")
MASS = LawParameter(key="mass_kg", unit="kg")


@dataclass(frozen=True)
class _PayloadDefaults:
    """Default implementations shared by these laws."""

    word = ""
    has_memory = False
    shape: tuple[LawParameter, ...] = ()

    def grid(self, tool_side_load: ToolSideLoad) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class MassDeviation(_PayloadDefaults):
    """Mass error Δm at the stated centre of mass."""

    name = "another mass at the stated centre"
    equation = "the weight of Δm at the tool side"
    coefficients = (MASS,)

    def columns(self, tool_side_load: ToolSideLoad) -> Array:
        """Return the change of the readings per kilogram.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            (N, D, 1).
        """
        return np.asarray(
            tool_side_load.columns @ np.r_[1.0, tool_side_load.centre - tool_side_load.reference_point][:, None]
        )

    def sizes(self, values: Array, tool_side_load: ToolSideLoad) -> Mapping[str, Quantity]:
        """Return the mass error and the resulting first moments.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        return {"mass": Quantity(float(values[0]), "kg"), **_describe_moments(float(values[0]) * tool_side_load.centre)}


@dataclass(frozen=True)
class MassAndMomentError(_PayloadDefaults):
    """Errors Δm and Δ(m c) of mass and first moments."""

    name = "another mass at another place"
    equation = "the weight of Δm at the tool side, with Δ(m c)"
    coefficients = (MASS, *MOMENTS)

    def columns(self, tool_side_load: ToolSideLoad) -> Array:
        """Return the change of the readings per kilogram and per kilogram metre.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            (N, D, 4).
        """
        return tool_side_load.columns

    def sizes(self, values: Array, tool_side_load: ToolSideLoad) -> Mapping[str, Quantity]:
        """Return the mass error and the errors of the first moments.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        return {
            "mass": Quantity(float(values[0]), "kg"),
            **_describe_moments(values[0] * tool_side_load.reference_point + values[1:]),
        }


@dataclass(frozen=True)
class CenterOfMassError(_PayloadDefaults):
    """Error Δ(m c) of the first moments with the stated mass."""

    name = "the stated mass at another place"
    equation = "the weight of Δ(m c), Δm = 0, at the tool side"
    coefficients = MOMENTS

    def columns(self, tool_side_load: ToolSideLoad) -> Array:
        """Return the change of the readings per kilogram metre.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            (N, D, 3).
        """
        return tool_side_load.columns[:, :, 1:]

    def sizes(self, values: Array, tool_side_load: ToolSideLoad) -> Mapping[str, Quantity]:
        """Return the shift of the centre of mass and the errors of the first moments.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        shift = 1e3 * float(np.linalg.norm(values)) / tool_side_load.mass
        return {"shift": Quantity(shift, "mm"), **_describe_moments(values)}

    def grid(self, tool_side_load: ToolSideLoad) -> tuple[Shape, ...]:
        """Return one empty shape; none without a stated mass.

        Args:
            tool_side_load: Stated payload and sensitivity of N readings.

        Returns:
            The shapes that a search tries.
        """
        return ((),) if tool_side_load.mass > 0.0 else ()  # a zero mass has no centre of mass


def _describe_moments(h: Array) -> dict[str, Quantity]:
    return {f"moment_{a}": Quantity(float(v), "kg·m") for a, v in zip("xyz", h, strict=True)}


PAYLOAD = Effect(
    name="payload",
    noun="mass or centre of mass",
    short_noun="wrong payload",
    sentence="Mass or centre of mass on the flange are not what the cell says.",
    port="torque",
    places=("tool",),
    payload_laws=(MassDeviation(), MassAndMomentError(), CenterOfMassError()),
    place_wording={"tool": "the tool side"},
)

"""Another load at the flange than the cell states: its mass, its centre of mass, or both.

Weight and inertia of what the tool side carries are linear in its mass and its first moments. A channel says what a
kilogram at one place and a kilogram metre along each axis of the flange do to its readings.
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
    """What these laws share."""

    word = ""
    has_memory = False
    shape: tuple[LawParameter, ...] = ()

    def grid(self, seen: ToolSideLoad) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class MassDeviation(_PayloadDefaults):
    """Δm at the stated centre."""

    name = "another mass at the stated centre"
    equation = "the weight of Δm at the tool side"
    coefficients = (MASS,)

    def columns(self, seen: ToolSideLoad) -> Array:
        return np.asarray(seen.columns @ np.r_[1.0, seen.centre - seen.reference_point][:, None])

    def sizes(self, values: Array, seen: ToolSideLoad) -> Mapping[str, Quantity]:
        return {"mass": Quantity(float(values[0]), "kg"), **_describe_moments(float(values[0]) * seen.centre)}


@dataclass(frozen=True)
class MassAndMomentError(_PayloadDefaults):
    """Δm and Δ(m c), whatever the cell states."""

    name = "another mass at another place"
    equation = "the weight of Δm at the tool side, with Δ(m c)"
    coefficients = (MASS, *MOMENTS)

    def columns(self, seen: ToolSideLoad) -> Array:
        return seen.columns

    def sizes(self, values: Array, seen: ToolSideLoad) -> Mapping[str, Quantity]:
        return {
            "mass": Quantity(float(values[0]), "kg"),
            **_describe_moments(values[0] * seen.reference_point + values[1:]),
        }


@dataclass(frozen=True)
class CenterOfMassError(_PayloadDefaults):
    """Δ(m c) alone: the stated mass."""

    name = "the stated mass at another place"
    equation = "the weight of Δ(m c), Δm = 0, at the tool side"
    coefficients = MOMENTS

    def columns(self, seen: ToolSideLoad) -> Array:
        return seen.columns[:, :, 1:]

    def sizes(self, values: Array, seen: ToolSideLoad) -> Mapping[str, Quantity]:
        shift = 1e3 * float(np.linalg.norm(values)) / seen.mass
        return {"shift": Quantity(shift, "mm"), **_describe_moments(values)}

    def grid(self, seen: ToolSideLoad) -> tuple[Shape, ...]:
        return ((),) if seen.mass > 0.0 else ()  # nothing cannot hang elsewhere


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

"""The tool: a beam from the flange to the TCP, a spring at the TCP, a body of revolution, or cylinders on a sensor.

Matrices stand in axes that turn with the tool, x out of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.effects.beam import Cylinder, stepped
from machopt.effects.bodies import (
    DIAGONAL,
    LEAST_LENGTH,
    MATRIX,
    UNITS,
    Beam,
    Entries,
    Yields,
    stated_law,
)
from machopt.effects.definite import nearest_definite
from machopt.effects.given import Parameters
from machopt.effects.protocol import Body, BodyLaw, Effect, Parameter, Quantity, Shape
from machopt.se3 import normalise, skew

ALONG = 0.999  # cosine between tool axis and line from the flange, from which on they are one
NOTE = "constant in the tool frame"
SENSOR = ("sensor_N_per_mm", "sensor_Nm_per_rad")
SHIFT = Parameter(key="shift", unit=UNITS[0], least=0.0)  # of a body of revolution
TILT = Parameter(key="tilt", unit=UNITS[2], least=0.0)
BOTH = Parameter(key="both", unit=UNITS[1])
TWIST = Parameter(key="twist", unit=UNITS[2], least=0.0)


@dataclass(frozen=True)
class TipBeam(Beam):
    """A beam from the flange to the TCP."""

    keys: tuple[str, ...] = ("EI_Nm2",)

    @property
    def equation(self) -> str:
        return "cantilever from the flange to the TCP"

    def seen(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """A force at its end does not twist it."""
        return self if dimensions == 6 and turning else replace(self, keys=("EI_Nm2",))


@dataclass(frozen=True)
class TipSpring(Entries):
    """A spring at the tip along the axes of the tool; readings of places alone show its shifts alone."""

    pairs: tuple[tuple[int, int], ...] = DIAGONAL
    name: str = "spring at the tool"
    equation: str = "R C Rᵀ w, C diagonal in tool axes"

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"lateral_compliance": Quantity(1e6 * float(np.max(np.abs(values[:3]))), "µm/N")}

    def seen(self, dimensions: int, *, turning: bool) -> BodyLaw:
        return self if dimensions == 6 and turning else replace(self, pairs=DIAGONAL[:3])


@dataclass(frozen=True)
class TipMatrix(Entries):
    """Any symmetric compliance at the tip; of what the loads and readings can show."""

    equation: str = "R C Rᵀ w at the TCP, C symmetric"
    note: str = NOTE

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        sideways = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL[1:3]]
        tilts = [abs(float(v)) for pair, v in zip(self.pairs, values, strict=True) if pair in DIAGONAL[4:]]
        tilt = {"tilt_compliance": Quantity(max(tilts), UNITS[2])} if tilts else {}
        return {"lateral_compliance": Quantity(1e6 * max(sideways), "µm/N"), **tilt}

    def seen(self, dimensions: int, *, turning: bool) -> BodyLaw:
        # where moments or turning are missing no reading holds the tilts, and any of them makes any coupling possible
        if dimensions == 6 and turning:
            return self
        return replace(self, pairs=tuple(p for p in self.pairs if max(p) < 3))


@dataclass(frozen=True)
class Round(Yields):
    """A body of revolution seen from the TCP: lateral shift, tilt, what couples them, and the twist about its axis."""

    line: bool  # about the line from the flange to the TCP; else about the tool's axis
    note = NOTE
    equation = "R C Rᵀ w at the TCP, C of a body of revolution"
    coefficients: tuple[Parameter, ...] = (SHIFT, TILT, BOTH)

    @property
    def name(self) -> str:
        said = "bends about the line from flange to TCP" if self.line else "round, bends and tilts"
        return f"{said}, twists" if TWIST in self.coefficients else said

    def seen(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Places under forces show its shift alone; a twist is turned by a moment."""
        shown = 4 if dimensions == 6 and turning else 3 if dimensions == 6 or turning else 1
        return replace(self, coefficients=self.coefficients[:shown])

    def matrices(self, shape: Array, body: Body) -> Array:
        made = np.zeros((4, 6, 6))
        made[0, 1, 1] = made[0, 2, 2] = made[1, 4, 4] = made[1, 5, 5] = 1.0
        made[2, 1, 5] = made[2, 5, 1] = 1.0
        made[2, 2, 4] = made[2, 4, 2] = -1.0
        made[3, 3, 3] = 1.0
        made = made[: len(self.coefficients)]
        if not self.line:
            return made
        turn = np.kron(np.eye(2), _about(_line(body)))
        return np.asarray(turn @ made @ turn.T)

    def stated(self, values: Array, shape: Array, body: Body) -> dict[str, Any]:
        return {MATRIX: np.einsum("p,pij->ij", values, self.matrices(shape, body)).tolist()}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        tilt = {"tilt_compliance": Quantity(abs(float(values[1])), UNITS[2])} if len(values) > 1 else {}
        return {"lateral_compliance": Quantity(1e6 * abs(float(values[0])), "µm/N"), **tilt}

    def nearest(self, values: Array, metric: Array) -> Array:
        return nearest_definite(values, ((0, 0), (1, 1), (0, 1), (2, 2))[: len(values)], metric)

    def grid(self, body: Body) -> tuple[Shape, ...]:
        if not self.line:
            return ((),)
        line, length = _line(body), float(np.linalg.norm(_line(body)))
        return () if length < LEAST_LENGTH or abs(line[0]) > ALONG * length else ((),)


@dataclass(frozen=True)
class Stack(Yields):
    """Stepped cylinders and a force sensor at the flange, whose compliance at the TCP is known but for a scale."""

    fixed: Array = field(compare=False)  # (6, 6) at the TCP, axes of the tool
    given: Mapping[str, Any] = field(compare=False)  # as the file states them
    name = "cylinders from flange to tip"
    equation = "tian2025 eqs. 2–3, with lever arms"
    coefficients = (Parameter(key="scale", unit="1", least=0.0),)

    def matrices(self, shape: Array, body: Body) -> Array:
        return self.fixed[None]

    def stated(self, values: Array, shape: Array, body: Body) -> dict[str, Any]:
        return {**self.given, "scale": float(values[0])}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"scale": Quantity(float(values[0]), "1")}


def _line(body: Body) -> Array:
    """(3,) m from the flange to the TCP, axes of the tool."""
    assert body.root is not None  # a tool begins at its flange
    return np.asarray(-body.root[:3, 3])


def _about(line: Array) -> Array:
    """(3, 3) axes whose x is along the line; which way y points makes no difference to a body of revolution."""
    x = normalise(line)
    y = normalise(np.cross(np.eye(3)[int(np.abs(x).argmin())], x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _reads(given: Parameters, body: Body) -> tuple[BodyLaw, Array, Array, Body]:
    if not given.has("cylinders"):
        return stated_law(given, body)
    fixed, stated = _stack(given, body)
    return Stack(fixed, stated), np.array([given.number("scale", 1.0)]), np.empty(0), body


def _stack(given: Parameters, body: Body) -> tuple[Array, dict[str, Any]]:
    """Stepped cylinders (tian2025 eqs. 2–3, with lever arms) and a force sensor at the flange, seen from the TCP."""
    stated: dict[str, Any] = {"cylinders": given.mappings("cylinders")}
    steps = []
    for n, entry in enumerate(stated["cylinders"]):
        one = given.inner(f"cylinders[{n}]", entry)
        bore = one.number("bore_mm", 0.0, positive=False) / 1e3
        step = Cylinder(
            one.number("diameter_mm") / 1e3,
            one.number("length_mm") / 1e3,
            one.number("youngs_GPa") * 1e9,
            one.number("poisson", 0.3),
            bore,
        )
        one.finish()
        if not 0 <= bore < step.diameter:
            raise one.error("bore_mm", "expected at least 0 and less than the diameter")
        steps.append(step)
    C = stepped(steps)
    asked = [given.has(key) for key in SENSOR]  # both, so that neither is an unknown key
    if any(asked):
        # the sensor sits at the flange, its axes are the flange's
        linear = given.array(SENSOR[0], (3,), np.full(3, np.inf)) * 1e3
        angular = given.array(SENSOR[1], (3,), np.full(3, np.inf))
        for key, values in zip(SENSOR, (linear, angular), strict=True):
            if not (values > 0).all():
                raise given.error(key, "expected three stiffnesses above zero")
            if np.isfinite(values).all():
                stated[key] = (values / (1e3 if key.endswith("mm") else 1.0)).tolist()
        assert body.root is not None  # a tool begins at its flange
        turn, G = np.kron(np.eye(2), body.root[:3, :3]), np.eye(6)
        G[:3, 3:] = -skew(-body.root[:3, 3])
        C = C + G @ turn @ np.diag(np.concatenate([1.0 / linear, 1.0 / angular])) @ turn.T @ G.T
    return C, stated


EFFECT = Effect(
    name="tool_compliance",
    noun="compliance",
    spoken="tool compliance",
    sentence="Flange, force sensor, spindle or holder bend behind the tool tip.",
    port="body",
    places=("tool",),
    gives=(
        TipBeam(),
        TipBeam(("EI_Nm2", "GJ_Nm2")),
        TipSpring(),
        Round(line=False),
        Round(line=True),
        Round(line=False, coefficients=(SHIFT, TILT, BOTH, TWIST)),
        Round(line=True, coefficients=(SHIFT, TILT, BOTH, TWIST)),
        TipMatrix(),
    ),
    reads=_reads,
    elastic=True,
)

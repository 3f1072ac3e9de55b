"""What a record of loads and displacements has wrong while the arm is right: zero, gain and axes of the force, axes
of the displacement, where and in which direction the load really pulled.

A law says what acts beyond what is recorded, per unit of each coefficient: of a wrench, which moves the arm through the
compliance found so far, or of the displacement itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.effects.protocol import DEGREE, EXACT, Effect, Parameter, Quantity, Recorded, Shape
from machopt.se3 import moved_frame

FORCE = "sensor:force"
XYZ = "xyz"


def _along(name: str, unit: str, factor: float = 1.0) -> tuple[Parameter, ...]:
    return tuple(Parameter(key=f"{name}_{a}", unit=unit, factor=factor) for a in XYZ)


class _Law:
    """What most of these laws answer."""

    word = ""
    remembers = False
    moves = "wrench"
    shape: tuple[Parameter, ...] = ()

    def grid(self) -> tuple[Shape, ...]:
        return ((),)


@dataclass(frozen=True)
class Offset(_Law):
    """The force has another zero."""

    name = "zero of the force"
    equation = "w_recorded = w + b, b constant in the sensor"
    coefficients = _along("offset", "N")

    def columns(self, shape: Array, seen: Recorded) -> Array:
        return np.concatenate([-seen.axes, np.zeros_like(seen.axes)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"offset": Quantity(float(np.linalg.norm(values)), "N"), **_vector("offset", values, "N")}


@dataclass(frozen=True)
class Gain(_Law):
    """One axis of the force reads a share too much; the coefficient is the share of what is recorded."""

    name = "gain of one axis"
    equation = "f_k recorded = (1 + g) f_k"
    coefficients = (Parameter(key="too_much", unit="1"),)
    shape = (Parameter(key="axis", unit="1"),)  # 0, 1, 2

    def columns(self, shape: Array, seen: Recorded) -> Array:
        e = seen.axes[:, :, int(shape[0])]
        part = -e * np.einsum("nc,nc->n", e, seen.wrench[:, :3])[:, None]
        return np.concatenate([part, np.zeros_like(part)], axis=1)[:, :, None]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        x = float(values[0])
        gain = abs(x / (1.0 - x)) if x < 0.9 else 9.0  # |g| of f_recorded = (1 + g) f
        return {"gain": Quantity(100.0 * gain, "%"), "axis": Quantity(float(shape[0]) + 1.0, "")}

    def grid(self) -> tuple[Shape, ...]:
        return ((0.0,), (1.0,), (2.0,))


@dataclass(frozen=True)
class Bent(_Law):
    """The line of one axis of the force is none: what it reads too much grows with the load."""

    name = "gain that grows with the load"
    equation = "f_k recorded = f_k (1 + g f_k), or f_k (1 + g |f_k|) where both sides bend alike"
    coefficients = (Parameter(key="too_much_per_N", unit="1/N"),)
    shape = (Parameter(key="axis", unit="1"), Parameter(key="alike", unit="1"))  # 0, 1, 2; 0 or 1

    def columns(self, shape: Array, seen: Recorded) -> Array:
        e = seen.axes[:, :, int(shape[0])]
        f = np.einsum("nc,nc->n", e, seen.wrench[:, :3])
        part = -e * (f * (np.abs(f) if shape[1] else f))[:, None]
        return np.concatenate([part, np.zeros_like(part)], axis=1)[:, :, None]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        gain = 1e5 * abs(float(values[0]))  # % a kN, to first order
        return {"gain_growth": Quantity(gain, "%/kN"), "axis": Quantity(float(shape[0]) + 1.0, "")}

    def grid(self) -> tuple[Shape, ...]:
        return tuple((axis, alike) for alike in (0.0, 1.0) for axis in (0.0, 1.0, 2.0))


@dataclass(frozen=True)
class Turned(_Law):
    """The axes of the force or of the displacement are turned against those that the record states."""

    moves: str = "wrench"
    name = "axes turned"
    coefficients = _along("about", "rad", DEGREE)

    @property
    def equation(self) -> str:
        if self.moves == "displacement":
            return "δ_recorded = (I + [φ]×) δ"
        return "w_recorded = (I + [φ]×) w: C w breaks Maxwell reciprocity"

    def columns(self, shape: Array, seen: Recorded) -> Array:
        of, sign = (seen.wrench, -1.0) if self.moves == "wrench" else (seen.displacement, 1.0)
        halves = range(0, of.shape[1], 3)
        turned = [
            np.concatenate([np.cross(seen.axes[:, :, k], of[:, a : a + 3]) for a in halves], axis=1) for k in range(3)
        ]
        return sign * np.stack(turned, axis=2)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(values))), "deg"),
            **_vector("about", np.degrees(values), "deg"),
        }


@dataclass(frozen=True)
class Hook(_Law):
    """The load acted beside the TCP."""

    name = "hook beside the TCP"
    equation = "m = m_recorded + r × f, r constant in the tool"
    coefficients = _along("offset", "m", 1e-3)

    def columns(self, shape: Array, seen: Recorded) -> Array:
        f = seen.wrench[:, :3]
        moment = np.stack([np.cross(seen.tool[:, :, k], f) for k in range(3)], axis=2)
        return np.concatenate([np.zeros_like(moment), moment], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return _offset(values)


@dataclass(frozen=True)
class Elsewhere(_Law):
    """Load and target sit at another point of the tool than the cell's TCP: its length is another one."""

    name = "TCP elsewhere in the tool"
    equation = "m = m_recorded + r × f and δ_recorded = δ + θ × r, r constant in the tool"
    moves = "point"
    coefficients = _along("offset", "m", 1e-3)

    def columns(self, shape: Array, seen: Recorded) -> Array:
        return np.concatenate([seen.tool, np.zeros_like(seen.tool)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return _offset(values)


@dataclass(frozen=True)
class Askew(_Law):
    """The load pulled in another direction than recorded, by as much."""

    name = "pull askew"
    equation = "f along e + u instead of e, u constant in base_link"
    coefficients = _along("askew", "rad", DEGREE)

    def columns(self, shape: Array, seen: Recorded) -> Array:
        f = seen.wrench[:, :3]
        size = np.linalg.norm(f, axis=1, keepdims=True)
        e = np.divide(f, size, out=np.zeros_like(f), where=size > 0)
        across = size[:, :, None] * (np.eye(3) - e[:, :, None] * e[:, None, :])
        return np.concatenate([across, np.zeros_like(across)], axis=1)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {"angle": Quantity(float(np.degrees(np.linalg.norm(values))), "deg")}


@dataclass(frozen=True)
class Stands(_Law):
    """The tracker stands elsewhere in base_link than the record says, by a shift and a small turn."""

    name = "the tracker's frame stands elsewhere"
    equation = "p = T p_recorded, T a shift and a small turn about the middle of the points"
    moves = "position"
    coefficients = (*_along("shift", "m", 1e-3), *_along("about", "rad", DEGREE))

    def columns(self, shape: Array, seen: Recorded) -> Array:
        assert seen.position is not None  # of poses
        return moved_frame(seen.position, seen.position.mean(axis=0))[:, : seen.displacement.shape[1]]

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(values[3:]))), "deg"),
            "shift": Quantity(1e3 * float(np.linalg.norm(values[:3])), "mm"),
        }


def _offset(values: Array) -> dict[str, Quantity]:
    """Of metres."""
    return {"offset": Quantity(1e3 * float(np.linalg.norm(values)), "mm"), **_vector("offset", 1e3 * values, "mm")}


def _vector(name: str, x: Array, unit: str) -> dict[str, Quantity]:
    return {f"{name}_{a}": Quantity(float(v), unit) for a, v in zip(XYZ, x, strict=True)}


OFFSET = Effect(
    name="force_sensor_offset",
    noun="zero offset",
    spoken="zero of the force sensor",
    sentence="The force sensor shows a load where none acts.",
    port="record",
    places=(FORCE,),
    recorded=(Offset(),),
    form=EXACT,
)

GAIN = Effect(
    name="force_sensor_gain",
    noun="gain",
    spoken="gain of the force sensor",
    sentence="The force sensor reads a share too much or too little.",
    port="record",
    places=(FORCE,),
    recorded=(Gain(), Bent()),
    form=EXACT,
    plausible={"%": 60.0},
)

FRAME = Effect(
    name="force_sensor_frame",
    noun="misalignment",
    spoken="axes of the force sensor",
    sentence="The force sensor's axes are turned against the recorded frame.",
    port="record",
    places=(FORCE,),
    recorded=(Turned(),),
    form=EXACT,
    plausible={"deg": 25.0},
)

DISPLACEMENT = Effect(
    name="displacement_frame",
    noun="misalignment",
    spoken="axes of the displacement",
    sentence="The measured displacements are turned against the recorded frame.",
    port="record",
    places=("sensor:displacement",),
    recorded=(Turned("displacement"), Stands()),
    form=EXACT,
    plausible={"deg": 25.0},
)

LOAD = Effect(
    name="load_geometry",
    noun="load geometry",
    spoken="where or which way the load acted",
    sentence="The load acted elsewhere, or in another direction, than recorded.",
    port="record",
    places=(FORCE,),
    recorded=(Hook(), Askew(), Elsewhere()),
    form=EXACT,
    plausible={"deg": 25.0, "mm": 1000.0},
    of="",
)

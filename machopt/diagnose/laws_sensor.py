"""What a record may have wrong while the robot is right: zero, gain and axes of the force, axes of the displacement,
where and in which direction the load really pulled.

Errors of the load act on the displacement through the compliance found so far: recorded w = acting w + error, hence
δ = C (w_recorded − error).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.problem import Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.readings import Readings

Array = NDArray[np.float64]
FORCE = "sensor:force"


def force_sensor(r: Readings) -> list[Hypothesis]:
    """Zero, gain of one axis, and a turn of the force sensor, in the axes that the record states."""
    f, m = r.wrench[:, :3], r.wrench[:, 3:]
    R = r.state.T_base_tool[:, :3, :3]
    axes = R if r.recording.wrench_frame == "tool" else np.broadcast_to(np.eye(3), R.shape)
    zero = np.zeros_like(f)

    def offset(shape: Shape) -> Array:
        return np.stack([-r.through(np.concatenate([axes[:, :, k], zero], axis=1)) for k in range(3)], axis=2)

    def gain(shape: Shape) -> Array:
        k = int(shape[0])
        e = axes[:, :, k]
        return -r.through(np.concatenate([e * np.einsum("nc,nc->n", e, f)[:, None], zero], axis=1))[:, :, None]

    def frame(shape: Shape) -> Array:
        turned = [np.concatenate([np.cross(axes[:, :, k], f), np.cross(axes[:, :, k], m)], axis=1) for k in range(3)]
        return np.stack([-r.through(w) for w in turned], axis=2)

    def angle(x: Array) -> Mapping[str, Quantity]:
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(x))), "deg"),
            **_vector("about", np.degrees(x), "deg"),
        }

    return [
        _record(
            "force_sensor_offset",
            FORCE,
            "zero of the force",
            "w_recorded = w + b, b constant in the sensor",
            offset,
            lambda x, s: {"offset": Quantity(float(np.linalg.norm(x)), "N"), **_vector("offset", x, "N")},
        ),
        _record(
            "force_sensor_gain",
            FORCE,
            "gain of one axis",
            "f_k recorded = (1 + g) f_k",
            gain,
            lambda x, s: {"gain": Quantity(100.0 * _gain(float(x[0])), "%"), "axis": Quantity(s[0] + 1.0, "")},
            ((0.0,), (1.0,), (2.0,)),
        ),
        _record(
            "force_sensor_frame",
            FORCE,
            "axes turned",
            "w_recorded = (I + [φ]×) w: C w breaks Maxwell reciprocity",
            frame,
            lambda x, s: angle(x),
        ),
    ]


def _gain(x: float) -> float:
    """|g| of f_recorded = (1 + g) f, from the share x of the recorded force that is too much."""
    return abs(x / (1.0 - x)) if x < 0.9 else 9.0


def displacement_frame(r: Readings) -> list[Hypothesis]:
    """Axes of the displacement turned against those of the robot."""
    d = r.through(r.wrench)
    R = r.state.T_base_tool[:, :3, :3]
    axes = R if r.recording.displacement_frame == "tool" else np.broadcast_to(np.eye(3), R.shape)

    def turned(shape: Shape) -> Array:
        parts = [
            np.concatenate([np.cross(axes[:, :, k], d[:, a : a + 3]) for a in range(0, r.dimensions, 3)], axis=1)
            for k in range(3)
        ]
        return np.stack(parts, axis=2)

    return [
        _record(
            "displacement_frame",
            "sensor:displacement",
            "axes turned",
            "δ_recorded = (I + [φ]×) δ",
            turned,
            lambda x, s: {
                "angle": Quantity(float(np.degrees(np.linalg.norm(x))), "deg"),
                **_vector("about", np.degrees(x), "deg"),
            },
        )
    ]


def load_geometry(r: Readings) -> list[Hypothesis]:
    """The load acted beside the TCP, or pulled in another direction than recorded."""
    f = r.wrench[:, :3]
    R, zero = r.state.T_base_tool[:, :3, :3], np.zeros_like(f)
    size = np.linalg.norm(f, axis=1, keepdims=True)
    e = np.divide(f, size, out=np.zeros_like(f), where=size > 0)

    def beside(shape: Shape) -> Array:
        return np.stack([r.through(np.concatenate([zero, np.cross(R[:, :, k], f)], axis=1)) for k in range(3)], axis=2)

    def askew(shape: Shape) -> Array:
        parts = []
        for k in range(3):
            u = np.broadcast_to(np.eye(3)[k], f.shape)
            across = size * (u - np.einsum("nc,nc->n", u, e)[:, None] * e)
            parts.append(r.through(np.concatenate([across, zero], axis=1)))
        return np.stack(parts, axis=2)

    return [
        _record(
            "load_geometry",
            FORCE,
            "hook beside the TCP",
            "m = m_recorded + r × f, r constant in the tool",
            beside,
            lambda x, s: {"offset": Quantity(1e3 * float(np.linalg.norm(x)), "mm"), **_vector("offset", 1e3 * x, "mm")},
        ),
        _record(
            "load_geometry",
            FORCE,
            "pull askew",
            "f along e + u instead of e, u constant in base_link",
            askew,
            lambda x, s: {"angle": Quantity(float(np.degrees(np.linalg.norm(x))), "deg")},
        ),
    ]


def _vector(name: str, x: Array, unit: str) -> dict[str, Quantity]:
    return {f"{name}_{a}": Quantity(float(v), unit) for a, v in zip("xyz", x, strict=True)}


def _record(
    effect: str,
    where: str,
    law: str,
    equation: str,
    columns: Callable[[Shape], Array],
    sizes: Callable[[Array, Shape], Mapping[str, Quantity]],
    shapes: tuple[Shape, ...] = ((),),
) -> Hypothesis:
    def correction(x: Array, shape: Shape) -> RecordCorrection:
        return RecordCorrection(effect, where, {k: q.value for k, q in sizes(x, shape).items()})

    return Hypothesis(
        effect,
        where,
        law,
        equation,
        columns,
        sizes,
        shapes,
        correction=correction,
        family="sensor",
        note="in the record, not in the robot",
    )

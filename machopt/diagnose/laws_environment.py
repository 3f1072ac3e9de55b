"""What acts on an arm from outside without being a load test: weight at the flange, the balancer, the frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose import at_heat
from machopt.diagnose.problem import Curve, Hypothesis, Quantity, RecordCorrection, Shape
from machopt.diagnose.readings import Readings
from machopt.effects.compensator import EFFECT, HARMONIC, LINKAGE
from machopt.effects.protocol import Beside

Drive = Callable[[Array, Shape], Array]


def compensator(r: Readings) -> list[Hypothesis]:
    """The balancer of joint 2: its torque bends the joint, whatever the load."""
    q, c = r.state.q[:, 1], float(r.compliance[1])
    if r.masses is None or c <= 0.0 or np.ptp(q) < np.radians(15.0):
        return []
    along = np.linspace(q.min(), q.max(), 90)

    out = []
    for own, equation, penalty in (
        (LINKAGE, "Δ₂ = c₂ τ, τ = −(F₀ + k s) ds/dq, s² = a² + L² + 2aL cos(α + q₂)", 4.0),
        (HARMONIC, "Δ₂ = c₂ (A cos q₂ + B sin q₂)", 0.0),
    ):

        def drive(at: Array, shape: Shape, own: Beside = own) -> Array:
            return own.torque(np.array(shape), at)

        def sizes(x: Array, shape: Shape, drive: Drive = drive) -> Mapping[str, Quantity]:
            return {"peak_torque": Quantity(float(np.abs(drive(along, shape) @ x).max()), "N·m")}

        def curve(x: Array, shape: Shape, drive: Drive = drive) -> Curve:
            return Curve(
                np.degrees(along),
                drive(along, shape) @ x,
                "joint 2 in deg",
                "torque in N·m",
                np.degrees(q),
                drive(q, shape) @ x,
            )

        out.append(
            Hypothesis(
                EFFECT.name,
                "joint:2",
                own.name,
                f"{equation} (Klimchik et al. arXiv 1311.6810)",
                lambda s, drive=drive: r.lift(1, c * drive(q, s)),  # type: ignore[misc]
                sizes,
                own.grid(),
                family="joint",
                note="joint 2 only, by its angle",
                penalty=penalty,
                curve=curve,
            )
        )
    return out


def frame(r: Readings) -> list[Hypothesis]:
    """Where the recording says that the tracker stands in base_link and it does not."""
    columns = at_heat.stand(r)

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "angle": Quantity(float(np.degrees(np.linalg.norm(x[3:]))), "deg"),
            "shift": Quantity(1e3 * float(np.linalg.norm(x[:3])), "mm"),
        }

    return [
        Hypothesis(
            "displacement_frame",
            "sensor:displacement",
            "the tracker's frame stands elsewhere",
            "p = T p_recorded, T a shift and a small turn about the middle of the points",
            lambda s: columns,
            sizes,
            correction=lambda x, s: RecordCorrection(
                "displacement_frame", "sensor:displacement", {k: v.value for k, v in sizes(x, s).items()}
            ),
            family="sensor",
            note="in the record, not in the robot",
        )
    ]

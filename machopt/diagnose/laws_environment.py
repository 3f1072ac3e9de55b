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


def payload(r: Readings) -> list[Hypothesis]:
    """Another mass at the flange than the cell states, seen by how far the joints' springs give."""
    if r.masses is None:
        return []
    own = r.masses.body == 6
    flange = r.robot.T_base_flange_zero
    carried = float(r.masses.mass[own].sum())
    centre = r.masses.mass[own] @ r.masses.com[own] / carried if carried > 0.0 else flange[:3, 3]
    at = flange[:3, :3].T @ (centre - flange[:3, 3])  # (3,) m in flange
    weight = _flange_weight(r)  # (N, D, 4) per kg at the flange's origin, per kg·m along its axes
    cause = "J c Jᵀ w of the weight of Δm at the tool side, c as the base has it"

    def full(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "mass": Quantity(float(x[0]), "kg"),
            **{f"moment_{a}": Quantity(float(v), "kg·m") for a, v in zip("xyz", x[1:], strict=True)},
        }

    def shifted(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        return {
            "shift": Quantity(1e3 * float(np.linalg.norm(x)) / carried, "mm"),
            **{f"moment_{a}": Quantity(float(v), "kg·m") for a, v in zip("xyz", x, strict=True)},
        }

    where, note = "tool", "with gravity: as the joints' compliance, but shaped by the flange's weight alone"
    out = [
        Hypothesis(
            "payload",
            where,
            "another mass at the stated centre",
            cause,
            lambda s: weight @ np.r_[1.0, at][:, None],
            lambda x, s: {"mass": Quantity(float(x[0]), "kg")},
            family="environment",
            note=note,
        ),
        Hypothesis(
            "payload",
            where,
            "another mass at another place",
            f"{cause}, with Δ(m·com)",
            lambda s: weight,
            full,
            family="environment",
            note=note,
        ),
    ]
    if carried > 0.0:
        out.append(
            Hypothesis(
                "payload",
                where,
                "the stated mass at another place",
                f"{cause}, Δm = 0",
                lambda s: weight[:, :, 1:],
                shifted,
                family="environment",
                note=note,
            )
        )
    return out


def _flange_weight(r: Readings) -> Array:
    assert r.masses is not None  # payload asks
    T = r.state.T_base_tool
    R = T[:, :3, :3] @ r.T_flange_tcp[:3, :3].T
    arm = -np.einsum("nij,j->ni", R, r.T_flange_tcp[:3, 3])  # flange as seen from the TCP
    g = np.broadcast_to(r.masses.gravity, arm.shape)
    zero = np.zeros_like(arm)
    parts = [np.concatenate([g, np.cross(arm, g)], axis=1)]
    parts += [np.concatenate([zero, np.cross(R[:, :, k], g)], axis=1) for k in range(3)]
    return np.stack([r.through(w) for w in parts], axis=2)


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

"""The spring that balances joint 2: between two pivots, so that its torque and its slope change with q2.

Length s² = a² + L² + 2 a L cos(α + q₂), force F₀ + k s, torque −F ds/dq.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from machopt.arrays import Array
from machopt.diagnose.problem import Hypothesis, Quantity, Shape
from machopt.diagnose.readings import Readings
from machopt.domain.stiffness import Term
from machopt.effects import files
from machopt.effects.compensator import EFFECT, LINKAGE
from machopt.identify.noise import joint_sensitivity


def apparent(r: Readings) -> list[Hypothesis]:
    """In load tests: a spring beside the gear, k₂(q₂) = k₂ − ∂τ_spring/∂q."""
    q, tau, c = r.state.q[:, 1], r.load_torque[:, 1], r.compliance[1]
    if c <= 0 or np.ptp(q) < np.radians(15.0):
        return []

    # the spring also moves the arm at rest, and with it every lever arm of the load
    moved = joint_sensitivity(r.state.J, r.wrench, r.compliance)[:, : r.dimensions, 1]

    def columns(shape: Shape) -> Array:
        torque, slope = (of(np.array(shape), q) for of in (LINKAGE.torque, LINKAGE.slope))
        return np.asarray(r.lift(1, c**2 * tau[:, None] * slope) + moved[:, :, None] * (c * torque)[:, None, :])

    def sizes(x: Array, shape: Shape) -> Mapping[str, Quantity]:
        slope = LINKAGE.slope(np.array(shape), np.linspace(q.min(), q.max(), 60))
        return {
            "variation": Quantity(50.0 * float(np.ptp(slope @ x)) * c, "%"),
            "force_times_length": Quantity(float(x[0]), "N·m"),
            "rate_times_length_squared": Quantity(float(x[1]), "N·m"),
        }

    def correction(x: Array, s: Shape) -> Term:
        return Term(EFFECT.name, "joint:2", files.write(LINKAGE, x, np.array(s)))

    return [
        Hypothesis(
            EFFECT.name,
            "joint:2",
            LINKAGE.name,
            "k₂(q₂) = k₂ + d²U/dq², U of a spring F₀ + k s, s² = a² + L² + 2aL cos(α + q₂)",
            columns,
            sizes,
            LINKAGE.grid(),
            correction=correction,
            family="joint",
            note="joint 2 only, by its angle",
            penalty=4.0,
        )
    ]

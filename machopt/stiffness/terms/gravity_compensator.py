"""The spring that balances joint 2, as an apparent spring beside its gear.

Between two pivots s apart, s² = a² + L² + 2 a L cos(α + q₂), with the force F₀ + k s it gives the torque
τ_s = −(F₀ + k s) ds/dq on joint 2. A process force turns the joint by δ, which changes τ_s, so the gear and the spring
share the load: (k₂ − ∂τ_s/∂q) δ = τ. The lengths come as the ratio a/L; F₀ L and k L² are torques.

What τ_s does without a load, a posture some hundredths of a degree beside the encoder's, counts as little as that of
weight, which it mostly cancels: a plan knows neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.data_types.stiffness import StiffnessTerm
from machopt.effects import parameter_conversion
from machopt.effects.joint.gravity_compensator import EFFECT, LINKAGE
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.errors import InputError
from machopt.kinematics.robot import ArmState
from machopt.numerics.array_types import Array
from machopt.stiffness.terms.protocol import DefaultTerm, LinearTerm, LoadedArm, TermCoefficient

MIN_PIVOT_DISTANCE = 1e-3  # of L: pivots that come nearer than this to each other hold no spring


@dataclass(frozen=True, kw_only=True)
class GravityCompensator(DefaultTerm):
    """Stiffness beside joint 2: −∂τ_s/∂q = F₀ L s'' + k L² (s'² + s s''), s in units of L."""

    location: str
    ratio: float  # a/L
    alpha: float  # rad
    values: Array  # (2,) N·m: F₀ L and k L²
    gear: Callable[[ArmState], Array] | None = field(default=None, compare=False)  # (M, 6) N·m/rad of the joints
    effect: str = EFFECT.name
    coefficients: tuple[TermCoefficient, ...] = tuple(
        TermCoefficient(*c) for c in parameter_conversion.list_coefficient_names(LINKAGE, 2)
    )

    @property
    def parallel_joint(self) -> int:
        return 1

    @property
    def _shape(self) -> Array:
        return np.array([self.ratio, self.alpha])

    @property
    def missing_keys(self) -> tuple[str, ...]:
        """Keys of the file without which the spring has no place."""
        return tuple(key for key, v in (("ratio", self.ratio), ("angle_deg", self.alpha)) if not np.isfinite(v))

    def compute_parallel_stiffness(self, q2: Array) -> Array:
        """Stiffness (...,) N·m/rad beside the gear at joint angles q2 (...,) rad; negative where it takes some away."""
        return np.asarray(-LINKAGE.slope(self._shape, q2) @ self.values)

    def compute_response(self, state: ArmState, wrench: Array) -> Array:
        """What the spring adds to the twist of the gear alone (M, 6, 2), shared out between its two coefficients.

        τ/(k₂ + x·A) − τ/k₂ = −x·A τ/(k₂ (k₂ + x·A)), A the stiffness per unit of each coefficient.

        Raises:
            InputError: the gear's own stiffness is not known here.
        """
        if self.gear is None or self.missing_keys:
            raise InputError(
                "gravity_compensator at joint:2 is a spring beside the gear, which must be known first; without the "
                "term, or with the balancer in machopt diagnose, this would work",
                where="terms",
            )
        column, q2 = state.J[..., :, self.parallel_joint], state.q[..., self.parallel_joint]
        per = -LINKAGE.slope(self._shape, q2)
        k = self.gear(state)[..., self.parallel_joint]
        load = np.einsum("...c,...c->...", column, wrench)
        turned = -per * (load / (k * (k + per @ self.values)))[..., None]
        return np.asarray(column[..., :, None] * turned[..., None, :])

    def compute_response_under_weight(
        self, state: ArmState, wrench: Array, weight: Array | None, *, small: bool
    ) -> Array:
        return np.zeros((len(wrench), 6, len(self.coefficients)))

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        return np.asarray(self.compute_response(under.state, wrench) @ self.values)

    def combine_coefficients(self) -> LinearTerm | None:
        return None

    def with_joint_stiffness(self, gears: Callable[[ArmState], Array]) -> LinearTerm:
        return replace(self, gear=gears)

    def with_values(self, values: Array) -> LinearTerm:
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> StiffnessTerm:
        return StiffnessTerm(
            self.effect, self.location, parameter_conversion.write_law_parameters(LINKAGE, self.values, self._shape)
        )


def build_gravity_compensator(parameters: ParameterReader, location: str) -> LinearTerm:
    """The balancer from a file."""
    values, (ratio, alpha), _ = parameter_conversion.read_law_parameters(LINKAGE, parameters)
    if abs(ratio - 1.0) < MIN_PIVOT_DISTANCE:
        raise parameters.build_error(
            "ratio", f"found {ratio:g}; with 1 the pivots meet at some angle, anything else would work"
        )
    return GravityCompensator(location=location, ratio=float(ratio), alpha=float(alpha), values=values)

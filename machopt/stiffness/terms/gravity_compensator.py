"""Gravity compensator: the balancing spring of joint 2, as an apparent spring parallel to its gear.

Between two pivots s apart, s² = a² + L² + 2 a L cos(α + q₂), the force F₀ + k s gives the torque
τ_s = −(F₀ + k s) ds/dq on joint 2. A process force rotates the joint by δ, which changes τ_s, so the gear and the
spring
share the load: (k₂ − ∂τ_s/∂q) δ = τ. The lengths are given as the ratio a/L; F₀ L and k L² are torques.

The effect of τ_s without a load, a deviation of some hundredths of a degree from the encoder angle, is neglected like
that of weight, which it mostly cancels.
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
from machopt.stiffness.terms.term_interface import DefaultTerm, LinearTerm, LoadedArm, TermCoefficient

MIN_PIVOT_DISTANCE = 1e-3  # of L: minimum distance of the pivots of a spring


@dataclass(frozen=True, kw_only=True)
class GravityCompensator(DefaultTerm):
    """Stiffness parallel to joint 2: −∂τ_s/∂q = F₀ L s'' + k L² (s'² + s s''), s in units of L."""

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
        """Missing keys of the file that define the geometry of the spring."""
        return tuple(key for key, v in (("ratio", self.ratio), ("angle_deg", self.alpha)) if not np.isfinite(v))

    def compute_parallel_stiffness(self, q2: Array) -> Array:
        """Return the stiffness (...,) in N·m/rad parallel to the gear; negative where it reduces the stiffness.

        Args:
            q2: (...,) rad, angle of joint 2.
        """
        return np.asarray(-LINKAGE.slope(self._shape, q2) @ self.values)

    def compute_response(self, state: ArmState, wrench: Array) -> Array:
        """Return the spring's contribution to the twist of the gear alone (M, 6, 2), divided between its two
        coefficients.

        τ/(k₂ + x·A) − τ/k₂ = −x·A τ/(k₂ (k₂ + x·A)), A the stiffness per unit of each coefficient.

        Args:
            state: M configurations.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.

        Raises:
            InputError: the gear's own stiffness is not known here.
        """
        if self.gear is None or self.missing_keys:
            raise InputError(
                "gravity_compensator at joint:2 is a spring parallel to the gear, whose stiffness must be known "
                "first; without the "
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
        """Return zeros (M, 6, 2): the spring counts in the stiffness of its joint.

        Args:
            state: not used.
            wrench: (M, 6) N, N·m at the TCP.
            weight: not used.
            small: not used.
        """
        return np.zeros((len(wrench), 6, len(self.coefficients)))

    def compute_twist(self, under: LoadedArm, wrench: Array, *, small: bool) -> Array:
        """Return the (M, 6) twist in m, rad that the spring adds to that of the gear.

        Args:
            under: state of the arm.
            wrench: (M, 6) N, N·m at the TCP in base_link axes.
            small: not used.
        """
        return np.asarray(self.compute_response(under.state, wrench) @ self.values)

    def combine_coefficients(self) -> LinearTerm | None:
        return None

    def with_joint_stiffness(self, gears: Callable[[ArmState], Array]) -> LinearTerm:
        """Return the same term for an arm with given joint stiffness.

        Args:
            gears: returns (M, 6) N·m/rad of an arm state.
        """
        return replace(self, gear=gears)

    def with_values(self, values: Array) -> LinearTerm:
        """Return the same term with other coefficients.

        Args:
            values: (2,) N·m.
        """
        return replace(self, values=np.asarray(values, float))

    def to_file(self) -> StiffnessTerm:
        return StiffnessTerm(
            self.effect, self.location, parameter_conversion.write_law_parameters(LINKAGE, self.values, self._shape)
        )


def build_gravity_compensator(parameters: ParameterReader, location: str) -> LinearTerm:
    """Return the balancer from a file.

    Args:
        parameters: parameters of the file.
        location: its location.

    Raises:
        InputError: a parameter is invalid.
    """
    values, (ratio, alpha), _ = parameter_conversion.read_law_parameters(LINKAGE, parameters)
    if abs(ratio - 1.0) < MIN_PIVOT_DISTANCE:
        raise parameters.build_error(
            "ratio", f"found {ratio:g}; with 1 the pivots meet at some angle, anything else would work"
        )
    return GravityCompensator(location=location, ratio=float(ratio), alpha=float(alpha), values=values)

"""Interfaces of the laws of structures: compliant bodies and thermal drift."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from machopt.effects.law_interfaces.law_parameters import DescribedLaw, Quantity, Shape
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class CompliantBody:
    """Compliant body with all joints at zero, between its root and the frame S at its loaded end."""

    axes: Array  # (3, 3) axes of S in base_link: x along the body, or outward along the tool
    length: float = 0.0  # m; 0: the joints coincide, the body has no length
    root: Array | None = None  # (4, 4) flange relative to S; None: the root is not defined
    normal: Array | None = None  # (3,) base_link axes: across the body, normal to the arm's plane of motion
    uses_own_axes: bool = False  # matrices are stated in axes of S; else in base_link axes


class BodyLaw(DescribedLaw, Protocol):
    """Law of a compliant body, linear in the wrench it carries: a twist of S under the wrench at S. Stateless; SI."""

    @property
    def note(self) -> str:
        """Where the effect is visible; empty: visible where joint torques do not explain the readings."""
        ...

    @property
    def includes_weight(self) -> bool:
        """Whether a search also tries it on data in which only gravity loads the arm."""
        ...

    @property
    def bounded(self) -> bool:
        """Whether a fit keeps the coefficients above their lower limits. Otherwise noise may leave a negative
        direction.
        """
        ...

    def axes(self, body: CompliantBody) -> Array:
        """Return the law's own axes at S, all joints at zero.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (3, 3) axes in base_link.
        """
        ...

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """Return the compliance matrices per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (P, 6, 6) compliance at S in the law's axes.
        """
        ...

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        """Return the twist of S caused by weights distributed evenly along the body.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.
            own: For each distributed weight: the total force (K, 3) N in the law's axes, and its extent from the
                root, m.

        Returns:
            (K, 6, P) m, rad per unit of each coefficient; None if the weights are to act at S.
        """
        ...

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        """Return the nearest coefficients of a positive semidefinite compliance.

        Args:
            values: (P,) fitted coefficients, possibly inadmissible because of noise.
            metric: (P, P) weight matrix of the least-squares problem: dᵀ metric d is the increase of the residual
                sum for a change d.

        Returns:
            (P,) admissible coefficients.
        """
        ...

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the parameters as a file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            Keys and values in the units of the keys.
        """
        ...

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            Shapes in SI; empty if the law is not applicable to this body.
        """
        ...

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Return the law reduced to the coefficients that the readings can determine.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.

        Returns:
            The reduced law.
        """
        ...


Reader = Callable[[ParameterReader, CompliantBody], tuple[BodyLaw, Array, Array, CompliantBody]]
"""Function that reads law, coefficients (P,) and shape (S,) from a file, and the body with stated properties."""


@dataclass(frozen=True, kw_only=True)
class ThermalState:
    """Time, temperature and motion patterns of N readings, as input to laws of thermal drift."""

    time_since_start: Array | None  # (N,) s since the session began; None: unknown
    unloaded_time_since_start: Array | None  # (N,) s, time of its unloaded reference state; None: readings are absolute
    temperature_rise: Array | None  # (N,) K relative to the first reading; None: not recorded
    casting_columns: Array  # (N, D, 3) m per unit strain of carousel, upper arm, forearm
    stand_columns: Array  # (N, D, 6) m, rad per m and rad of a shift and a turn of the stand
    is_relative: bool  # readings are relative to an unloaded reference state

    @property
    def longest_session(self) -> float:
        """s, of a session; 0 where nobody knows."""
        return 0.0 if self.time_since_start is None else float(self.time_since_start.max())


class DriftLaw(DescribedLaw, Protocol):
    """Law of a drift with time or temperature, linear in its coefficients. Stateless; SI."""

    @property
    def penalty(self) -> float:
        """Additional gain that the law must reach beyond that of its coefficients, because it is flexible."""
        ...

    def columns(self, shape: Array, thermal_state: ThermalState) -> Array:
        """Return the TCP drift per unit of each coefficient.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            (N, D, P) m, rad per unit of each coefficient.
        """
        ...

    def sizes(self, values: Array, shape: Array, thermal_state: ThermalState) -> Mapping[str, Quantity]:
        """Return the coefficients as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            Quantities by name. The first one is the size of the effect and is proportional to the coefficients.
        """
        ...

    def grid(self, thermal_state: ThermalState) -> tuple[Shape, ...]:
        """Return the shapes that a search tries.

        Args:
            thermal_state: Times, temperatures and motion patterns of N readings.

        Returns:
            Shapes in SI; empty if the readings cannot show the effect.
        """
        ...

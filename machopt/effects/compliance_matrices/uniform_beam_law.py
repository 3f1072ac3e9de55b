"""Compliance of a beam of constant section, with bending in one or two planes, torsion and its own weight."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from machopt.effects import parameter_conversion
from machopt.effects.compliance_matrices.beam_compliance import (
    compute_axial_compliance,
    compute_bending_compliance,
    compute_single_axis_bending_compliance,
    compute_torsion_compliance,
)
from machopt.effects.protocol import BodyLaw, CompliantBody, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import cross_product

SECTIONS = 4  # Gauss points: exact up to x⁷, and a uniform beam under its own weight has x⁴
LEAST_LENGTH = 1e-3  # m; a shorter distance between joints is not modelled as a beam

PER_BEND = "1/(N·m²)"
ACROSS_KEY = "EI_across_Nm2"
PARTS: Mapping[str, LawParameter] = MappingProxyType(
    {
        p.key: p
        for p in (
            LawParameter(key="EI_Nm2", unit=PER_BEND, lower_limit=0.0, positive=True, inverse=True, name="1/EI"),
            LawParameter(
                key=ACROSS_KEY, unit=PER_BEND, lower_limit=0.0, positive=True, inverse=True, name="1/EI across"
            ),
            LawParameter(key="GJ_Nm2", unit=PER_BEND, lower_limit=0.0, positive=True, inverse=True, name="1/GJ"),
            LawParameter(key="EA_N", unit="1/N", lower_limit=0.0, positive=True, inverse=True, name="1/EA"),
        )
    }
)
NORMAL_KEY = "normal"  # key of the principal axis, base_link axes with all joints at zero
MATRIX, RIGID = "compliance", "compliance_diagonal"  # a rigid body is written as a zero diagonal: no finite EI is rigid


class BodyLawDefaults:
    """Default implementations shared by most laws of compliant bodies."""

    word = ""
    has_memory = False
    shape: tuple[LawParameter, ...] = ()
    note = ""
    includes_weight = False
    bounded = True

    def axes(self, body: CompliantBody) -> Array:
        """Return the law's own axes at S.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (3, 3) axes in base_link, all joints at zero.
        """
        return body.axes if body.uses_own_axes else np.eye(3)

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        """Return None: the weights act at S.

        Args:
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.
            own: For each distributed weight: the total force (K, 3) N in the law's axes, and its extent from the root,
                m.
        """
        return None

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Return one empty shape: the law has no shape parameters to search.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            The shapes that a search tries.
        """
        return ((),)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the parameters as a file states them.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.
        """
        return parameter_conversion.write_law_parameters(self, values, shape)  # type: ignore[arg-type]  # subclasses have coefficients

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        """Return the coefficients unchanged.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            metric: (P, P) weight matrix of the least-squares problem: dᵀ metric d is the increase of the residual sum
                for a change d.
        """
        return values

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        """Return the law unchanged: all its coefficients are observable.

        Args:
            dimensions: Number of measured coordinates: 3 (position) or 6 (pose).
            turning: Whether the loads include moments that rotate the tool.
        """
        return self  # type: ignore[return-value]  # and matrices


@dataclass(frozen=True)
class UniformBeamLaw(BodyLawDefaults):
    """Uniform beam with bending, torsion and extension. An unstated extension is 100 times stiffer than bending."""

    keys: tuple[str, ...] = ("EI_Nm2", "GJ_Nm2")
    planes: bool = False  # the two bending planes have different stiffness
    includes_weight = True

    @staticmethod
    def from_keys(keys: Iterable[str]) -> UniformBeamLaw:
        """Return the beam law that a file with these keys means.

        Args:
            keys: Keys of the file's entry.

        Returns:
            The law with the stated coefficients; a law to be fitted if no number is stated.
        """
        given = set(keys)
        planes = bool(given & {ACROSS_KEY, NORMAL_KEY})
        stated = tuple(k for k in PARTS if k in given)
        return UniformBeamLaw(stated, planes) if stated else TWO_PLANES if planes else UniformBeamLaw()

    @property
    def name(self) -> str:
        if self.planes:
            return "bends in two planes and twists"
        verbs = {"EI_Nm2": "bends", "GJ_Nm2": "twists", "EA_N": "stretches"}
        return " and ".join(verbs[k] for k in self.keys)

    @property
    def equation(self) -> str:
        text = "cantilever: L³/3EI, L²/2EI, L/EI, L/GJ at its end (zhang2025 eq. 20)"
        return f"{text}, EI of each principal axis" if self.planes else text

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return tuple(PARTS[k] for k in self.keys)

    def axes(self, body: CompliantBody) -> Array:
        """Return the law's own axes: x along the beam, z the stated principal axis.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (3, 3) axes in base_link, all joints at zero.
        """
        if not self.planes or body.normal is None:
            return body.axes
        x = body.axes[:, 0]
        return np.stack([x, np.cross(body.normal, x), body.normal], axis=-1)

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """Return the compliance matrices of the beam per unit of each coefficient.

        Args:
            shape: Empty; a uniform beam has no shape parameters.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (P, 6, 6) compliance at S in the beam's axes.
        """
        (x, y, z), length = np.eye(3), body.length
        parts = {
            "EI_Nm2": compute_single_axis_bending_compliance(z, x, length)
            if self.planes
            else compute_bending_compliance(length),
            ACROSS_KEY: compute_single_axis_bending_compliance(y, x, length),
            "GJ_Nm2": compute_torsion_compliance(length),
            "EA_N": compute_axial_compliance(length),
        }
        return np.stack([parts[k] for k in self.keys])

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        """Return the twist of S caused by weights distributed evenly along the beam.

        Args:
            shape: Empty; a uniform beam has no shape parameters.
            body: Geometry of the compliant body, all joints at zero.
            own: For each distributed weight: the total force (K, 3) N in the law's axes, and its extent from the root,
                m.

        Returns:
            (K, 6, P) m, rad per unit of each coefficient, or None without distributed weights.
        """
        if not own:
            return None
        count = len(own[0][0])
        x, y, z = (np.tile(e, (count, 1)) for e in np.eye(3))
        about_z, about_y, twisted = np.moveaxis(
            compute_section_deflection((z, y, x), body.length, body.length * x, np.zeros((count, 6)), own), 2, 0
        )
        parts = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": np.zeros((count, 6)),
        }
        return np.stack([parts[k] for k in self.keys], axis=-1)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the parameters as a file states them; a rigid beam becomes a zero compliance diagonal.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.
        """
        if not np.any(values):
            return {RIGID: [0.0] * 6}
        axis = {NORMAL_KEY: [float(v) for v in body.normal]} if self.planes and body.normal is not None else {}
        return {**parameter_conversion.write_law_parameters(self, values, np.empty(0)), **axis}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the bending and torsion compliances as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        if self.planes:
            names = ("1/EI in the arm's plane", "1/EI across it", "1/GJ")
            parts = {name: Quantity(float(v), PER_BEND) for name, v in zip(names, values, strict=True)}
            return {"1/EI": Quantity(float(values[:2].max()), PER_BEND), **parts}
        return {p.report_key: Quantity(abs(float(v)), p.unit) for p, v in zip(self.coefficients, values, strict=True)}

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Return one empty shape, or none for a body too short to be a beam.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            The shapes that a search tries.
        """
        return ((),) if body.length >= LEAST_LENGTH else ()


TWO_PLANES = UniformBeamLaw(("EI_Nm2", ACROSS_KEY, "GJ_Nm2"), planes=True)


def compute_section_deflection(
    axes: Sequence[Array],
    length: float,
    tip: Array,
    wrench: Array,
    own: Sequence[tuple[Array, float]] = (),
    at: tuple[Array, Array] | None = None,
) -> Array:
    """Compute the TCP twist of a beam under a tip wrench and its own weight, by integration over its sections.

    A section at x carries m(x), the moment of all loads beyond it. It rotates by m·n/EI per unit length about each
    principal axis n, and by m·a/GJ about the beam axis a. Each rotation moves the TCP about the section at x.

    Args:
        axes: Three arrays (N, 3): principal axis of ``EI_Nm2``, the axis across it, the beam axis from root to end.
        length: Length of the beam, m.
        tip: (N, 3) TCP relative to the root, m.
        wrench: (N, 6) total wrench at the beam end, referred to the TCP, N and N·m.
        own: For each evenly distributed weight: the total force (K, 3) N, and its extent from the root, m.
        at: Positions of the sections from the root, m, and the length of uniform beam each one represents, m; None
            for a uniform beam.

    Returns:
        (N, 6, 3) twist of the TCP per unit of 1/EI, 1/EI across and 1/GJ.
    """
    if at is None:
        nodes, weights = np.polynomial.legendre.leggauss(SECTIONS)
        at = 0.5 * length * (nodes + 1.0), 0.5 * length * weights
    x, w = at
    along, force = axes[2], wrench[:, :3]
    # the moment about the root, its decrease per m along the beam, and for each weight half the square of what lies
    # beyond the section, per m of the weight's extent
    moment, decrease = wrench[:, 3:] + cross_product(tip, force), cross_product(along, force)
    sums = [float(np.sum(w * x**k)) for k in range(3)]
    weights_beyond = [
        (cross_product(along, weight), 0.5 * w * np.maximum(span - x, 0.0) ** 2 / span) for weight, span in own
    ]
    turn = sums[0] * moment - sums[1] * decrease  # Σ w m
    turn_at = sums[1] * moment - sums[2] * decrease  # Σ w x m
    for bending, share in weights_beyond:
        turn = turn + float(np.sum(share)) * bending
        turn_at = turn_at + float(np.sum(share * x)) * bending
    out = np.empty((len(wrench), 6, 3))
    for k, n in enumerate(axes):
        angle, lever = np.einsum("nc,nc->n", n, turn)[:, None], np.einsum("nc,nc->n", n, turn_at)[:, None]
        out[:, :3, k] = angle * cross_product(n, tip) - lever * cross_product(n, along)
        out[:, 3:, k] = angle * n
    return out

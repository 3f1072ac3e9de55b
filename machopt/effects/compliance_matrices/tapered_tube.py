"""Tapered tube with shear deformation: the radius decreases linearly from root to end.

A cast link is thick at its flange, slim at its end, and short compared with its width. A uniform beam of the same end
deflection rotates about another point. The difference would otherwise be attributed to joints and frames nearby.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.effects import parameter_conversion
from machopt.effects.compliance_matrices import body_compliance_laws
from machopt.effects.compliance_matrices.uniform_beam_law import (
    ACROSS_KEY,
    LEAST_LENGTH,
    RIGID,
    UniformBeamLaw,
    compute_section_deflection,
)
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array

NODES = 16  # Gauss points: a tube of a tenth of its root's radius is right to 1e-9
TAPER = LawParameter(key="taper", unit="1", positive=True, lower_limit=0.05)
SHEAR = LawParameter(key="shear", unit="1", lower_limit=0.0)
TAPERS, SHEARS = (1.0, 0.85, 0.7, 0.55), (0.0, 0.05)
UNIFORM: Shape = (1.0, 0.0)


@dataclass(frozen=True)
class TaperedTube(UniformBeamLaw):
    """Tapered tube. EI, EI across and GJ refer to its middle and scale with the cube of the radius (constant wall).

    ``taper`` is the radius at the end divided by that at the root. ``shear`` is EI/(k G A L²) at the middle: for a
    thin tube 2.6 times the square of radius over length.
    """

    shape: tuple[LawParameter, ...] = (TAPER, SHEAR)

    @property
    def name(self) -> str:
        return f"{super().name}, tapers and shears"

    @property
    def equation(self) -> str:
        return "Castigliano's integrals over a thin tube with a radius that falls evenly, shear included"

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        """Return the compliance matrices of the tube per unit of each coefficient.

        Args:
            shape: (2,) taper and shear ratio; empty for a uniform beam.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (P, 6, 6) compliance at S in the tube's axes.
        """
        taper, shear = _fill_default_shape(shape)
        from_end, slim, weight = _compute_tube_sections(taper, body.length)
        bends, shears = weight / slim**3, shear * body.length**2 * float(np.sum(weight / slim))
        lever = np.array([np.sum(bends * from_end**2) + shears, np.sum(bends * from_end), np.sum(bends)])
        about_z, about_y, twisted = np.zeros((3, 6, 6))
        about_z[np.ix_((1, 5), (1, 5))] = [[lever[0], lever[1]], [lever[1], lever[2]]]
        about_y[np.ix_((2, 4), (2, 4))] = [[lever[0], -lever[1]], [-lever[1], lever[2]]]
        twisted[3, 3] = lever[2]
        stretched = np.zeros((6, 6))
        stretched[0, 0] = np.sum(weight / slim)
        parts = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": stretched,
        }
        return np.stack([parts[k] for k in self.keys])

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        """Return the twist of S caused by weights distributed evenly along the tube.

        Args:
            shape: (2,) taper and shear ratio; empty for a uniform beam.
            body: Geometry of the compliant body, all joints at zero.
            own: For each distributed weight: the total force (K, 3) N in the law's axes, and its extent from the root,
                m.

        Returns:
            (K, 6, P) m, rad per unit of each coefficient, or None without distributed weights.
        """
        if not own:
            return None
        taper, shear = _fill_default_shape(shape)
        count, length = len(own[0][0]), body.length
        x, y, z = (np.tile(e, (count, 1)) for e in np.eye(3))
        from_end, slim, weight = _compute_tube_sections(taper, length)
        about_z, about_y, twisted = np.moveaxis(
            compute_section_deflection(
                (z, y, x),
                length,
                length * x,
                np.zeros((count, 6)),
                own,
                at=(length - from_end, weight / slim**3),
            ),
            2,
            0,
        )
        for whole, span in own:  # the weight beyond a section loads it in shear
            remaining_share = np.maximum(span - (length - from_end), 0.0) / span
            moved = shear * length**2 * float(np.sum(weight / slim * remaining_share)) * whole
            about_z[:, 1] += moved[:, 1]
            about_y[:, 2] += moved[:, 2]
        parts = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": np.zeros((count, 6)),
        }
        return np.stack([parts[k] for k in self.keys], axis=-1)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the parameters as a file states them, with taper and shear.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            Keys and values in the units of the keys.
        """
        parameters = super().to_file_parameters(values, shape, body)
        return (
            parameters
            if RIGID in parameters
            else {**parameters, **parameter_conversion.write_law_parameters(self, values, _fill_default_shape(shape))}
        )

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the compliances of the beam and the radius ratio as reported quantities.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        radius_ratio = (
            {} if not len(shape) else {"radius at the end over that at the root": Quantity(float(shape[0]), "1")}
        )
        return {**super().sizes(values, shape), **radius_ratio}

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        """Return the tapers and shear ratios that a search tries; none for a body too short to be a beam.

        Args:
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            Shapes (taper, shear ratio).
        """
        if body.length < LEAST_LENGTH:
            return ()
        return tuple((t, s) for t in TAPERS for s in SHEARS if (t, s) != UNIFORM)


TAPERED = TaperedTube(("EI_Nm2", ACROSS_KEY, "GJ_Nm2"), planes=True)


def read_tube_law(reader: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """Read a tapered tube if the file states taper or shear, otherwise a uniform beam or a matrix.

    Args:
        reader: Reader of the parameters that the file states.
        body: Geometry of the compliant body, all joints at zero.

    Returns:
        The law, its coefficients (P,) and shape (S,) in SI, and the body with the stated principal axis.

    Raises:
        InputError: A form that the body does not have, or numbers that are physically impossible.
    """
    plain = body_compliance_laws.read_body_law(reader, body)
    if (
        body_compliance_laws.find_parameter_form(reader, beam=body.length > 0.0) != "beam"
        or not {TAPER.key, SHEAR.key} & reader.keys
    ):
        return plain
    beam = UniformBeamLaw.from_keys(reader.keys)
    law = TaperedTube(beam.keys, beam.planes)
    return law, plain[1], parameter_conversion.read_law_parameters(law, reader)[1], plain[3]


def _fill_default_shape(shape: Array) -> Array:
    """Return taper and shear ratio (2,), with those of a uniform beam where none are stated."""
    return np.where(np.isnan(shape), UNIFORM, shape) if len(shape) else np.array(UNIFORM)


def _compute_tube_sections(taper: float, length: float) -> tuple[Array, Array, Array]:
    """Return for each section: distance from the end (m), radius relative to the middle, represented length (m)."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    from_end = 0.5 * length * (1.0 - nodes)
    return from_end, 1.0 + nodes * (taper - 1.0) / (taper + 1.0), 0.5 * length * weights

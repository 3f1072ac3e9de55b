"""A beam that is a tube: its radius falls evenly from root to end, and its wall shears.

A casting is thick where it is bolted and slim where it ends, and short for its width. A uniform beam of the same end
turns about another point, and what that leaves of a soft link passes for joints and frames beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.effects import parameter_conversion
from machopt.effects.compliance_matrices import body_compliance_laws
from machopt.effects.compliance_matrices.body_compliance_laws import (
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
    """EI, EI across and GJ are those of its middle; they go with the cube of the radius, the wall being as thick.

    ``taper`` is the radius at the end over that at the root, ``shear`` EI/(k G A L²) at the middle: for a thin tube 2.6
    times the square of radius over length.
    """

    shape: tuple[LawParameter, ...] = (TAPER, SHEAR)

    @property
    def name(self) -> str:
        return f"{super().name}, tapers and shears"

    @property
    def equation(self) -> str:
        return "Castigliano's integrals over a thin tube with a radius that falls evenly, shear included"

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
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
        made = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": stretched,
        }
        return np.stack([made[k] for k in self.keys])

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
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
        for whole, span in own:  # what is left of a weight beyond a section shears it
            left = np.maximum(span - (length - from_end), 0.0) / span
            moved = shear * length**2 * float(np.sum(weight / slim * left)) * whole
            about_z[:, 1] += moved[:, 1]
            about_y[:, 2] += moved[:, 2]
        made = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": np.zeros((count, 6)),
        }
        return np.stack([made[k] for k in self.keys], axis=-1)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        said = super().to_file_parameters(values, shape, body)
        return (
            said
            if RIGID in said
            else {**said, **parameter_conversion.write_law_parameters(self, values, _fill_default_shape(shape))}
        )

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        told = {} if not len(shape) else {"radius at the end over that at the root": Quantity(float(shape[0]), "1")}
        return {**super().sizes(values, shape), **told}

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        if body.length < LEAST_LENGTH:
            return ()
        return tuple((t, s) for t in TAPERS for s in SHEARS if (t, s) != UNIFORM)


TAPERED = TaperedTube(("EI_Nm2", ACROSS_KEY, "GJ_Nm2"), planes=True)


def read_tube_law(given: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """A tube where a file says how it tapers or shears, else as
    :func:`machopt.effects.compliance_matrices.body_compliance_laws.read_body_law`.

    Raises:
        InputError: a form that the body has not, or numbers that no body has.
    """
    plain = body_compliance_laws.read_body_law(given, body)
    if (
        body_compliance_laws.find_parameter_form(given, beam=body.length > 0.0) != "beam"
        or not {TAPER.key, SHEAR.key} & given.keys
    ):
        return plain
    beam = UniformBeamLaw.from_keys(given.keys)
    law = TaperedTube(beam.keys, beam.planes)
    return law, plain[1], parameter_conversion.read_law_parameters(law, given)[1], plain[3]


def _fill_default_shape(shape: Array) -> Array:
    """(2,) with those of a uniform beam for what nobody states."""
    return np.where(np.isnan(shape), UNIFORM, shape) if len(shape) else np.array(UNIFORM)


def _compute_tube_sections(taper: float, length: float) -> tuple[Array, Array, Array]:
    """Of sections: how far from the end, m; the radius there over that of the middle; the length it stands for, m."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    from_end = 0.5 * length * (1.0 - nodes)
    return from_end, 1.0 + nodes * (taper - 1.0) / (taper + 1.0), 0.5 * length * weights

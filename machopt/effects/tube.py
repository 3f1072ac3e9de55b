"""A beam that is a tube: its radius falls evenly from root to end, and its wall shears.

A casting is thick where it is bolted and slim where it ends, and short for its width. A uniform beam of the same end
turns about another point, and what that leaves of a soft link passes for joints and frames beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.arrays import Array
from machopt.effects import bodies, files
from machopt.effects.bodies import ACROSS, LEAST_LENGTH, RIGID, Beam, sections
from machopt.effects.given import Parameters
from machopt.effects.protocol import Body, BodyLaw, Parameter, Quantity, Shape

NODES = 16  # Gauss points: a tube of a tenth of its root's radius is right to 1e-9
TAPER = Parameter(key="taper", unit="1", positive=True, least=0.05)
SHEAR = Parameter(key="shear", unit="1", least=0.0)
TAPERS, SHEARS = (1.0, 0.85, 0.7, 0.55), (0.0, 0.05)
UNIFORM: Shape = (1.0, 0.0)


@dataclass(frozen=True)
class Tube(Beam):
    """EI, EI across and GJ are those of its middle; they go with the cube of the radius, the wall being as thick.

    ``taper`` is the radius at the end over that at the root, ``shear`` EI/(k G A L²) at the middle: for a thin tube 2.6
    times the square of radius over length.
    """

    shape: tuple[Parameter, ...] = (TAPER, SHEAR)

    @property
    def name(self) -> str:
        return f"{super().name}, tapers and shears"

    @property
    def equation(self) -> str:
        return "Castigliano's integrals over a thin tube with a radius that falls evenly, shear included"

    def matrices(self, shape: Array, body: Body) -> Array:
        taper, shear = _filled(shape)
        from_end, slim, weight = _along(taper, body.length)
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
            ACROSS: about_y,
            "GJ_Nm2": twisted,
            "EA_N": stretched,
        }
        return np.stack([made[k] for k in self.keys])

    def sags(self, shape: Array, body: Body, own: Sequence[tuple[Array, float]]) -> Array | None:
        if not own:
            return None
        taper, shear = _filled(shape)
        count, length = len(own[0][0]), body.length
        x, y, z = (np.tile(e, (count, 1)) for e in np.eye(3))
        from_end, slim, weight = _along(taper, length)
        about_z, about_y, twisted = np.moveaxis(
            sections(
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
            ACROSS: about_y,
            "GJ_Nm2": twisted,
            "EA_N": np.zeros((count, 6)),
        }
        return np.stack([made[k] for k in self.keys], axis=-1)

    def stated(self, values: Array, shape: Array, body: Body) -> dict[str, Any]:
        said = super().stated(values, shape, body)
        return said if RIGID in said else {**said, **files.write(self, values, _filled(shape))}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        told = {} if not len(shape) else {"radius at the end over that at the root": Quantity(float(shape[0]), "1")}
        return {**super().sizes(values, shape), **told}

    def grid(self, body: Body) -> tuple[Shape, ...]:
        if body.length < LEAST_LENGTH:
            return ()
        return tuple((t, s) for t in TAPERS for s in SHEARS if (t, s) != UNIFORM)


TAPERED = Tube(("EI_Nm2", ACROSS, "GJ_Nm2"), planes=True)


def stated_law(given: Parameters, body: Body) -> tuple[BodyLaw, Array, Array, Body]:
    """A tube where a file says how it tapers or shears, else as :func:`machopt.effects.bodies.stated_law`.

    Raises:
        InputError: a form that the body has not, or numbers that no body has.
    """
    plain = bodies.stated_law(given, body)
    if bodies.form_of(given, beam=body.length > 0.0) != "beam" or not {TAPER.key, SHEAR.key} & given.keys:
        return plain
    beam = Beam.stating(given.keys)
    law = Tube(beam.keys, beam.planes)
    return law, plain[1], files.read(law, given)[1], plain[3]


def _filled(shape: Array) -> Array:
    """(2,) with those of a uniform beam for what nobody states."""
    return np.where(np.isnan(shape), UNIFORM, shape) if len(shape) else np.array(UNIFORM)


def _along(taper: float, length: float) -> tuple[Array, Array, Array]:
    """Of sections: how far from the end, m; the radius there over that of the middle; the length it stands for, m."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    from_end = 0.5 * length * (1.0 - nodes)
    return from_end, 1.0 + nodes * (taper - 1.0) / (taper + 1.0), 0.5 * length * weights

"""Bodies that bend: links, base, tool. Frames and the forms of a matrix stand in :mod:`machopt.model.terms.body`.

A beam is clamped at one end and loaded at the other; x along it, and z the principal axis that its key ``EI_Nm2``
bends about where the two planes differ.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from machopt.effects import files
from machopt.effects.beam import bent_about, cantilever_axial, cantilever_bending, cantilever_torsion
from machopt.effects.protocol import Array, Effect, Parameter

SECTIONS = 4  # Gauss points: exact up to x⁷, and a uniform beam under its own weight has x⁴
PER_BEND = "1/(N·m²)"
ACROSS = "EI_across_Nm2"
PARTS: Mapping[str, Parameter] = MappingProxyType(
    {
        p.key: p
        for p in (
            Parameter(key="EI_Nm2", unit=PER_BEND, least=0.0, positive=True, inverse=True, name="1/EI"),
            Parameter(key=ACROSS, unit=PER_BEND, least=0.0, positive=True, inverse=True, name="1/EI across"),
            Parameter(key="GJ_Nm2", unit=PER_BEND, least=0.0, positive=True, inverse=True, name="1/GJ"),
            Parameter(key="EA_N", unit="1/N", least=0.0, positive=True, inverse=True, name="1/EA"),
        )
    }
)
NORMAL = "normal"  # key of the principal axis, base_link axes with all joints at zero
RIGID = "compliance_diagonal"  # no EI is large enough to say that nothing gives


@dataclass(frozen=True)
class Beam:
    """A beam by what bends, twists and stretches; an extension nobody asked about is 100 times stiffer than bending."""

    keys: tuple[str, ...] = ("EI_Nm2", "GJ_Nm2")
    planes: bool = False  # it bends otherwise in one plane than in the other
    word = ""
    remembers = False
    shape: tuple[Parameter, ...] = ()

    @staticmethod
    def stating(keys: Iterable[str]) -> Beam:
        """The one that a file with these keys means; one to be fitted where no number is stated."""
        given = set(keys)
        planes = bool(given & {ACROSS, NORMAL})
        stated = tuple(k for k in PARTS if k in given)
        return Beam(stated, planes) if stated else TWO_PLANES if planes else Beam()

    @property
    def coefficients(self) -> tuple[Parameter, ...]:
        return tuple(PARTS[k] for k in self.keys)

    def matrices(self, length: float) -> Array:
        """(P, 6, 6) compliance at the loaded end per unit of each coefficient, local axes; length in m."""
        x, y, z = np.eye(3)
        made = {
            "EI_Nm2": bent_about(z, x, length) if self.planes else cantilever_bending(length),
            ACROSS: bent_about(y, x, length),
            "GJ_Nm2": cantilever_torsion(length),
            "EA_N": cantilever_axial(length),
        }
        return np.stack([made[k] for k in self.keys])

    def stated(self, values: Array, normal: Array | None = None) -> dict[str, Any]:
        """The parameters of a file."""
        if not np.any(values):
            return {RIGID: [0.0] * 6}
        axis = {} if normal is None else {NORMAL: [float(v) for v in normal]}
        return {**files.write(self, values, np.empty(0)), **axis}


TWO_PLANES = Beam(("EI_Nm2", ACROSS, "GJ_Nm2"), planes=True)


def sections(
    axes: Sequence[Array], length: float, tip: Array, wrench: Array, own: Sequence[tuple[Array, float]] = ()
) -> Array:
    """What a beam does under all that it carries, its own weight too, by the moment in each of its sections.

    A section at x carries m(x), the moment of all loads beyond it; it turns by m·n/EI a length about each of its
    principal axes n and by m·a/GJ about the beam's, and each turn moves the TCP about x.

    Args:
        axes: three of (N, 3): the principal axis of ``EI_Nm2``, that across, the beam's own from root to end.
        length: m.
        tip: (N, 3) m, the TCP as seen from the root.
        wrench: (N, 6) N, N·m at the TCP, of all that hangs on the end.
        own: of each weight that is spread evenly from the root: the whole of it (3,) N, and how far it reaches in m.

    Returns:
        (N, 6, 3) twist of the TCP per unit of 1/EI, 1/EI across, 1/GJ.
    """
    out = np.zeros((len(wrench), 6, 3))
    nodes, weights = np.polynomial.legendre.leggauss(SECTIONS)
    for x, w in zip(0.5 * length * (nodes + 1.0), 0.5 * length * weights, strict=True):
        lever = tip - x * axes[2]
        moment = wrench[:, 3:] + np.cross(lever, wrench[:, :3])
        for weight, span in own:
            if span > x:  # what is left of it beyond the section pulls in its middle
                moment = moment + 0.5 * (span - x) ** 2 / span * np.cross(axes[2], weight)
        for k, n in enumerate(axes):
            turn = w * np.einsum("nc,nc->n", n, moment)[:, None] * n
            out[:, :3, k] += np.cross(turn, lever)
            out[:, 3:, k] += turn
    return out


LINK = Effect(
    name="link_compliance",
    noun="compliance",
    spoken="link compliance",
    sentence="The link body bends or twists; the joint beside it does not.",
    port="body",
    places=tuple(f"link:{i}" for i in range(1, 7)),
    elastic=True,
)

BASE = Effect(
    name="base_compliance",
    noun="compliance",
    spoken="base compliance",
    sentence="Pedestal, anchors or floor give way under the overturning moment.",
    port="body",
    places=("base",),
    elastic=True,
)

TOOL = Effect(
    name="tool_compliance",
    noun="compliance",
    spoken="tool compliance",
    sentence="Flange, force sensor, spindle or holder bend behind the tool tip.",
    port="body",
    places=("tool",),
    elastic=True,
)

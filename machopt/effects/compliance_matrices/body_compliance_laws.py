"""Laws of bodies that give way: a beam, and a symmetric matrix or some of its entries.

A beam is clamped at its root and loaded at the frame S at its end; x along it, and z the principal axis that its key
``EI_Nm2`` bends about where the two planes differ. Which effects have these laws stands in :mod:`link`, :mod:`base` and
:mod:`tool`; where S is, :mod:`machopt.stiffness.terms.body_spring` knows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from machopt.effects.compliance_matrices.semidefinite_projection import find_nearest_semidefinite
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody, LawParameter, Quantity, Shape
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors

SECTIONS = 4  # Gauss points: exact up to x⁷, and a uniform beam under its own weight has x⁴
LEAST_LENGTH = 1e-3  # m; joints nearer than this make no beam
LEAST_SINE = 1e-3  # of the angle between a beam and its principal axis
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
MATRIX, RIGID = "compliance", "compliance_diagonal"  # no EI is large enough to say that nothing gives
ROWS = ("tx", "ty", "tz", "rx", "ry", "rz")
ALL_ENTRIES = tuple((i, j) for i in range(6) for j in range(i, 6))
DIAGONAL_ENTRIES = tuple((i, i) for i in range(6))
UNITS = ("m/N", "1/N", "rad/(N·m)")  # of two translations, of one and a rotation, of two rotations
SYMMETRY_TOLERANCE = 1e-6  # relative, that a symmetric matrix may be off by as printed


class BodyLawDefaults:
    """What most laws of bodies answer."""

    word = ""
    has_memory = False
    shape: tuple[LawParameter, ...] = ()
    note = ""
    includes_weight = False
    bounded = True

    def axes(self, body: CompliantBody) -> Array:
        return body.axes if body.uses_own_axes else np.eye(3)

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        return None

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        return ((),)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        return parameter_conversion.write_law_parameters(self, values, shape)  # type: ignore[arg-type]  # what inherits has coefficients

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        return values

    def restrict_to_observed(self, dimensions: int, *, turning: bool) -> BodyLaw:
        return self  # type: ignore[return-value]  # and matrices


@dataclass(frozen=True)
class UniformBeamLaw(BodyLawDefaults):
    """A beam by what bends, twists and stretches; an extension nobody asked about is 100 times stiffer than bending."""

    keys: tuple[str, ...] = ("EI_Nm2", "GJ_Nm2")
    planes: bool = False  # it bends otherwise in one plane than in the other
    includes_weight = True

    @staticmethod
    def from_keys(keys: Iterable[str]) -> UniformBeamLaw:
        """The one that a file with these keys means; one to be fitted where no number is stated."""
        given = set(keys)
        planes = bool(given & {ACROSS_KEY, NORMAL_KEY})
        stated = tuple(k for k in PARTS if k in given)
        return UniformBeamLaw(stated, planes) if stated else TWO_PLANES if planes else UniformBeamLaw()

    @property
    def name(self) -> str:
        if self.planes:
            return "bends in two planes and twists"
        said = {"EI_Nm2": "bends", "GJ_Nm2": "twists", "EA_N": "stretches"}
        return " and ".join(said[k] for k in self.keys)

    @property
    def equation(self) -> str:
        said = "cantilever: L³/3EI, L²/2EI, L/EI, L/GJ at its end (zhang2025 eq. 20)"
        return f"{said}, EI of each principal axis" if self.planes else said

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return tuple(PARTS[k] for k in self.keys)

    def axes(self, body: CompliantBody) -> Array:
        if not self.planes or body.normal is None:
            return body.axes
        x = body.axes[:, 0]
        return np.stack([x, np.cross(body.normal, x), body.normal], axis=-1)

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        (x, y, z), length = np.eye(3), body.length
        made = {
            "EI_Nm2": compute_single_axis_bending_compliance(z, x, length)
            if self.planes
            else compute_bending_compliance(length),
            ACROSS_KEY: compute_single_axis_bending_compliance(y, x, length),
            "GJ_Nm2": compute_torsion_compliance(length),
            "EA_N": compute_axial_compliance(length),
        }
        return np.stack([made[k] for k in self.keys])

    def compute_own_weight_deflection(
        self, shape: Array, body: CompliantBody, own: Sequence[tuple[Array, float]]
    ) -> Array | None:
        if not own:
            return None
        count = len(own[0][0])
        x, y, z = (np.tile(e, (count, 1)) for e in np.eye(3))
        about_z, about_y, twisted = np.moveaxis(
            compute_section_deflection((z, y, x), body.length, body.length * x, np.zeros((count, 6)), own), 2, 0
        )
        made = {
            "EI_Nm2": about_z if self.planes else about_z + about_y,
            ACROSS_KEY: about_y,
            "GJ_Nm2": twisted,
            "EA_N": np.zeros((count, 6)),
        }
        return np.stack([made[k] for k in self.keys], axis=-1)

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        if not np.any(values):
            return {RIGID: [0.0] * 6}
        axis = {NORMAL_KEY: [float(v) for v in body.normal]} if self.planes and body.normal is not None else {}
        return {**parameter_conversion.write_law_parameters(self, values, np.empty(0)), **axis}

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        if self.planes:
            names = ("1/EI in the arm's plane", "1/EI across it", "1/GJ")
            parts = {name: Quantity(float(v), PER_BEND) for name, v in zip(names, values, strict=True)}
            return {"1/EI": Quantity(float(values[:2].max()), PER_BEND), **parts}
        return {p.report_key: Quantity(abs(float(v)), p.unit) for p, v in zip(self.coefficients, values, strict=True)}

    def grid(self, body: CompliantBody) -> tuple[Shape, ...]:
        return ((),) if body.length >= LEAST_LENGTH else ()


TWO_PLANES = UniformBeamLaw(("EI_Nm2", ACROSS_KEY, "GJ_Nm2"), planes=True)


@dataclass(frozen=True)
class MatrixEntriesLaw(BodyLawDefaults):
    """Some entries of a symmetric compliance matrix at S, the others zero."""

    pairs: tuple[tuple[int, int], ...] = ALL_ENTRIES
    name: str = "gives way in every direction"
    equation: str = "R C Rᵀ w at S, C symmetric"
    note: str = ""
    includes_weight: bool = False

    @property
    def key(self) -> str:
        return RIGID if all(i == j for i, j in self.pairs) else MATRIX

    @property
    def bounded(self) -> bool:  # type: ignore[override]  # a property of the base is a constant
        return self.key == RIGID

    @property
    def coefficients(self) -> tuple[LawParameter, ...]:
        return tuple(
            LawParameter(
                key=ROWS[i] if i == j else f"{ROWS[i]}·{ROWS[j]}",
                unit=UNITS[(i > 2) + (j > 2)],
                lower_limit=0.0 if i == j else -np.inf,
            )
            for i, j in self.pairs
        )

    def matrices(self, shape: Array, body: CompliantBody) -> Array:
        basis = np.zeros((len(self.pairs), 6, 6))
        for p, (i, j) in enumerate(self.pairs):
            basis[p, i, j] = basis[p, j, i] = 1.0
        return basis

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        C = np.einsum("p,pij->ij", values, self.matrices(shape, body))
        return {RIGID: np.diag(C).tolist()} if self.key == RIGID else {MATRIX: project_to_semidefinite(C).tolist()}

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        return find_nearest_semidefinite(values, self.pairs, metric)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Tilt where the body tilts, else what the tip moves sideways."""
        of = {ROWS[i]: abs(float(v)) for (i, j), v in zip(self.pairs, values, strict=True) if i == j}
        moved, tilted = (
            max((of.get(k, 0.0) for k in rows), default=0.0) for rows in (("tx", "ty", "tz"), ("rx", "ry"))
        )
        tilt = {"tilt_compliance": Quantity(tilted, UNITS[2])} if "rx" in of else {}
        return tilt | ({"translation": Quantity(moved, UNITS[0])} if "tx" in of else {})


def project_to_semidefinite(C: Array) -> Array:
    """The symmetric matrix (6, 6) without what gives way against the load: noise may leave such a direction.

    A direction whose own entry is below zero goes altogether; scaled by it, what couples it to others would grow
    without bound.
    """
    gives = np.diag(C) > 0.0
    size = np.sqrt(np.where(gives, np.diag(C), 1.0))
    kept = np.where(np.outer(gives, gives), C, 0.0)
    w, V = np.linalg.eigh(kept / np.outer(size, size))
    return kept if w[0] >= 0.0 else np.asarray((V * np.maximum(w, 0.0)) @ V.T * np.outer(size, size))


def read_body_law(given: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """A beam, a symmetric matrix with 21 coefficients, or its diagonal: what the keys of a file mean.

    Raises:
        InputError: a form that the body has not, or numbers that no body has.
    """
    form, none = find_parameter_form(given, beam=body.length > 0.0), np.empty(0)
    if form == "beam":
        law = UniformBeamLaw.from_keys(given.keys)
        if law.planes:
            body = replace(body, normal=_read_normal(given, body.axes[:, 0]))
        return law, parameter_conversion.read_law_parameters(law, given)[0], none, body
    entries = MatrixEntriesLaw() if form == "full" else MatrixEntriesLaw(DIAGONAL_ENTRIES)
    if form == "full":
        C = given.read_array(MATRIX, (6, 6), np.full((6, 6), np.nan))
        if np.isfinite(C).all():
            _refuse_negative_compliance(given, C)
        return entries, np.array([C[i, j] for i, j in entries.pairs]), none, body
    values = given.read_array(RIGID, (6,), np.full(6, np.nan))
    if (values < 0).any():
        raise given.build_error(RIGID, "expected compliances of at least zero")
    return entries, values, none, body


def find_parameter_form(given: ParameterReader, *, beam: bool) -> str:
    """beam, diagonal or full."""
    if given.has_key(MATRIX):
        return "full"
    if given.has_key(RIGID):
        return "diagonal"
    if not given.has_key("form"):
        return "beam" if beam else "diagonal"
    form = given.read_word("form")
    valid = ("beam", "diagonal", "full") if beam else ("diagonal", "full")
    if form not in valid:
        raise given.build_error("form", f"found {form!r}; valid: {', '.join(valid)}")
    return form


def _read_normal(given: ParameterReader, along: Array) -> Array:
    """(3,) the principal axis that a beam states, made square to it."""
    stated = given.read_array(NORMAL_KEY, (3,))
    square = stated - (stated @ along) * along
    if not np.linalg.norm(square) > LEAST_SINE * np.linalg.norm(stated):
        raise given.build_error(NORMAL_KEY, f"found {stated.tolist()}, along the beam; an axis across it would work")
    return normalise_vectors(square)


def _refuse_negative_compliance(given: ParameterReader, C: Array) -> None:
    if not np.allclose(C, C.T, rtol=SYMMETRY_TOLERANCE, atol=1e-9 * np.abs(C).max()):
        raise given.build_error(MATRIX, "is not symmetric; a compliance is")
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    if np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -1e-9 or (np.diag(C) < 0).any():
        raise given.build_error(MATRIX, "gives way against the load in some direction (a negative eigenvalue)")


def compute_section_deflection(
    axes: Sequence[Array],
    length: float,
    tip: Array,
    wrench: Array,
    own: Sequence[tuple[Array, float]] = (),
    at: tuple[Array, Array] | None = None,
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
        at: m from the root, of sections, and the length of a uniform beam that each stands for; None: it is uniform.

    Returns:
        (N, 6, 3) twist of the TCP per unit of 1/EI, 1/EI across, 1/GJ.
    """
    out = np.zeros((len(wrench), 6, 3))
    if at is None:
        nodes, weights = np.polynomial.legendre.leggauss(SECTIONS)
        at = 0.5 * length * (nodes + 1.0), 0.5 * length * weights
    for x, w in zip(*at, strict=True):
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

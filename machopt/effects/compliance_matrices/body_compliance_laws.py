"""Laws of compliant bodies: a uniform beam, and a symmetric compliance matrix or some of its entries.

A beam is clamped at its root and loaded at the frame S at its end. Its x axis points along the beam. If the two
bending planes differ, z is the principal axis that the key ``EI_Nm2`` bends about. The effects that use these laws
are :mod:`machopt.effects.structure.link_compliance`, :mod:`machopt.effects.structure.base_compliance` and
:mod:`machopt.effects.structure.tool_compliance`; :mod:`machopt.stiffness.terms.body_spring` locates S.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machopt.effects import parameter_conversion
from machopt.effects.compliance_matrices.semidefinite_projection import find_nearest_semidefinite
from machopt.effects.compliance_matrices.uniform_beam_law import (
    MATRIX,
    NORMAL_KEY,
    RIGID,
    BodyLawDefaults,
    UniformBeamLaw,
)
from machopt.effects.law_interfaces.parameter_reader import ParameterReader
from machopt.effects.protocol import BodyLaw, CompliantBody, LawParameter, Quantity
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors

LEAST_SINE = 1e-3  # of the angle between a beam and its principal axis
ROWS = ("tx", "ty", "tz", "rx", "ry", "rz")
ALL_ENTRIES = tuple((i, j) for i in range(6) for j in range(i, 6))
DIAGONAL_ENTRIES = tuple((i, i) for i in range(6))
UNITS = ("m/N", "1/N", "rad/(N·m)")  # of two translations, of one and a rotation, of two rotations
SYMMETRY_TOLERANCE = 1e-6  # relative asymmetry allowed for rounding in files


@dataclass(frozen=True)
class MatrixEntriesLaw(BodyLawDefaults):
    """Selected entries of a symmetric compliance matrix at S; all other entries are zero."""

    pairs: tuple[tuple[int, int], ...] = ALL_ENTRIES
    name: str = "compliant in every direction"
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
        """Return one symmetric unit matrix per entry of ``pairs``.

        Args:
            shape: Empty; the law has no shape parameters.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            (P, 6, 6) compliance at S per unit of each coefficient.
        """
        basis = np.zeros((len(self.pairs), 6, 6))
        for p, (i, j) in enumerate(self.pairs):
            basis[p, i, j] = basis[p, j, i] = 1.0
        return basis

    def to_file_parameters(self, values: Array, shape: Array, body: CompliantBody) -> dict[str, Any]:
        """Return the compliance matrix, or its diagonal, as a file states it.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.
            body: Geometry of the compliant body, all joints at zero.

        Returns:
            ``compliance`` (6 × 6, positive semidefinite) or ``compliance_diagonal`` (6).
        """
        C = np.einsum("p,pij->ij", values, self.matrices(shape, body))
        return {RIGID: np.diag(C).tolist()} if self.key == RIGID else {MATRIX: project_to_semidefinite(C).tolist()}

    def project_to_admissible(self, values: Array, metric: Array) -> Array:
        """Return the nearest coefficients of a positive semidefinite matrix.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            metric: (P, P) weight matrix of the least-squares problem: dᵀ metric d is the increase of the residual sum
                for a change d.
        """
        return find_nearest_semidefinite(values, self.pairs, metric)

    def sizes(self, values: Array, shape: Array) -> Mapping[str, Quantity]:
        """Return the largest tilt compliance if the body tilts, and the largest translational compliance.

        Args:
            values: (P,) coefficients of the law (linear), SI, in the order of ``self.coefficients``.
            shape: (S,) shape parameters of the law (nonlinear), SI, in the order of ``self.shape``.

        Returns:
            Quantities by name; the first one is the size of the effect.
        """
        of = {ROWS[i]: abs(float(v)) for (i, j), v in zip(self.pairs, values, strict=True) if i == j}
        moved, tilted = (
            max((of.get(k, 0.0) for k in rows), default=0.0) for rows in (("tx", "ty", "tz"), ("rx", "ry"))
        )
        tilt = {"tilt_compliance": Quantity(tilted, UNITS[2])} if "rx" in of else {}
        return tilt | ({"translation": Quantity(moved, UNITS[0])} if "tx" in of else {})


def project_to_semidefinite(C: Array) -> Array:
    """Return a symmetric matrix without its negative directions, which noise may leave.

    A direction with a negative diagonal entry is removed as a whole. Scaling by that entry would let its couplings to
    other directions grow without bound.

    Args:
        C: (6, 6) symmetric compliance matrix.

    Returns:
        (6, 6) positive semidefinite matrix; C itself if it already is.
    """
    is_compliant = np.diag(C) > 0.0
    size = np.sqrt(np.where(is_compliant, np.diag(C), 1.0))
    reduced = np.where(np.outer(is_compliant, is_compliant), C, 0.0)
    w, V = np.linalg.eigh(reduced / np.outer(size, size))
    return reduced if w[0] >= 0.0 else np.asarray((V * np.maximum(w, 0.0)) @ V.T * np.outer(size, size))


def read_body_law(reader: ParameterReader, body: CompliantBody) -> tuple[BodyLaw, Array, Array, CompliantBody]:
    """Read a beam, a symmetric matrix with 21 coefficients, or its diagonal, depending on the keys of a file.

    Args:
        reader: Reader of the parameters that the file states.
        body: Geometry of the compliant body, all joints at zero.

    Returns:
        The law, its coefficients (P,) and shape (S,) in SI, and the body with the stated principal axis.

    Raises:
        InputError: A form that the body does not have, or numbers that are physically impossible.
    """
    form, none = find_parameter_form(reader, beam=body.length > 0.0), np.empty(0)
    if form == "beam":
        law = UniformBeamLaw.from_keys(reader.keys)
        if law.planes:
            body = replace(body, normal=_read_normal(reader, body.axes[:, 0]))
        return law, parameter_conversion.read_law_parameters(law, reader)[0], none, body
    entries = MatrixEntriesLaw() if form == "full" else MatrixEntriesLaw(DIAGONAL_ENTRIES)
    if form == "full":
        C = reader.read_array(MATRIX, (6, 6), np.full((6, 6), np.nan))
        if np.isfinite(C).all():
            _refuse_negative_compliance(reader, C)
        return entries, np.array([C[i, j] for i, j in entries.pairs]), none, body
    values = reader.read_array(RIGID, (6,), np.full(6, np.nan))
    if (values < 0).any():
        raise reader.build_error(RIGID, "expected compliances of at least zero")
    return entries, values, none, body


def find_parameter_form(reader: ParameterReader, *, beam: bool) -> str:
    """Return the form of the parameters in a file.

    Args:
        reader: Reader of the parameters that the file states.
        beam: Whether the body is long enough to be a beam.

    Returns:
        ``beam``, ``diagonal`` or ``full``.

    Raises:
        InputError: An unknown form.
    """
    if reader.has_key(MATRIX):
        return "full"
    if reader.has_key(RIGID):
        return "diagonal"
    if not reader.has_key("form"):
        return "beam" if beam else "diagonal"
    form = reader.read_word("form")
    valid = ("beam", "diagonal", "full") if beam else ("diagonal", "full")
    if form not in valid:
        raise reader.build_error("form", f"found {form!r}; valid: {', '.join(valid)}")
    return form


def _read_normal(reader: ParameterReader, along: Array) -> Array:
    """Return the stated principal axis (3,) of a beam, made orthogonal to the beam axis."""
    stated = reader.read_array(NORMAL_KEY, (3,))
    square = stated - (stated @ along) * along
    if not np.linalg.norm(square) > LEAST_SINE * np.linalg.norm(stated):
        raise reader.build_error(NORMAL_KEY, f"found {stated.tolist()}, along the beam; an axis across it would work")
    return normalise_vectors(square)


def _refuse_negative_compliance(reader: ParameterReader, C: Array) -> None:
    if not np.allclose(C, C.T, rtol=SYMMETRY_TOLERANCE, atol=1e-9 * np.abs(C).max()):
        raise reader.build_error(MATRIX, "is not symmetric; a compliance is")
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    if np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -1e-9 or (np.diag(C) < 0).any():
        raise reader.build_error(MATRIX, "deflects against the load in some direction (a negative eigenvalue)")

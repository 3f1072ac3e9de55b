"""Compliance that no load can push the wrong way: fitted matrices kept positive semidefinite.

A 6 × 6 compliance with 21 free coefficients follows noise into directions in which the structure would move against
its load. No elastic body does, and the planner refuses such a file. Where a fit ends there, the quadratic of the fit is
minimised anew over C = S L Lᵀ S, which is positive semidefinite whatever L is (Burer & Monteiro 2003: with a square L
there are no minima but the convex problem's); the other coefficients follow within their bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array, Ints

NEGATIVE = 1e-10  # eigenvalue of a matrix of unit diagonal below which it counts as negative; a file may have 1e-9
START_SHARE = 1e-3  # of the largest eigenvalue, what a negative one starts from
STEPS = 2000
CONVERGENCE_TOLERANCE = 1e-13  # relative change of the quadratic at which the search ends


@dataclass(frozen=True)
class FittedMatrix:
    """Where one term's compliance matrix stands among the unknowns."""

    term: int  # index of the term
    first_coefficient: Ints  # (P,) indices of its coefficients
    row: Ints  # (P,) element that each coefficient is
    column: Ints  # (P,)

    def matrix(self, x: Array) -> Array:
        """(6, 6) from all coefficients."""
        C = np.zeros((6, 6))
        C[self.row, self.column] = x[self.first_coefficient]
        C[self.column, self.row] = x[self.first_coefficient]
        return C


def list_fitted_matrices(fit: StiffnessFit) -> tuple[FittedMatrix, ...]:
    """The terms of a fit that are whole symmetric matrices."""
    out = []
    for t, term in enumerate(fit.terms):
        basis = getattr(term, "basis", None)
        if basis is None or all(np.isfinite(c.lower) for c in term.coefficients):
            continue
        at = np.array([p for p, u in enumerate(fit.unknowns) if u.term == t])
        place = np.array([np.argwhere(b != 0)[0] for b in basis])
        out.append(FittedMatrix(t, at, place[:, 0], place[:, 1]))
    return tuple(out)


def has_negative_compliance(C: Array) -> bool:
    """Whether a compliance (6, 6) moves against some load."""
    d = np.diag(C)
    if (d < 0).any():
        return True
    scale = np.sqrt(np.maximum(d, 1e-300))
    return bool(np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -NEGATIVE)


def fit_semidefinite_matrix(
    fit: StiffnessFit, part: FittedMatrix, H: Array, h: Array, x: Array, held: NDArray[np.bool_]
) -> Array:
    """The coefficients with the least ½ uᵀ H u − hᵀ u whose matrix is positive semidefinite.

    Args:
        fit: bounds and scales.
        part: the matrix.
        H, h: normal equations in scaled coefficients u = x / column.
        x: (P,) the minimum without this condition.
        held: (P,) coefficients that stay as they are.

    Returns:
        (P,).
    """
    inside = np.zeros(len(x), bool)
    inside[part.first_coefficient] = True
    free = ~inside & ~held
    diagonal = part.row == part.column
    S = np.empty(6)
    S[part.row[diagonal]] = np.sqrt(fit.column[part.first_coefficient[diagonal]])
    unit = S[part.row] * S[part.column] / fit.column[part.first_coefficient]
    lower = (fit.lower / fit.column)[free]
    values, vectors = np.linalg.eigh(part.matrix(x) / np.outer(S, S))
    L = vectors * np.sqrt(np.maximum(values, START_SHARE * max(values[-1], np.finfo(float).tiny)))
    u = x / fit.column

    def whole(y: Array) -> tuple[Array, Array]:
        root = y[:36].reshape(6, 6)
        out = u.copy()
        out[part.first_coefficient] = (root @ root.T)[part.row, part.column] * unit
        out[free] = y[36:]
        return out, root

    def quadratic(y: Array) -> tuple[float, Array]:
        v, root = whole(y)
        slope = H @ v
        W = np.zeros((6, 6))
        W[part.row, part.column] = (slope - h)[part.first_coefficient] * unit
        return float(0.5 * v @ slope - h @ v), np.concatenate([((W + W.T) @ root).ravel(), (slope - h)[free]])

    first = np.concatenate([L.ravel(), np.maximum(u[free], lower)])
    bounds = [(None, None)] * 36 + [(low if np.isfinite(low) else None, None) for low in lower]
    options = {"maxiter": STEPS, "maxfun": 2 * STEPS, "ftol": CONVERGENCE_TOLERANCE, "gtol": 0.0, "maxcor": 40}
    found = minimize(quadratic, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return np.asarray(whole(np.asarray(found.x, float))[0] * fit.column)

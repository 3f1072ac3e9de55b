"""Positive semidefinite fits of compliance matrices.

A 6 × 6 compliance with 21 free coefficients follows noise into directions in which the structure would move against
its load. No elastic body does, and the planner refuses such a file. In this case the quadratic of the fit is
minimised again over C = S L Lᵀ S, which is positive semidefinite for any L (Burer & Monteiro 2003: with a square L
there are only the minima of the convex problem). The other coefficients follow within their bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array, Ints

NEGATIVE = 1e-10  # eigenvalue of a matrix of unit diagonal below which it counts as negative; a file may have 1e-9
START_SHARE = 1e-3  # start value of a negative eigenvalue, relative to the largest
STEPS = 2000
CONVERGENCE_TOLERANCE = 1e-13  # relative change of the quadratic at which the search ends


@dataclass(frozen=True)
class FittedMatrix:
    """Position of a term's compliance matrix among the unknowns."""

    term: int  # index of the term
    first_coefficient: Ints  # (P,) indices of its coefficients
    row: Ints  # (P,) matrix row of each coefficient
    column: Ints  # (P,)

    def matrix(self, x: Array) -> Array:
        """Return the matrix from all coefficients.

        Args:
            x: Coefficients of the fit, SI.

        Returns:
            (6, 6).
        """
        C = np.zeros((6, 6))
        C[self.row, self.column] = x[self.first_coefficient]
        C[self.column, self.row] = x[self.first_coefficient]
        return C


def list_fitted_matrices(fit: StiffnessFit) -> tuple[FittedMatrix, ...]:
    """List the terms of a fit that are complete symmetric matrices.

    Args:
        fit: Weighted fit of the stiffness.

    Returns:
        Their positions among the unknowns.
    """
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
    """Return whether a compliance matrix is not positive semidefinite.

    Args:
        C: (6, 6) symmetric matrix.

    Returns:
        True if the structure would move against some load.
    """
    d = np.diag(C)
    if (d < 0).any():
        return True
    scale = np.sqrt(np.maximum(d, 1e-300))
    return bool(np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -NEGATIVE)


def fit_semidefinite_matrix(
    fit: StiffnessFit, part: FittedMatrix, H: Array, h: Array, x: Array, is_fixed: NDArray[np.bool_]
) -> Array:
    """Minimise ½ uᵀ H u − hᵀ u subject to a positive semidefinite matrix.

    Args:
        fit: Weighted fit of the stiffness.
        part: Position of the matrix.
        H: (P, P) normal matrix in scaled coefficients u = x / column.
        h: (P,) right-hand side.
        x: (P,) minimum without the condition.
        is_fixed: (P,) True for fixed coefficients.

    Returns:
        (P,) coefficients.
    """
    inside = np.zeros(len(x), bool)
    inside[part.first_coefficient] = True
    free = ~inside & ~is_fixed
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

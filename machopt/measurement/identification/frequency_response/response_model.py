"""Receptance of the arm as a CasADi function, with exact derivatives by stiffness, damping and mass.

Z is complex and symmetric, with a positive definite imaginary part. Its factorisation L D Lᵀ needs no pivots then, and
its elements grow by a factor below 3: Higham, Math. Comput. 67 (1998) 1591.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from machopt.measurement.identification.frequency_response.response_equations import ResponseEquations
from machopt.numerics.array_types import Array, ComplexArray, Ints

DampingLaw = Literal["viscous", "structural"]
JOINTS = 6
Complex = tuple[ca.SX, ca.SX]
_ROWS, _COLUMNS = np.tril_indices(JOINTS)


@dataclass(frozen=True)
class ResponseModel:
    """Functions of log k and log η (12,) and of the data of a row (ω, s, M, j_r, j_e)."""

    equations: ResponseEquations
    law: DampingLaw
    function: ca.Function  # → (2,) Re H, Im H and (2, 12)
    by_mass: ca.Function  # → (2, 21) by the lower triangle of M

    def evaluate(self, x: Array, rows: Ints | None = None) -> tuple[ComplexArray, ComplexArray]:
        """Return the receptance and its derivatives.

        Args:
            x: (12,) log of k in N·m/rad and of η.
            rows: rows to evaluate; None: all.

        Returns:
            (N,) m/N and (N, 12).
        """
        data = self._build_data(rows)
        values, slopes = self.function.map(data.shape[1])(ca.DM(x), ca.DM(data))
        H = np.asarray(values)
        J = np.asarray(slopes).reshape(2, data.shape[1], 2 * JOINTS)
        return H[0] + 1j * H[1], J[0] + 1j * J[1]

    def evaluate_mass_derivatives(self, x: Array) -> ComplexArray:
        """Return the derivatives by the relative mass and inertia of each link, (N, 6) m/N.

        Args:
            x: (12,) log of k and η.
        """
        data = self._build_data(None)
        found = np.asarray(self.by_mass.map(data.shape[1])(ca.DM(x), ca.DM(data))).reshape(2, data.shape[1], -1)
        parts = self.equations.body_mass[:, :, _ROWS, _COLUMNS]
        return np.asarray(np.einsum("nt,bnt->nb", found[0] + 1j * found[1], parts))

    def _build_data(self, rows: Ints | None) -> Array:
        e = self.equations
        scale = e.omega / e.reference if self.law == "viscous" else np.ones(len(e.omega))
        data = np.column_stack([e.omega, scale, e.mass[:, _ROWS, _COLUMNS], e.response, e.excitation])
        return np.asarray((data if rows is None else data[rows]).T)


def build_response_model(equations: ResponseEquations, law: DampingLaw) -> ResponseModel:
    """Return the model of all rows with one damping law.

    Args:
        equations: Data of all rows.
        law: viscous or structural.
    """
    x, row = ca.SX.sym("x", 2 * JOINTS), ca.SX.sym("row", 2 + len(_ROWS) + 2 * JOINTS)
    omega, scale = row[0], row[1]
    mass = row[2 : 2 + len(_ROWS)]
    response, excitation = row[2 + len(_ROWS) : 2 + len(_ROWS) + JOINTS], row[2 + len(_ROWS) + JOINTS :]
    Z: dict[tuple[int, int], Complex] = {}
    for n, (i, j) in enumerate(zip(_ROWS.tolist(), _COLUMNS.tolist(), strict=True)):
        Z[i, j] = (-(omega**2) * mass[n], ca.SX(0.0))
        if i == j:
            k = ca.exp(x[i])
            Z[i, j] = (Z[i, j][0] + k, k * ca.exp(x[JOINTS + i]) * scale)
    solved = _solve(Z, [(excitation[i], ca.SX(0.0)) for i in range(JOINTS)])
    H = ca.vertcat(*(sum((response[i] * solved[i][part] for i in range(JOINTS)), ca.SX(0.0)) for part in (0, 1)))
    return ResponseModel(
        equations,
        law,
        ca.Function("receptance", [x, row], [H, ca.jacobian(H, x)]),
        ca.Function("receptance_by_mass", [x, row], [ca.jacobian(H, mass)]),
    )


def _solve(Z: dict[tuple[int, int], Complex], right: list[Complex]) -> list[Complex]:
    """Return Z⁻¹ b by L D Lᵀ; Z is given by its lower triangle and overwritten by L and D."""
    for j in range(JOINTS):
        for i in range(j + 1, JOINTS):
            factor = _divide(Z[i, j], Z[j, j])
            for k in range(j + 1, i + 1):
                Z[i, k] = _subtract_product(Z[i, k], factor, Z[k, j])
            right[i] = _subtract_product(right[i], factor, right[j])
    for i in range(JOINTS - 1, -1, -1):
        for k in range(i + 1, JOINTS):
            right[i] = _subtract_product(right[i], Z[k, i], right[k])
        right[i] = _divide(right[i], Z[i, i])
    return right


def _subtract_product(a: Complex, b: Complex, c: Complex) -> Complex:
    return a[0] - b[0] * c[0] + b[1] * c[1], a[1] - b[0] * c[1] - b[1] * c[0]


def _divide(a: Complex, b: Complex) -> Complex:
    size = b[0] ** 2 + b[1] ** 2
    return (a[0] * b[0] + a[1] * b[1]) / size, (a[1] * b[0] - a[0] * b[1]) / size

"""The stiffness that a diagnosis leaves: joints as refitted, and the terms with what was found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.diagnose.result import Coefficient, Diagnosis
from machopt.domain.cell import Cell
from machopt.domain.stiffness import Stiffness, Term

Array = NDArray[np.float64]
JOINTS = 6
LEAST_COMPLIANCE = 1e-10  # rad/(N·m), of a joint that no load moved
CERTAIN_JOINT = 0.5  # standard error per compliance from which on a joint keeps the cell's value


def stiffness_of(cell: Cell, d: Diagnosis) -> tuple[Stiffness | None, Stiffness | None]:
    """Joints as refitted and terms, without and with what was found; what the data do not show is the cell's.

    None where the cell has no stiffness and the data show fewer than six joints.
    """
    springs = {c.unknown.spring: c for c in d.coefficients if c.unknown.spring is not None}
    found = tuple(f.correction for f in d.findings if isinstance(f.correction, Term))
    known = () if cell.stiffness is None else cell.stiffness.terms
    new = {(t.effect, t.location) for t in found}
    terms = (*(t for t in known if (t.effect, t.location) not in new), *found)
    if not springs:
        return cell.stiffness, None if cell.stiffness is None else replace(cell.stiffness, terms=terms)
    if cell.stiffness is None and len(springs) < JOINTS:
        return None, None
    prior = None if cell.stiffness is None else cell.stiffness.joints

    def stiffness(of: Callable[[Coefficient], float]) -> Array:
        out = []
        for j in range(JOINTS):
            c = springs.get(j + 1)
            value = 0.0 if c is None else of(c)
            sure = c is not None and value > LEAST_COMPLIANCE and c.sigma < CERTAIN_JOINT * value
            if not sure and prior is not None:
                out.append(float(prior[j]))
            else:
                out.append(1.0 / max(value, LEAST_COMPLIANCE))
        return np.array(out)

    return Stiffness(stiffness(lambda c: c.before), terms=known), Stiffness(stiffness(lambda c: c.value), terms=terms)

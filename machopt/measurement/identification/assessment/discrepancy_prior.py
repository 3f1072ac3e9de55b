"""Prior of the model discrepancy: which effects may be missing, and how large each of them typically is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.discrepancy_names import JOINT, LOADED, parse_discrepancy_name
from machopt.kinematics.robot import ArmState
from machopt.numerics.array_types import Array
from machopt.stiffness.discrepancy_columns import (
    PLAY_COLUMN,
    TYPICAL_PLAY_RAD,
    DiscrepancyColumns,
    compute_typical_sizes,
    list_elastic_columns,
    list_gear_columns,
)
from machopt.stiffness.terms.term_interface import LinearTerm

FITTED_COEFFICIENT_SIGMA = 3.0  # relative prior 1 sigma of a fitted coefficient: nearly uninformative


@dataclass(frozen=True, kw_only=True)
class ScaledColumns:
    """Columns of the model's own coefficients and of all effects that may be missing, in prior units."""

    names: tuple[str, ...]  # (P,)
    own: int  # number of the model's own coefficients, which come first
    Z: Array  # (N, D, P) displacement per unit
    unit: Array  # (P,) prior standard deviation or typical size of each coefficient
    known: Array  # (P,) prior mean in these units: 1 for the effect of the load itself
    group: Array  # (P,) index of the spread: own, elastic, gear, loaded
    usual: Array  # (P,) typical backlash in these units; 0 for others


def build_scaled_columns(
    suspects: DiscrepancyColumns, state: ArmState, k: Array, wrench: Array, dimensions: int
) -> ScaledColumns:
    """Build the columns of the model's own coefficients, of elastic effects, of gears and of the load itself.

    Args:
        suspects: Columns of the model's own coefficients.
        state: Arm states of the readings, with bodies.
        k: (n,) joint stiffness of the model, N·m/rad.
        wrench: (N, 6) load of each reading, N and N·m.
        dimensions: Number of coordinates that were measured: 3, or 6 with rotations.

    Returns:
        The columns in prior units.
    """
    weighed = suspects.masses is not None
    joints = state.q.shape[1]
    gears = list_gear_columns(joints)
    more = (*list_elastic_columns(joints), *gears, *([LOADED] if weighed else []))
    suspected = replace(suspects, names=(*suspects.names, *more))
    Z = suspected.compute_columns(state, np.broadcast_to(k, (len(wrench), joints)), wrench)[:, :dimensions]
    unit = np.concatenate([_compute_prior_sigma(suspects, k), compute_typical_sizes(suspected, state, k, more)])
    known = np.zeros(len(unit))
    known[-1] = float(weighed)
    has_play = [parse_discrepancy_name(n).kind == PLAY_COLUMN for n in suspected.names]
    group = [0] * len(suspects.names) + [{True: 2}.get(n in gears, 3 if n == LOADED else 1) for n in more]
    return ScaledColumns(
        names=suspected.names,
        own=len(suspects.names),
        Z=Z * unit,
        unit=unit,
        known=known,
        group=np.array(group),
        usual=np.where(has_play, TYPICAL_PLAY_RAD, 0.0) / np.maximum(unit, 1e-300),
    )


def _compute_prior_sigma(suspects: DiscrepancyColumns, k: Array) -> Array:
    """Return the prior standard deviations (P,) of the model's own coefficients."""
    c = 1.0 / np.asarray(k, float)
    out = []
    for name in suspects.names:
        part = parse_discrepancy_name(name)
        if part.kind == JOINT:
            out.append(c[part.numbers[0]])
        else:
            n, p = part.numbers
            out.append(_compute_coefficient_scale(suspects.terms[n], p))
    return np.array(out)


def _compute_coefficient_scale(term: LinearTerm, p: int) -> float:
    """Return the prior standard deviation of a term's coefficient.

    A compliance that is zero in a body with other compliances of the same unit is not known to be zero: torsion of a
    soft base about z is inseparable from joint 1, whose spring contains it then.
    """
    own, values = term.coefficients[p], np.abs(term.values)
    if values[p] > 0 or own.lower < 0:
        return FITTED_COEFFICIENT_SIGMA * float(values[p])
    alike = [float(v) for c, v in zip(term.coefficients, values, strict=True) if c.unit == own.unit and c.lower == 0]
    return max(alike, default=0.0)

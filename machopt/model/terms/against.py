"""Springs that would give way against the load, which no arm does: the file that asks for them is refused.

Each joint is looked at where it is stiffest: at the angle within its limits and the torque at which its terms take
most of its compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.model.terms.base import LinearTerm
from machopt.model.terms.compensator import GravityCompensator
from machopt.model.terms.joint import JointCoupling, PoseDependentSpring, SectorSpring
from machopt.model.terms.laws import TorqueLaw

Array = NDArray[np.float64]
Limits = tuple[Array, Array]
LEAST = 1e-9  # of the joints' own compliances: less than that in some direction is rounding or negative
FLAT = 0.9  # of a joint's compliance that a cubic may take: a gear tenfold as stiff as unloaded is out of its reach
STEPS = 2001  # of a joint's range; between them a second harmonic is missed by 1e-5 of itself


def within_reach(terms: Sequence[LinearTerm], k: Array, limits: Limits | None) -> tuple[LinearTerm, ...]:
    """The terms with each hardening cubic held to the torques at which it still is a spring.

    c τ + b τ³ with b < 0 turns back at τ² = c/(3|b|); it goes on along its tangent from where it has taken FLAT of what
    the joint's other terms leave of c.

    Args:
        terms: of a stiffness file.
        k: (C, 6) N·m/rad, of each grid cell and of the constant model.
        limits: lower and upper (6,) rad; None: any angle.
    """
    if not any(_hardens(t) for t in terms):
        return tuple(terms)
    rest = [t for t in terms if not _hardens(t)]
    own = 1.0 / (np.asarray(k, float) + _beside(rest, limits, most=True))
    left = (own + sum((take for _, take, _ in _taken(rest, limits)), np.zeros(6))).min(axis=0)
    return tuple(
        replace(t, reach=float(np.sqrt(FLAT * max(left[t.i], 0.0) / (3.0 * -t.values[0]))))
        if isinstance(t, TorqueLaw) and _hardens(t) else t
        for t in terms
    )  # fmt: skip


def _hardens(term: LinearTerm) -> bool:
    return isinstance(term, TorqueLaw) and term.law == "cubic" and bool(term.values[0] < 0.0)


def against_load(terms: Sequence[LinearTerm], k: Array, limits: Limits | None) -> str:
    """What makes the joints' compliance matrix not positive somewhere, in words; empty where nothing does.

    The matrix is diag(1/k + what each joint's terms add at least) with the couplings beside the diagonal.

    Args:
        terms: of a stiffness file; those of bodies are positive by themselves.
        k: (C, 6) N·m/rad, of each grid cell and of the constant model.
        limits: lower and upper (6,) rad; None: any angle.
    """
    k = np.asarray(k, float)
    weakest = k + _beside(terms, limits, most=False)
    if (weakest <= LEAST * k).any():
        row, i = np.argwhere(weakest <= LEAST * k)[0]
        return (
            f"gravity_compensator takes up to {k[row, i] - weakest[row, i]:.3g} N·m/rad from joint {i + 1}, which has "
            f"{k[row, i]:.3g}; less than that would work"
        )
    own = 1.0 / (k + _beside(terms, limits, most=True))
    taken = _taken(terms, limits)
    least = sum((take for _, take, _ in taken), np.zeros(6))
    lost = own + least <= LEAST * own
    if lost.any():
        row, i = np.argwhere(lost)[0]
        effect, take, where = min(taken, key=lambda part: part[1][i])
        together = "" if np.isclose(take[i], least[i]) else f", {-least[i]:.3g} with the joint's other terms,"
        return (
            f"{effect} takes {-take[i]:.3g} rad/(N·m){together} from joint {i + 1}{where}, which has "
            f"{own[row, i]:.3g} (1/stiffness); less than that would work"
        )
    coupling = np.zeros((6, 6))
    for term in terms:
        if isinstance(term, JointCoupling):
            coupling[term.i, term.j] = coupling[term.j, term.i] = term.values[0]
    scale = np.sqrt(own + least)
    values = np.linalg.eigvalsh(np.eye(6) + coupling / scale[:, :, None] / scale[:, None, :])
    row = int(values[:, 0].argmin())
    if values[row, 0] > LEAST:
        return ""
    share = np.abs(coupling) / np.outer(scale[row], scale[row])
    i, j = (int(v) for v in np.unravel_index(int(share.argmax()), share.shape))
    return (
        f"with a joint_coupling of {coupling[i, j]:.3g} rad/(N·m) between joints {i + 1} and {j + 1} some load moves "
        f"the arm towards itself; at most √(c{i + 1} c{j + 1}) = {scale[row, i] * scale[row, j]:.3g} is possible"
    )


def _taken(terms: Sequence[LinearTerm], limits: Limits | None) -> list[tuple[str, Array, str]]:
    """Effect, what it adds at least to each joint's compliance (6,), where; only of terms that take some."""
    out = []
    for term in terms:
        take, where = np.zeros(6), ""
        if isinstance(term, PoseDependentSpring | SectorSpring):
            at = _range(term.i, limits, term)
            value = term.own(at)
            take[term.i] = value.min()
            where = f" at {np.degrees(at[value.argmin()]):.0f} deg"
        elif isinstance(term, TorqueLaw):
            take[term.i] = term.least_slope()
        if (take < 0.0).any() or isinstance(term, PoseDependentSpring):
            out.append((term.effect, take, where))
    return out


def _beside(terms: Sequence[LinearTerm], limits: Limits | None, *, most: bool) -> Array:
    """(6,) N·m/rad that springs beside the gears add, at the angle where that is most or least."""
    out = np.zeros(6)
    for term in terms:
        if isinstance(term, GravityCompensator):
            value = term.added(_range(term.i, limits))
            out[term.i] += value.max() if most else value.min()
    return out


def _range(i: int, limits: Limits | None, term: LinearTerm | None = None) -> Array:
    """Angles of a joint to look at, and those at which a term is known to be extreme."""
    low, high = (-np.pi, np.pi) if limits is None else (float(limits[0][i]), float(limits[1][i]))
    at = np.linspace(low, high, STEPS)
    known = np.empty(0)
    if isinstance(term, PoseDependentSpring) and len(term.values) == 2:
        known = np.arctan2(-term.values[1], -term.values[0])  # where a cos q + b sin q is least
        known = known + 2 * np.pi * np.arange(
            np.ceil((low - known) / (2 * np.pi)), np.floor((high - known) / (2 * np.pi)) + 1
        )
    elif isinstance(term, SectorSpring):
        known = np.array([term.centre if limits is None else np.clip(term.centre, low, high)])
    return np.concatenate([at, known])

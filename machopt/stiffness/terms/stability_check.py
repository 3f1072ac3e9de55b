"""Check for springs that are unstable under load, which no arm has: a file with such springs is refused.

Each joint is checked at its stiffest state: the angle within its limits and the torque at which its terms reduce
its compliance most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.effect_locations import format_joint_location, format_joint_pair_location
from machopt.numerics.array_types import Array
from machopt.stiffness.terms.term_interface import LinearTerm

JointLimits = tuple[Array, Array]
MIN_COMPLIANCE_SHARE = 1e-9  # of the joints' own compliances: smaller eigenvalues are rounding errors or negative
ANGLE_SAMPLES = 2001  # samples of a joint's range; a second harmonic is resolved to 1e-5 of its amplitude


@dataclass(frozen=True)
class UnstableTerm:
    """Term that reduces the compliance of its joint below zero."""

    effect: str
    location: str
    reason: str  # message, with what would work


def limit_to_spring_range(terms: Sequence[LinearTerm], k: Array, limits: JointLimits | None) -> tuple[LinearTerm, ...]:
    """Return the terms with each law limited to where it is a spring: a hardening cubic has no natural limit.

    A law may use up a share of the compliance that the joint's other terms leave.

    Args:
        terms: of a stiffness file.
        k: (C, n) N·m/rad, of each grid cell and of the constant model.
        limits: lower and upper (n,) rad; None: any angle.
    """
    ends = _get_limit_ends(limits, np.shape(k)[1])
    endless = [(least := t.bound_compliance(*ends)) is not None and bool(np.isneginf(least[1])) for t in terms]
    if not any(endless):
        return tuple(terms)
    rest = [t for t, e in zip(terms, endless, strict=True) if not e]
    k = np.asarray(k, float)
    own = 1.0 / (k + _compute_parallel_stiffness(rest, limits, k.shape[1], most=True))
    left = (
        own + sum((take for _, take, _ in _list_compliance_bounds(rest, limits, own.shape[1])), np.zeros(own.shape[1]))
    ).min(axis=0)
    return tuple(t.limit_to_spring_range(left) if e else t for t, e in zip(terms, endless, strict=True))


def find_unstable_term(terms: Sequence[LinearTerm], k: Array, limits: JointLimits | None) -> UnstableTerm | None:
    """Return the term that makes the joints' compliance matrix indefinite somewhere; None where it is positive.

    The matrix is diag(1/k + lower bound of each joint's terms) with the couplings off the diagonal.

    Args:
        terms: of a stiffness file; those of bodies are always positive.
        k: (C, n) N·m/rad, of each grid cell and of the constant model.
        limits: lower and upper (n,) rad; None: any angle.
    """
    k = np.asarray(k, float)
    weakest = k + _compute_parallel_stiffness(terms, limits, k.shape[1], most=False)
    if (weakest <= MIN_COMPLIANCE_SHARE * k).any():
        row, i = np.argwhere(weakest <= MIN_COMPLIANCE_SHARE * k)[0]
        message = (
            f"gravity_compensator takes up to {k[row, i] - weakest[row, i]:.3g} N·m/rad from joint {i + 1}, which has "
            f"{k[row, i]:.3g}; less than that would work"
        )
        return UnstableTerm("gravity_compensator", format_joint_location(i + 1), message)
    own = 1.0 / (k + _compute_parallel_stiffness(terms, limits, k.shape[1], most=True))
    bounds = _list_compliance_bounds(terms, limits, k.shape[1])
    least = sum((take for _, take, _ in bounds), np.zeros(own.shape[1]))
    lost = own + least <= MIN_COMPLIANCE_SHARE * own
    if lost.any():
        row, i = np.argwhere(lost)[0]
        effect, take, where = min(bounds, key=lambda part: float(part[1][i]))
        together = "" if np.isclose(take[i], least[i]) else f", {-least[i]:.3g} with the joint's other terms,"
        message = (
            f"{effect} takes {-take[i]:.3g} rad/(N·m){together} from joint {i + 1}{where}, which has "
            f"{own[row, i]:.3g} (1/stiffness); less than that would work"
        )
        return UnstableTerm(effect, format_joint_location(i + 1), message)
    coupling = np.zeros((own.shape[1], own.shape[1]))
    for term in terms:
        if term.coupled_joints is not None:
            i, j, slope = term.coupled_joints
            coupling[i, j] = coupling[j, i] = slope
    scale = np.sqrt(own + least)
    values = np.linalg.eigvalsh(np.eye(len(coupling)) + coupling / scale[:, :, None] / scale[:, None, :])
    row = int(values[:, 0].argmin())
    if values[row, 0] > MIN_COMPLIANCE_SHARE:
        return None
    share = np.abs(coupling) / np.outer(scale[row], scale[row])
    i, j = sorted(int(v) for v in np.unravel_index(int(share.argmax()), share.shape))
    return UnstableTerm(
        "joint_coupling",
        format_joint_pair_location(i + 1, j + 1),
        f"with a joint_coupling of {coupling[i, j]:.3g} rad/(N·m) between joints {i + 1} and {j + 1} some load moves "
        f"the arm towards itself; at most √(c{i + 1} c{j + 1}) = {scale[row, i] * scale[row, j]:.3g} is possible",
    )


def _list_compliance_bounds(
    terms: Sequence[LinearTerm], limits: JointLimits | None, joints: int
) -> list[tuple[str, Array, str]]:
    """Return effect, lower bound of its contribution to each joint's compliance (6,), and location, of reducing
    terms only.
    """
    out = []
    for term in terms:
        found = term.bound_compliance(*_get_limit_ends(limits, joints))
        if found is None:
            continue
        i, least, angle = found
        if least < 0.0:
            take = np.zeros(joints)
            take[i] = least
            out.append((term.effect, take, f" at {np.degrees(angle):.0f} deg" if np.isfinite(angle) else ""))
    return out


def _compute_parallel_stiffness(
    terms: Sequence[LinearTerm], limits: JointLimits | None, joints: int, *, most: bool
) -> Array:
    """Return (6,) N·m/rad of springs parallel to the gears, at the angle where that is largest or smallest."""
    out = np.zeros(joints)
    for term in terms:
        if term.parallel_joint is not None:
            value = term.compute_parallel_stiffness(_list_joint_angles(term.parallel_joint, limits, joints))
            out[term.parallel_joint] += value.max() if most else value.min()
    return out


def _get_limit_ends(limits: JointLimits | None, joints: int) -> JointLimits:
    return (np.full(joints, -np.pi), np.full(joints, np.pi)) if limits is None else limits


def _list_joint_angles(i: int, limits: JointLimits | None, joints: int) -> Array:
    """Return the angles of a joint to check."""
    low, high = _get_limit_ends(limits, joints)
    return np.linspace(float(low[i]), float(high[i]), ANGLE_SAMPLES)

"""Joint or term that causes most of an error, and the shares of the variance by source."""

from __future__ import annotations

import numpy as np

from machopt.data_types.effect_locations import format_joint_location
from machopt.numerics.array_types import Array
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.tolerance.error_sensitivities import TargetPoses
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.stiffness.joint_stiffness import compute_joint_stiffness


def compute_contributions(plan: Plan, poses: TargetPoses, wrench: Array, direction: Array) -> tuple[list[str], Array]:
    """Return the names of the compliant parts, and (M, n) the displacement of each along a direction in m.

    Args:
        plan: Plan of one tool.
        poses: M poses of the plan.
        wrench: (M, 6) N and N·m on the tool, in base_link.
        direction: (M, 3) unit, in base_link.
    """
    elasticity, arm = plan.setup.elasticity, plan.setup.arm
    names = [format_joint_location(j) for j in range(1, 7)]
    names += [f"{t.effect} {t.location}" for t in elasticity.terms] + ["discrepancy", "external axes", "part"]
    out = np.full((len(wrench), len(names)), np.nan)
    known = np.flatnonzero(poses.is_reached)
    if not len(known):
        return names, out
    place = arm.places(poses.external[known], poses.position[known])
    k = compute_joint_stiffness(elasticity.stiffness, place).k
    carrier = ExternalJointCompliance.build(arm.machine, elasticity.stiffness.external)
    elastic = elasticity.evaluate(poses.q[known], k)
    w, e = wrench[known], direction[known]
    J = elastic.state.J
    along = np.einsum("mci,mc->mi", J[:, :3], e)
    out[known, :6] = along * np.einsum("mci,mc->mi", J, w) / elastic.k
    out[known, 6:] = 0.0
    known_terms = [term.combine_coefficients() for term in elasticity.terms]
    for n, term in enumerate(known_terms):
        if term is not None:
            twist = term.compute_twist(elastic.loaded_state, w, small=True)
            out[known, 6 + n] = np.einsum("mc,mc->m", twist[:, :3], e)
    if elasticity.shift is not None:
        twist = elasticity.shift.compute_twist(elastic.loaded_state, w, small=True)
        out[known, -3] = np.einsum("mc,mc->m", twist[:, :3], e)
    if carrier is not None:
        C = carrier.compute_compliance(poses.external[known], place)
        out[known, -2] = np.einsum("mi,mij,mj->m", e, C[:, :3], w)
    part = plan.setup.cell.workpiece.stiffness
    if part is not None:
        R = poses.cam_axes[known]
        pressed = np.einsum("mij,mi->mj", R, w[:, :3]) / part
        out[known, -1] = np.einsum("mi,mij,mj->m", e, R, pressed)
    return names, out


def name_largest(names: list[str], contributions: Array, total: Array) -> tuple[str, ...]:
    """Return the largest contribution to each error with its share, e.g. ``joint:2 0.61``.

    The share is that of the sum of all sizes, because contributions may cancel. Only what adds to the error is named.

    Args:
        names: Names of the columns.
        contributions: (M, n) m.
        total: (M,) m, the error, whose sign the contributions are compared with.
    """
    out = []
    for row, whole in zip(contributions, total, strict=True):
        if not np.isfinite(row).all() or not np.isfinite(whole) or whole == 0:
            out.append("")
            continue
        n = int(np.argmax(row * np.sign(whole)))
        out.append(f"{names[n]} {abs(row[n]) / np.abs(row).sum():.2f}")
    return tuple(out)

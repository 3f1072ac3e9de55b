"""Displacement by weight through the springs of external joints, which is not part of any index
(:mod:`machopt.stiffness.external_joint_compliance`).
"""

from __future__ import annotations

import numpy as np

from machopt.kinematics.robot import ArmState, RobotMasses
from machopt.numerics.array_types import Array
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance

MIN_REPORTED_M = 1e-6  # m: smaller displacements are not reported
BLOCK = 4096  # points at a time


def compute_base_wrench(masses: RobotMasses, state: ArmState) -> Array:
    """Return the (M, 6) wrench in N, N·m of links and tool on base_link, about its origin and in its axes.

    Args:
        masses: masses of links and tool.
        state: kinematic state of the arm, with bodies.

    Raises:
        ValueError: the state has no bodies.
    """
    if state.R_bodies is None or state.p_bodies is None:
        raise ValueError("an ArmState with bodies is needed")
    R, p = state.R_bodies[:, masses.body], state.p_bodies[:, masses.body]
    at = np.einsum("mbij,bj->mbi", R, masses.com) + p
    force = np.broadcast_to(masses.mass.sum() * masses.gravity, (len(R), 3))
    moment = np.cross(np.einsum("mbi,b->mi", at, masses.mass), masses.gravity)
    return np.concatenate([force, moment], axis=1)


def compute_settlement(plan: Plan) -> Array | None:
    """Return the (P, 3) displacement in m of the tool relative to the part by weight, compared with all joints at home.

    At home part and base were measured. Workpiece axes, NaN without a configuration. None where no external joint is
    compliant or no weight is known.

    Args:
        plan: plan of one tool.
    """
    setup, path, a = plan.setup, plan.path, plan.chosen.assignment
    springs, masses = setup.elasticity.stiffness.external, setup.elasticity.masses
    found = ExternalJointCompliance.build(setup.arm.machine, springs)
    if found is None or not any(s.is_compliant for s in springs) or masses is None:
        return None
    out = np.full(path.position.shape, np.nan)
    ok = np.flatnonzero(np.isfinite(a.q).all(axis=1))

    def at(q: Array, external: Array, place: Array) -> Array:
        arm = compute_base_wrench(masses, setup.robot.compute_state(q, setup.arm.T_flange_tcp, bodies=True))
        return found.compute_gravity_settling(external, place, arm)

    home = setup.driven.home[None], setup.cell.external_home[None]
    for first in range(0, len(ok), BLOCK):
        some = ok[first : first + BLOCK]
        q, e = (np.repeat(v, len(some), axis=0) for v in home)
        out[some] = at(a.q[some], path.external[some], path.position[some]) - at(q, e, path.position[some])
    return out


def describe_settlement(plan: Plan) -> list[str]:
    """Return a sentence where the displacement is not negligible.

    Args:
        plan: plan of one tool.
    """
    moved = compute_settlement(plan)
    if moved is None:
        return []
    size = np.where(plan.path.counted, np.linalg.norm(moved, axis=1), np.nan)
    if not np.nanmax(size, initial=0.0) > MIN_REPORTED_M:
        return []
    worst = int(np.nanargmax(size))
    return [
        f"Weight on the springs of the external joints (stiffness.yaml) moves the tool against the part by up to "
        f"{1e3 * size[worst]:.3g} mm (point {plan.path.index[worst]:g}) otherwise than at home: what process forces do "
        "comes on top of it, so that no index counts it, and nothing compensates it."
    ]

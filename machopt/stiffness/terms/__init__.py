"""Elastic effects besides the joint springs, composable, each usable by the planner, identify and diagnose.

A term returns the twist δ of the TCP caused by a wrench w at the TCP at a configuration, per unit of
each of its coefficients x::

    stiffness.yaml terms ──compile_terms──► LinearTerm …           δ = Σ_p x_p B_p(q) w
                                                │
    ArmState (q, J, bodies) ──response(state, w)┴─► (M, 6, P)

Compliances of serial parts add at the TCP once they are transformed there (tian2025 eq. 1,
zhang2025 eq. 20). The laws themselves are in :mod:`machopt.effects`; here they are transformed to the TCP:
:mod:`joint_term` (any law of one joint's torque, and coupling), :mod:`gravity_compensator` (the balancer of joint 2),
:mod:`body_spring` (base, links, tool); :mod:`stability_check` refuses terms that are unstable under load.
"""

from machopt.stiffness.terms.term_builder import build_fitted_term, compile_terms, list_effects_and_locations
from machopt.stiffness.terms.term_interface import LinearTerm

__all__ = ["LinearTerm", "build_fitted_term", "compile_terms", "list_effects_and_locations"]

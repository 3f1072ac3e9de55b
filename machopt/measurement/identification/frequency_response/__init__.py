"""Joint stiffness and damping from measured frequency responses: ``machopt identify`` of a recording of kind ``frf``.

::

    FrequencyResponseRecording ─► response_equations ─► response_fit ─► joint_bounds ─► FrequencyResponseResult
                                  mass matrices,        start, noise    identified,     ▲          │
                                  directions at the     of each         prior or        │          └─► document, files
                                  joints, units         response        lower bound     │
                                                        ▲                               └─ modal_damping
                                                        └─ response_model: CasADi, exact derivatives

Model: H(ω) = j_rᵀ Z⁻¹ j_e, Z = K (1 + i η s(ω)) − ω² M(q), K and η diagonal, rotors locked, j = J_vᵀ d of sensor and
force. s = 1: structural damping; s = ω/ω_0: viscous, d_j = η_j k_j/ω_0 with the median frequency ω_0. M comes from
the URDF and the cell's tool, as in the stability limits of the plan. Both laws are fitted, the likelier one is taken.

Unknowns are log k and log η. A joint that the responses do not determine keeps a prior (the cell's stiffness within a
factor e) while the others are fitted, so that their intervals contain its uncertainty. It gets a lower bound by the
profile of the likelihood, and no two-sided interval. CasADi is imported by ``response_model`` only, for this kind only.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 6 (M); Ewins, Modal Testing, 2nd ed. (2000), ch. 2.
"""

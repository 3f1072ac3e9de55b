"""Rotation, external joints and feed of a plan optimised together (``--method joint``), with CasADi and IPOPT.

The ordinary plan is made first. Its rotation is chosen for stiffness; the feed that keeps the tolerance follows from
it. Here both are chosen together, for the shortest time:

::

    plan ─► advise feeds ─► retime = fixed-path result
      │
      └─► windows ─► local limits ─► solve ─► exact joints ─► checks ─► advise feeds ─► retime ─► accept or refuse
                          ▲            │                                                             │
                          └────────────┴────────────── next iterate, smaller step ◄──────────────────┘

:mod:`.posture_feed_pipeline` lists these stages. Variables at each node k of a window are the joints x_k of the
machine, the rotation φ_k and the speed w_k of the segment to the next node. Σ h_k/w_k is minimised subject to

- p(x_k) = p_ref and R(x_k) = R(φ_k): exact and symbolic (:mod:`.symbolic_machine`),
- |n·C(x_k)(f₀ + f₁ v_k)| ≤ t_k: compliance by the joints' springs, symbolic; t_k is the nominal error at which the
  feed advice of the last iterate reaches the quantile, so that all other terms of the stiffness and every uncertainty
  are in it (:mod:`.node_loads`),
- velocity, acceleration and jerk of all moving axes, from differences between nodes; joint limits, range of φ, feed,
- distance of bodies, margins to singularities and depth limit of chatter, linear in φ_k and the external joints at each
  iterate (:mod:`.local_limits`).

The result of a window is its rotation curve and its external joints alone. Joints at all planning points, collisions,
margins, feeds and the motion follow from it by the code of every other plan (:mod:`.window_trial`), which decides. A
window is accepted where its run is driven faster than before, no contact or margin is lost, and no further point leaves
its tolerance. At its ends inside a run a window keeps the rotation of the points before and after it, so that position,
velocity and acceleration of all axes continue.

CasADi is imported by :mod:`.symbolic_machine` and :mod:`.window_problem` only, and these only for this method.
"""

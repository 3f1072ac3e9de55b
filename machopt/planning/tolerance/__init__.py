"""Predicted error at holes and machined surfaces, and the probability that their tolerances hold.

::

    plan, loads of the points ─► targets ─► error_model ─┐
    stiffness file ─► stiffness_spread ─► draws ─────────┴► probability ─► point_errors (columns of points.csv)

A *target* is a point with a tolerance: the deepest point of a hole, or a cut point of a milled surface. Its error is
linear in the load for one draw of the stiffness (without K_C):

    e = Σ_k g_k (A a_k + B b_k) + f/k_part + lost motion + position of arm and part − compensation

a_k, b_k are the twists by the unit loads of the cut, g_k the draw of the stiffness, A and B the draw of the loads.
"""

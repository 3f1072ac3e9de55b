"""Which poses and loads to measure: ``machopt plan-poses``.

::

    cell ─► candidates ─► loadcases ─► search ─► accuracy, certificate ─► schedule ─► poses.csv
            limits, KCI,  hung, pulled, D-optimal  promised errors,        order of
            clearance     on an arm     exchange   heuristics beside       work

Also what tells two rival models apart (:mod:`machopt.measurement.design.two_model_discrimination`).
"""

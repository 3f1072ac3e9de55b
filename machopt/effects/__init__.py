"""Physical effects of a robot beyond linear joint springs, shared by planner, ``identify`` and ``diagnose``.

An effect has a name, a list of places and one or more laws. A law is a local equation: it knows no robot and no
recording::

    LawParameter ─┐                  a named number of a law as files state it; a definition, not a value
    JointLoading ─┤► Law ─► Effect ─► registry
                  │   columns(shape, drive)   twist per unit of each coefficient
                  │   tangent(shape, drive)   its slope: the response to a small additional load
                  └   sizes(values, shape, scale), grid(scale): reported quantities, and the shapes a search tries

The caller transforms the output of a law: :mod:`machopt.stiffness.terms` to the TCP under a planned load,
:mod:`machopt.measurement.diagnosis` to the readings of a load test, of measured poses or of a motion. ``verify`` has
a second, independent implementation.

Each file defines one family of effects, for example :mod:`machopt.effects.joint.backlash`.
:mod:`machopt.effects.registry` lists all of them. A new effect needs one such file and one line in the registry.
"""

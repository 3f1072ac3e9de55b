"""What an arm may do beside its linear joint springs: each effect once, for the planner, identify and diagnose.

An effect says what it is called, where it can be, and by which laws it goes; a law says what it does *locally* and
knows neither robots nor recordings::

    Parameter ─┐                    a number of a law as files state it; a definition, never a value
    Drive ─────┤► Law ─► Effect ─► registry
               │   columns(shape, drive)   twist per unit of each coefficient
               │   tangent(shape, drive)   its slope: what a small load meets
               └   sizes(values, shape, scale), grid(scale): numbers of the trade, and what a search tries

Who needs a law lifts what it returns to where it is seen: :mod:`machopt.stiffness.terms` to the TCP under a plan's
load,
:mod:`machopt.measurement.diagnosis` to the readings of a load test, of poses, of a motion. ``verify`` has its own
second writing.

One file a family: :mod:`nonlinear_stiffness`, :mod:`backlash`, :mod:`hysteresis`, :mod:`creep`,
:mod:`angle_dependent_stiffness`;
:mod:`registry` lists them all. To add an effect is one such file and one line there.
"""

"""Where a model and a recording differ, and which physics the model leaves out: ``machopt diagnose``.

::

    Recording ─► record checks ─► Readings ─► Problem (y, base columns) ─► noise from replicates ─► Whitening
                 units, frames,    torques,    what is refitted whatever                              │
                 rows, clocks      history     is tried beside it                                     ▼
    catalogue ─► Hypothesis … (columns per shape) ─► screen ─► select (forward, swap, pairs) ─► proof ─► Diagnosis
                 one file a family                   gains by held-out pose, max-T by sign flips       sets, limits,
                                                                                                       verdict

One engine serves every channel: a channel (:mod:`deflection`, :mod:`position`, :mod:`motion`) says what was measured
less what the nominal model predicts (``Problem.y``), what is refitted in any case (``Problem.base``), and which of the
catalogue's effects its signals can show (``Hypothesis``). An effect is linear in its coefficients once its shape
(threshold, time constant, gear order …) is fixed; shapes are searched on a grid. Base and candidate are always refitted
together: refitted joint springs swallow most of what was left out.
"""

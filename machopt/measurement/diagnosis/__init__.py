"""Where a model and a recording differ, and which physics the model leaves out: ``machopt diagnose``.

::

    Recording ─► record checks ─► Readings ─► Problem (y, base columns) ─► noise from replicates ─► Whitening
                 units, frames,    torques,    what is refitted whatever                              │
                 rows, clocks      history     is tried beside it                                     ▼
    catalogue ─► Hypothesis … (columns per shape) ─► screen ─► select (forward, swap, pairs) ─► proof ─► Diagnosis
                 one file a family                   gains by held-out pose, max-T by sign flips       sets, limits,
                                                                                                       verdict

Rooms, each importing only what stands below it::

    written, apart     the file; the stiffness and kinematics left, what that changes in a job; what would part rivals
    run                a whole diagnosis
    record             what is wrong with a record of an arm at rest, put right
    resting, moving    the channels: load tests and poses; torques, encoders behind gears, a tracked TCP
    laws               each law of the registry as a channel sees it
    search             which effects together, what of them is proven; the engine
    verdict            what is said of the whole
    evidence           noise, whitening, what is held out, gross errors
    nouns              the problem, readings, signals, the result
    calibrated         thresholds, each with its origin

One engine serves every channel: a channel (:mod:`.resting`, :mod:`.moving`) says what was measured
less what the nominal model predicts (``Problem.y``), what is refitted in any case (``Problem.base``), and which of the
catalogue's effects its signals can show (``Hypothesis``). An effect is linear in its coefficients once its shape
(threshold, time constant, gear order …) is fixed; shapes are searched on a grid. Base and candidate are always refitted
together: refitted joint springs swallow most of what was left out.
"""

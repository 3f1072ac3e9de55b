"""Diagnosis of a model against a recording: where they differ, and which physical effects the model lacks.

Pipeline of ``machopt diagnose``::

    Recording ─► data_quality ─► StaticReadings / MotionSignals ─► DiagnosisProblem (y, base columns)
                 units, frames,  torques,                          │
                 rows, clocks    load history                      ▼  noise from replicates ─► Whitening
    HypothesisCatalogue ─► hypothesis screening ─► forward selection (with swaps and pairs) ─► holdout validation ─►
      columns per shape    cross-validated gain,                                               DiagnosisResult
                           max-T by sign flips

Packages, each imports only packages listed below it::

    outputs, discrimination  files; extended stiffness and kinematics; effect on a toolpath; next measurement
    diagnosis_pipeline       a complete diagnosis
    data_quality             errors of a static recording and their correction
    static, dynamic          channels: load tests and poses; torques, secondary encoders, a tracked TCP
    effect_columns           each law of the registry as seen by a channel
    model_selection          which effects are needed jointly, and which of them are significant
    verdict                  summary of the result
    statistics               noise, whitening, cross-validation, outliers
    data_types               problem, readings, signals, result
    thresholds               thresholds with their origin

One model selection serves every channel. A channel supplies three things: the measurement minus the nominal model
(``DiagnosisProblem.y``), the columns that are always refitted (``DiagnosisProblem.base``), and the effects that its
signals can show (``EffectHypothesis``). An effect is linear in its coefficients once its shape (threshold, time
constant, gear order) is fixed. Shapes are searched on a grid. Base and candidate are always fitted together, because
refitted joint springs absorb most of an omitted effect.
"""

"""Cutting-force coefficients from measured cuts: ``machopt process``.

::

                       ┌─ CuttingRecording ─► force_axes ─► coefficient_fit (mean forces) ─┐
    recording_fit ─────┤                                                                   ├─► CuttingFit
                       └─ WaveformRecording ─► force_axes ─► waveform (CasADi) ────────────┘
    CuttingFit ─► coefficients_document ─► process.yaml, coefficients.json, page
"""

"""Cutting-force coefficients from measured cuts: ``machopt process``.

::

    CuttingRecording ─► force_axes ─► coefficient_fit ─► CoefficientFit ─► process.yaml, coefficients.json, page
"""

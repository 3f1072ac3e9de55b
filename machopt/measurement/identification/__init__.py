"""Identification of joint stiffness (and further terms) from load tests: ``machopt identify``.

::

    Recording ─► experiment ─► fit ─► uncertainty ─► IdentificationResult ─► stiffness.yaml, identification.json, report
                 base axes,    weighted,  covariance,           ▲
                 response      robust,    identifiability,      │
                 per reading   bounded    cross-validation     grid: one set of values per cell, shrunk to constant ones

Unknowns are compliances c (rad/(N·m)): displacements are linear in them (dumas2011 eqs. 16–26), but not in
stiffnesses.
"""

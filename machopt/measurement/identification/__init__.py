"""Joint (and further) stiffness from load–deflection readings: ``machopt identify``.

::

    Recording ─► experiment ─► fit ─► uncertainty ─► Identification ─► stiffness.yaml, identification.json, page
                 base axes,    weighted,  covariance,      ▲
                 responses     robust,    identifiability, │
                 per reading   bounded    held-out error   grid: one set a cell, shrunk to the constant one

Unknowns are compliances c (rad/(N·m)): a displacement is linear in them (dumas2011 eqs. 16–26), a stiffness is not.
"""

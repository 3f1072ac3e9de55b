"""Stiffness and dexterity over places and postures: ``machopt map``.

::

    what to sample (slice | volume | joint plane | line) ─► configurations ─► fields ─► interpolation ─► data, page
"""

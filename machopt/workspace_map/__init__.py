"""Stiffness and dexterity over places and postures: ``machopt map``.

::

    samples ─────► postures | tracking ─► quantities ─► (inverse distance weighting: measured values)
    slice, volume  every branch, turn,    stiffness by direction, deflection,
    line, joints   rotation; a reason     dexterity, ν_p, ν_r, margins
                   where none is feasible
"""

"""Cells before anything is planned in them: how a new one is written (``init``), what is wrong with one (``validate``).

::

    robotfiles (copied) ─┐
    draft (URDF, options) ─► place (tool, workpiece, home) ─► text (cell.yaml, stiffness.yaml)
    load_cell, key by key ─► review (findings) ─► picture
"""

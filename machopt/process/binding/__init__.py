"""Cutting process bound to a toolpath: which operation a point belongs to, its holes, and the force at each point.

::

    process.yaml ──► operation_matching ──► Toolpath.process_operation ──► holes, milling passes
                                                                              │
    feed of each move (programmed, then re-timed) ─────────────────────► point_loads ──► force and moment per point
"""

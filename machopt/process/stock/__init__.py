"""Stock that the cutter removes move by move, and its contact with the cutter at each point.

::

    stock mesh ──► height_map ──► removal_kernels (move by move) ──► contact_kernels ──► StockEngagement
                                          │                                                │
                                          │                                                └──► contact_load: force
                                          └──► height_map_comparison: gouges, material left
"""

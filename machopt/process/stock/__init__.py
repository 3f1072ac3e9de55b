"""Stock that the cutter removes move by move, and its contact with the cutter at each point.

::

    stock mesh ──► height_map ──► removal_kernels (move by move) ──► contact_kernels ──► StockEngagement
                                          │                                                │
                                          └──► finished_part: gouges, material left        └──► contact_load: force
"""

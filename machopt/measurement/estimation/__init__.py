"""What load tests are as equations, how sure each reading is, what fits them: for ``identify`` and ``diagnose`` alike.

::

    Recording ─► experiment ─► noise ─► clusters ─► components          robust    start and weights against slips
                 base axes,    each     shared by   from replicates     bounded   least squares with lower bounds
                 responses     reading  cycles                          tiled     dense algebra in one thread
"""

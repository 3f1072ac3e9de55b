"""Estimation from load tests, shared by ``identify`` and ``diagnose``: equations, noise of the readings, fits.

::

    Recording ─► load_test_equations ─► reading_covariance ─► error_clusters ─► variance_components
                 base axes,             single readings       shared by         from replicates
                 responses                                    cycles, visits

    robust_weights: start values and weights against outliers; bounded_least_squares: lower bounds;
    tiled_linear_algebra: dense algebra in one thread
"""

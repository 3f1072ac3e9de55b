"""Experiment design: which poses and loads to measure (``machopt plan-poses``).

::

    cell ─► pose_candidates ─► load_cases ─► d_optimal_search ─► expected_accuracy, ─► measurement_schedule ─► poses.csv
            limits, KCI,       weights,      exchange            efficiency_bound      order of work
            clearance          pulls, arms   algorithm           published heuristics

:mod:`machopt.measurement.design.maximin_discrimination` selects readings that discriminate between models.
"""

"""Planning of a whole job: tool after tool, gaps, conflicting requests, alternative plans.

In: a cell, a toolpath, options. Out: plan and motion of the whole job
(:func:`~machopt.planning.job.job_planner.plan_job`).
"""

"""A job from what was asked to its motion: tool after tool, gaps, wishes that cannot be kept, further plans.

In: a cell, a toolpath, options. Out: plan and motion of the whole job
(:func:`~machopt.planning.job.job_planner.plan_job`).
"""

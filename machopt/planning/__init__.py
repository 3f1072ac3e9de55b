"""Planning of a job: from a path to a plan with rotation, joints, external axes and time law.

Each subpackage owns the result types of its steps. ``pipeline/path_planner.py`` calls the steps in order.
A contract in pyproject.toml defines which subpackage may import which; docs/architecture.md describes each.
"""

"""From a path to a plan: a step is a file that owns its result type, a room is some steps.

``pipeline/run.py`` draws the arrows. A contract in pyproject.toml says which room may use which, and
docs/architecture.md tells what each is for.
"""

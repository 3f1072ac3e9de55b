"""Schema errors of result.json, grouped by its parts."""

from __future__ import annotations

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from machopt.output.json_files import list_unique_errors

_PART_BY_KEY = {
    "inputs": "inputs",
    "cell": "inputs",
    "outputs": "outputs",
    "options": "options",
    "reading": "options",
    "index": "options",
    "chosen_from": "options",
    "toolpath": "toolpath",
    "tools": "tools",
    "worst_point": "worst point",
    "infeasible_points": "infeasible points",
    "breaks": "infeasible points",
    "obstructions": "infeasible points",
    "cycle_time_s": "times",
    "dwell_s": "times",
    "timings_s": "times",
    "rapid_detours": "times",
    "feed_held_share": "feed",
    "feed_dips": "feed",
    "feed_stops": "feed",
    "objective": "objective",
    "index_scale": "objective",
    "front": "front",
    "compensation": "compensation",
    "tilt": "tilt",
    "joint": "joint",
    "reentry": "reentry",
    "verification": "verification",
    "programs": "programs",
    "notes": "warnings",
    "warnings": "warnings",
}
"""Top-level key → the part that holds it; the others, and keys that are none, belong to the verdict."""


def list_schema_errors(problem: ValidationError) -> dict[str, list[str]]:
    """Return the schema errors by part, each error once.

    Args:
        problem: The validation error of pydantic.
    """
    wrong: dict[str, list[ErrorDetails]] = {}
    for error in problem.errors():
        part = _PART_BY_KEY.get(str(error["loc"][0]) if error["loc"] else "", "verdict")
        part_errors = wrong.setdefault(part, [])
        part_errors.append(error)
    return {part: list_unique_errors(errors) for part, errors in wrong.items()}

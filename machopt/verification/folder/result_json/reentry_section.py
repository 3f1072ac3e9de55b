"""Section ``reentry`` of result.json against the options, the motion and the objective."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.verification.folder.result_json.comparison_inputs import ResultComparison, check_close, check_equal

PRINTED = 1e-9  # relative: numbers of result.json are written in full


def check_reentry_section(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the re-entries that result.json states.

    Args:
        t: Result.json and everything that it is compared with.
    """
    entries = t.result.reentry
    if not t.options.max_reentries:
        yield from check_equal("reentry", entries, None)
        return
    if t.contents is None:
        return
    if entries is None:
        yield "reentry is null, yet re-entries are permitted and there is a motion"
        return
    stated = sorted(point for entry in entries for point in entry.points)
    point = t.motion.read_numbers("point", empty=True)
    driven = sorted(round(float(point[row])) for row in t.lift_starts)
    yield from check_equal("reentry: points", stated, driven)
    for n, entry in enumerate(entries):
        if (len(entry.points) < t.options.max_reentries) != bool(entry.reason):
            yield f"reentry.{n}: fewer re-entries than permitted have a reason, all of them have none"
        if entry.points and not (entry.objective or 0.0) < (entry.objective_without or 0.0):
            yield f"reentry.{n} lifts the tool, and objective is not below objective_without"
    if len(entries) == 1 and entries[0].objective is not None and t.result.objective.chosen is not None:
        total = t.result.objective.chosen.total
        if total is not None:
            yield from check_close("reentry.0.objective", entries[0].objective, total, PRINTED, 0.0)

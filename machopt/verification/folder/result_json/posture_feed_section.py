"""Section ``joint`` of result.json against the options and the motion."""

from __future__ import annotations

from collections.abc import Iterable

from machopt.data_types.documents.optimize_document import JointMethodEntry
from machopt.verification.folder.result_json.comparison_inputs import ResultComparison, check_close, check_equal

PRINTED_S = 1e-3


def check_joint_section(t: ResultComparison) -> Iterable[str]:
    """Yield what is wrong with the joint optimisation that result.json states.

    Args:
        t: Result.json and everything that it is compared with.
    """
    entries = t.result.joint
    if t.options.method != "joint":
        yield from check_equal("joint", entries, None)
        return
    if t.contents is None:
        return
    if entries is None:
        yield "joint is null, yet the method is joint and there is a motion"
        return
    for n, entry in enumerate(entries):
        yield from _check_entry(f"joint.{n}", entry)
    if len(entries) == 1:  # of several tools, the tool changes belong to no entry
        driven = entries[0].joint_s if entries[0].accepted else entries[0].fixed_path_s
        if driven is None or t.result.cycle_time_s is None:
            yield "joint.0 states no time of the motion in the folder"
        else:
            yield from check_close("joint.0: time of the motion", driven, t.result.cycle_time_s, 0.0, PRINTED_S)


def _check_entry(name: str, entry: JointMethodEntry) -> Iterable[str]:
    if entry.accepted == bool(entry.reason):
        yield f"{name} is {'accepted and has a reason' if entry.accepted else 'not accepted and has no reason'}"
    if entry.accepted and not (entry.joint_s or 0.0) < (entry.fixed_path_s or 0.0):
        yield f"{name} is accepted, and joint_s is not below fixed_path_s"
    if entry.accepted and not any(window.accepted for window in entry.windows):
        yield f"{name} is accepted without a window"
    for k, window in enumerate(entry.windows):
        if window.accepted == bool(window.reason):
            yield f"{name}.windows.{k}: a refused window has a reason, an accepted one has none"
        if window.accepted and not (window.run_after_s or 0.0) < (window.run_before_s or 0.0):
            yield f"{name}.windows.{k} is accepted, and its run is not shorter"

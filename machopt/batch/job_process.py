"""Job process of a batch: ``machopt optimize``, and its result as one row of the summary."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from machopt.batch.process_messages import JobMessage
from machopt.data_types.documents.batch_document import BatchRowSection
from machopt.data_types.documents.optimize_document import OptimizeDocument
from machopt.data_types.documents.process_entries import ProcessSection, ToleranceEntry
from machopt.errors import MachoptError

DISK_ERROR_CODES = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.EFBIG, errno.EACCES, errno.EPERM}
)
"""Errors of a place that takes no more, whatever is to be written."""
NOT_WRITTEN = "not written"


def run(job: Mapping[str, Any], out: Path) -> dict[str, object]:
    """Do one job.

    Args:
        job: ``request``, a :class:`machopt.batch.process_messages.JobMessage`.
        out: the job's result folder, written whole or not at all.

    Returns:
        a :class:`machopt.data_types.documents.batch_document.BatchRowSection`; there is no folder where the input is
        refused.
    """
    from machopt.commands.optimize.request import OptimizeRequest
    from machopt.commands.optimize.run import run_optimize

    message = JobMessage.model_validate(job["request"])
    paths = {
        "cell": Path(message.cell),
        "toolpath": Path(message.toolpath),
        "plan_file": None if message.plan_file is None else Path(message.plan_file),
        "process": None if message.process is None else Path(message.process),
        "effects": tuple(map(Path, message.effects)),
    }
    try:
        outcome = run_optimize(OptimizeRequest(out=out, **{**vars(message), **paths}))
    except MachoptError as problem:
        if _is_disk_error(problem):  # nothing to do with the job: to be tried again
            return BatchRowSection(exit_code=1, verdict=NOT_WRITTEN, reason=str(problem)).to_json_types()
        return BatchRowSection(exit_code=problem.exit_code, verdict="refused", reason=str(problem)).to_json_types()
    return build_summary_row(outcome.result).to_json_types()


def _is_disk_error(problem: BaseException | None) -> bool:
    """An error, or what led to it, is of a disk that takes no more."""
    while problem is not None:
        if isinstance(problem, OSError) and problem.errno in DISK_ERROR_CODES:
            return True
        problem = problem.__cause__ or problem.__context__
    return False


def warm(folder: Path) -> None:
    """Import and compile what every job needs, by running a tiny one.

    Args:
        folder: An empty folder.
    """
    from machopt.batch.warm_up_job import run_warm_up_job

    run_warm_up_job(folder)


def build_summary_row(result: OptimizeDocument) -> BatchRowSection:
    """Return the numbers of the summary from result.json.

    ``mean`` and ``worst`` are in ``unit``: deflection in mm, or stiffness along the tool in N/mm.

    Args:
        result: The content of result.json.
    """
    objective, path = result.objective, result.toolpath
    done = result.exit_code != 3
    gains = {g.over: g for g in objective.gain} if done else {}
    gain, paper = gains.get("cam default"), gains.get("jiao2022")
    worst = result.worst_point
    process = result.process
    counts = process.in_tolerance.after if process is not None and process.tolerances else {}
    least = None if process is None else find_worst_tolerance(process)
    return BatchRowSection(
        exit_code=result.exit_code,
        verdict=result.verdict,
        reason=_get_reason(result),
        points=path.points,
        infeasible_points=len(result.infeasible_points),
        gain_percent=None if gain is None else gain.mean_percent,
        gain_std_percent=None if gain is None else gain.std_percent,
        distinguishable=None if gain is None else gain.distinguishable,
        gain_over_jiao2022_percent=None if paper is None else paper.mean_percent,
        unit="mm" if result.index == "deflection" else "N/mm",
        mean=_convert_cost(result, objective.chosen.mean) if done else None,
        worst=_convert_cost(result, objective.chosen.worst) if done else None,
        mean_cam_default=_convert_cost(result, objective.cam_default.mean) if done else None,
        worst_cam_default=_convert_cost(result, objective.cam_default.worst) if done else None,
        worst_point=None if worst is None else worst.point,
        deflection_mm=None if worst is None else worst.deflection_mm,
        k_axial_N_mm=None if worst is None else worst.k_axial_N_mm,
        cycle_time_s=result.cycle_time_s,
        in_tolerance=counts.get("pass"),
        with_tolerance=sum(counts.values()) if counts else None,
        marginal=counts.get("marginal"),
        fail=counts.get("fail"),
        unknown=counts.get("unknown"),
        worst_error_mm=None if least is None else least.worst_error_mm,
        worst_error_point=None if least is None or least.worst_point < 0 else least.worst_point,
        worst_p_in=None if least is None else least.worst_p_in,
        programs=tuple(program.files[0] for program in result.programs if program.files),
        feed_held_percent=None if result.feed_held_share is None else 100.0 * result.feed_held_share,
        warnings=(
            *result.warnings,
            *(f"not understood: {w.word} ×{w.count}" for w in path.ignored if not w.understood),
        ),
    )


def find_worst_tolerance(process: ProcessSection) -> ToleranceEntry | None:
    """Return the operation whose worst hole or point has the lowest probability; of equal ones the larger error.

    Args:
        process: Section ``process`` of result.json.
    """

    def rank(entry: ToleranceEntry) -> tuple[float, float]:
        return (1.0 if entry.worst_p_in is None else entry.worst_p_in, -(entry.worst_error_mm or 0.0))

    return min(process.tolerances, key=rank, default=None)


def _convert_cost(result: OptimizeDocument, cost: float | None) -> float | None:
    """A cost of the objective as deflection in mm or stiffness in N/mm, None where there is none."""
    if cost is None or result.index_scale is None:
        return None
    value = cost * result.index_scale
    if not 0.0 < value < float("inf"):
        return None
    return float(1e3 * value if result.index == "deflection" else 1e-3 / value)


def _get_reason(result: OptimizeDocument) -> str:
    if result.exit_code == 4:
        checks = result.verification.checks if result.verification else ()
        failed = [c for c in checks if c.passed is False]
        return "; ".join(f"{c.name} at {c.where}" for c in failed)
    if result.exit_code != 3:
        return ""
    points, stops = result.infeasible_points, result.breaks
    if points:
        return f"{len(points)} of {result.toolpath.points} points, the first is {points[0].point}: " + str(
            points[0].reason
        )
    if not stops:
        return "no continuous sequence of configurations was found"
    ends = ("home" if k is None else f"point {k:g}" for k in (stops[0].from_point, stops[0].to_point))
    return "from {} to {}: {}".format(*ends, stops[0].reason)

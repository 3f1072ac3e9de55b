"""Warnings about a measurement plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.load_methods import LoadMethod
from machopt.measurement.design.measurement_plan import MOST_POSES, MeasurementPlan
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.measurement.design.request import PosesRequest


def build_plan_warnings(
    request: PosesRequest,
    pool: PosePool,
    cases: LoadCases,
    plan: MeasurementPlan | None,
    noise: ReadingNoise,
    ways: Sequence[LoadMethod],
) -> tuple[str, ...]:
    """Build the warnings about a measurement plan.

    Args:
        request: Validated user request.
        pool: Candidate poses.
        cases: Admissible load cases.
        plan: The plan; None without admissible load cases.
        noise: Noise of a reading.
        ways: Methods of load application.

    Returns:
        Warnings.
    """
    out = []
    if plan is None:
        return (explain_empty_plan(request, pool, cases, noise, ways),)
    if len(pool) < request.candidates:
        out.append(f"only {len(pool)} candidate poses of {request.candidates} were found in {pool.drawn_count} tried")
    if len(plan.design.blocks) < request.poses:
        out.append(f"only {len(plan.design.blocks)} poses can be loaded; {request.poses} were requested")
    names = plan.unknowns.names
    for group in plan.accuracy.unidentified_groups:
        words = ", ".join(names[p] for p in group)
        if len(group) > 1:
            out.append(f"{words} appear only together in these readings and cannot be separated")
        else:
            kinds = {w.kind for w in ways}
            hint = "a horizontal pull" if kinds == {"weight"} else "a load on an arm (--arms-mm)"
            out.append(f"{words} is not seen by any of these loads; {hint} may show it")
    if (
        request.discriminate is None
        and request.target_percent is not None
        and plan.needed_poses is None
        and plan.accuracy_by_belief.any()
    ):
        worst = names[int(np.argmax(np.where(plan.accuracy_by_belief, plan.accuracy.sigma, -np.inf)))]
        out.append(
            f"{request.target_percent:g} % of every joint is out of reach with {MOST_POSES} poses of these loads; "
            f"{worst} is the worst"
        )
    if request.discriminate is None and request.toolpath is None and request.force_N is None:
        out.append(
            "each load is planned at one size, under which play or a knee looks like a softer spring; --toolpath or "
            "--force-N, what the job asks of the arm, plans two sizes and turns joints both ways"
        )
    if request.max_load_N is None:
        out.append("no rated load was given (--max-load-N): check each load against the robot's load diagram")
    return tuple(out)


_HELP = {
    "TCP too low": "--floor-mm",
    "TCP too high": "--ceiling-mm",
    "TCP outside the box": "--box-mm",
    "too far from the tracker": "--tracker-range-mm",
    "hidden from the tracker": "--tracker-angle-deg",
    "KCI too low": "--min-kci",
    "collision or too little clearance": "--clearance-mm or --without-workpiece",
}


def explain_empty_plan(
    request: PosesRequest, pool: PosePool, cases: LoadCases, noise: ReadingNoise, ways: Sequence[LoadMethod]
) -> str:
    """Explain why there is no admissible load test, and what would help.

    Args:
        request: Validated user request.
        pool: Candidate poses.
        cases: Admissible load cases.
        noise: Noise of a reading.
        ways: Methods of load application.

    Returns:
        One sentence.
    """
    if not len(pool):
        # each pose counts at its first failure: all poses that reach the last criterion fail it
        last_reason = list(pool.rejected)[-1]
        main_reason = max(pool.rejected, key=lambda reason: pool.rejected[reason])
        sentences = [
            f"all {pool.rejected[last_reason]:,} that come so far fail for {last_reason!r}, see {_HELP[last_reason]}"
        ]
        if main_reason != last_reason:
            sentences.insert(0, f"{pool.rejected[main_reason]:,} fail for {main_reason!r}, see {_HELP[main_reason]}")
        return f"none of {pool.drawn_count:,} poses passes; {'; '.join(sentences)}"
    reason, count = max(cases.rejected.items(), key=lambda item: item[1])
    least = 1e3 * request.min_signal * noise.reading * request.prior_factor
    least_load = min(way.magnitudes[0] for way in ways)
    help_ = {
        "rope too short": "anchors farther from the TCP would work",
        "load above the limit": f"smaller loads, or a --max-load-N of {least_load:.4g} and more, would work",
        "deflection above the limit": f"smaller loads, or a --max-deflection-mm above {request.max_deflection_mm:g}, "
        "would work",
        "joint torque above the limit": "smaller loads or shorter --arms-mm would work",
        "K_C matters too much": "smaller loads, or larger --max-nu-p and --max-nu-r-deg, would work",
        "too small to measure": f"larger loads would work: every one moves the TCP by less than {least:.3f} mm "
        "(--min-signal times the reading's uncertainty)",
    }[reason]
    return f"no load is admissible at any of {len(pool)} poses; {count} pose × load pairs fail for {reason!r}: {help_}"

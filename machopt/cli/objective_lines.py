"""Lines of the terminal about the objective of a plan: baselines, gain, lower bound."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.cli.result_values import convert_null_to_nan, format_cost
from machopt.data_types.tolerance_prices import FAILED_POINT_PRICE, SHORTFALL_PRICE

if TYPE_CHECKING:
    from machopt.data_types.documents.optimize_document import (
        ChoiceObjectiveSection,
        ExternalSearchBoundSection,
        OptimizeDocument,
    )


def format_choice_lines(result: OptimizeDocument) -> list[str]:
    """Return the objective of the baselines and of the plan, one line each.

    Args:
        result: The content of result.json.
    """
    lines = []
    for name in ("cam_default", "jiao2022", "chosen"):
        o: ChoiceObjectiveSection = getattr(result.objective, name)
        if o.total is None:
            share = math.floor(1e3 * o.feasible_share) / 10  # never "100 %" of what is not feasible throughout
            lines.append(f"  {name:12} feasible at {share:g} % of the stations only")
        else:
            mean, worst = (format_cost(result, cost) for cost in (o.mean, o.worst))
            total = o.total - convert_null_to_nan(o.tolerance)
            lines.append(f"  {name:12} mean {mean}, worst {worst}   (objective {total:.3f})")
    return lines


def format_gain_lines(result: OptimizeDocument) -> list[str]:
    """Return the gain of the mean over each baseline, with its uncertainty where the stiffness file has one.

    Args:
        result: The content of result.json.
    """
    what = "mean deflection" if result.index == "deflection" else "mean compliance"
    lines = []
    for gain in result.objective.gain:
        if gain.mean_percent is None or gain.over == result.chosen_from:
            continue
        share, std = gain.mean_percent, gain.std_percent
        nothing = not gain.distinguishable and abs(share) < 0.05 and (std or 0.0) < 0.05  # no digit of it would show
        if nothing or (std is None and not gain.distinguishable):
            lines.append(f"  no gain over {gain.over}: same {what}")
            continue
        decimals = int(abs(share) < 10 if std is None else std < 1.5)
        text = f"  gain over {gain.over}: {what} {abs(share):.{decimals}f} %"
        if std is None:
            lines.append(f"{text} {'less' if share >= 0 else 'more'}")
            continue
        low, high = sorted(convert_null_to_nan(v) if share >= 0 else -convert_null_to_nan(v) for v in gain.ci90 or ())
        text += f" ± {std:.{decimals}f} % {'less' if share >= 0 else 'more'}"
        low, high = (round(v, decimals) + 0.0 for v in (low, high))  # no −0.0
        lines.append(f"{text} (90 %: {low:.{decimals}f} to {high:.{decimals}f} %)".replace("-", "−"))
        if not gain.distinguishable:
            lines.append("    smaller than rounding or the uncertainty of the stiffness model: not significant")
    return lines


def format_bound_lines(result: OptimizeDocument) -> list[str]:
    """Return how far from the best the plan can be, on the grid of rotations that was searched.

    Args:
        result: The content of result.json.
    """
    search, step = result.objective.search, result.options["rotation_step_deg"]
    if search is None:
        return []
    if result.objective.chosen.tolerance:
        fewest = math.ceil((search.lower_bound - SHORTFALL_PRICE) / FAILED_POINT_PRICE - 0.01)
        return [
            f"  no sequence over the {step:g}° grid has fewer than {max(fewest, 0)} points below the quantile at the "
            "stations"
        ]
    total, beyond = convert_null_to_nan(result.objective.chosen.total), search.beyond_grid_percent
    above = convert_null_to_nan(search.plan_above_bound_percent)
    return [
        f"  objective of the planned motion {total:.4f}: {abs(above):.2f} % {'above' if above >= 0 else 'below'} the "
        f"lower bound, {abs(beyond):.2f} % {'below' if beyond >= 0 else 'above'} the best sequence on the grid",
        f"    lower bound for all sequences on the {step:g}° grid: {search.lower_bound:.4f} (best sequence found "
        f"{search.sequence:.4f}, gap {search.gap_percent:.2f} %)",
        *format_external_lines(search.external),
    ]


def format_external_lines(e: ExternalSearchBoundSection | None) -> list[str]:
    """Return whether the lower bound holds for other values of the external joints too.

    Args:
        e: The bound over the values; None where no external joint was free.
    """
    if e is None:
        return []
    if e.why_none:
        return [f"    for the chosen values of the external joints; no lower bound over their values: {e.why_none}"]
    apart = ", ".join(f"{v.joint} {v.step:.4g}{'°' if v.unit == 'deg' else ' mm'}" for v in e.values_apart if v.step)
    where = f" (up to {apart} apart; nothing is proven between them)" if apart else ""
    gap = "at values of the external joints between those of the grid, so the bound does not apply to it"
    if e.gap_percent is not None:
        gap = f"gap {e.gap_percent:.2f} %"
    return [
        f"    for the chosen values of the external joints; lower bound over {e.values} of their values"
        f"{where} and those of the plan, with steps of {convert_null_to_nan(e.rotation_step_deg):g}° at "
        f"{e.stations} stations: "
        f"{convert_null_to_nan(e.lower_bound):.4f}; the plan has {convert_null_to_nan(e.plan):.4f}, {gap}"
    ]

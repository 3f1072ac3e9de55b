"""Values of result.json as text for the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from machopt.data_types.documents.optimize_document import OptimizeDocument


def format_or_dash(value: float | None, form: str) -> str:
    """Return a number as text, a dash where there is none.

    Args:
        value: The number.
        form: Its format.
    """
    return "–" if value is None else format(value, form)


def format_with_interval(value: float | None, interval: tuple[float, float] | None) -> str:
    """Return a length with its 90 % interval, where one is known.

    Args:
        value: The length, mm; None where not known.
        interval: Its lower and upper bound, mm.
    """
    text = f"{convert_null_to_nan(value):.3f} mm"
    if interval is not None:
        text += f" (90 %: {interval[0]:.3f} to {interval[1]:.3f} mm)"
    return text.replace("-", "−")


def format_point(index: float | None) -> str:
    """Return a place of the path as text.

    Args:
        index: Index of the toolpath point; None for home.
    """
    return "home" if index is None else f"point {index:g}"


def format_cost(result: OptimizeDocument, cost: float | None) -> str:
    """Return a cost of the objective as text: deflection in mm, or stiffness in N/µm.

    Args:
        result: The content of result.json.
        cost: The cost in units of ``index_scale``; None where not known.
    """
    value = convert_null_to_nan(cost) * convert_null_to_nan(result.index_scale)
    if result.index == "deflection":
        return f"deflection {1e3 * value:.3f} mm"
    return f"stiffness {1e-6 / value:.3f} N/µm"


def convert_null_to_nan(value: float | None) -> float:
    """Return a number of a result file; null is NaN.

    Args:
        value: The number.
    """
    return math.nan if value is None else value

"""Joint springs of the cell that deviate strongly from the diagnosis."""

from __future__ import annotations

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.numerics.array_types import Array


def describe_deviating_springs(d: DiagnosisResult, prior: Array | None) -> list[str]:
    """Describe each joint whose refitted spring differs from the cell's by a large factor.

    Args:
        d: Result with refitted compliances, rad/(N·m).
        prior: (6,) stiffness of the cell, N·m/rad; None if it has none.

    Returns:
        One sentence per joint.
    """
    out: list[str] = []
    for c in d.coefficients if prior is not None else ():
        joint = c.unknown.spring_joint
        if joint is None or c.value <= 0.0 or c.sigma > thresholds.SHARES.minority * c.value:
            continue
        assert prior is not None  # otherwise the loop is empty
        ratio = c.value * float(prior[joint - 1])
        if max(ratio, 1.0 / ratio) > thresholds.RATIOS.stiffness_error:
            much = f"{max(ratio, 1.0 / ratio):.2g} times {'softer' if ratio > 1.0 else 'stiffer'}"
            out.append(
                f"joint {joint} comes out {much} ({_format_three_digits(1.0 / c.value)} N·m/rad) than the "
                f"cell's stiffness says "
                f"({_format_three_digits(float(prior[joint - 1]))}): a slip in the cell, or a fault of this joint"
            )
    return out


def _format_three_digits(value: float) -> str:
    """Format a number with three significant digits without exponent: 9120, 556000."""
    return f"{float(f'{value:.3g}'):.10g}"

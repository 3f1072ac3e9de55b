"""Springs of a cell that lie far from what the readings say of them, joint by joint."""

from __future__ import annotations

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.numerics.array_types import Array


def describe_deviating_springs(d: DiagnosisResult, prior: Array | None) -> list[str]:
    """A sentence for each joint whose refitted spring the cell misses by a large factor.

    Args:
        d: with refitted compliances, rad/(N·m).
        prior: (6,) N·m/rad of the cell; None: it has none.
    """
    out: list[str] = []
    for c in d.coefficients if prior is not None else ():
        joint = c.unknown.spring_joint
        if joint is None or c.value <= 0.0 or c.sigma > thresholds.RECORD.sure_spring * c.value:
            continue
        assert prior is not None  # the loop is empty then
        ratio = c.value * float(prior[joint - 1])
        if max(ratio, 1.0 / ratio) > thresholds.RECORD.far_spring:
            much = f"{max(ratio, 1.0 / ratio):.2g} times {'softer' if ratio > 1.0 else 'stiffer'}"
            out.append(
                f"joint {joint} comes out {much} ({_format_three_digits(1.0 / c.value)} N·m/rad) than the "
                f"cell's stiffness says "
                f"({_format_three_digits(float(prior[joint - 1]))}): a slip in the cell, or a fault of this joint"
            )
    return out


def _format_three_digits(value: float) -> str:
    """Three digits, written out: 9120, 556000."""
    return f"{float(f'{value:.3g}'):.10g}"

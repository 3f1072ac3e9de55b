"""Thresholds of estimation: observability of variance components, and outlier weights."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.measurement.threshold_origin import JUDGEMENT
from machopt.measurement.threshold_origin import define_threshold as _set


@dataclass(frozen=True, kw_only=True)
class EstimationThresholds:
    """Thresholds of noise estimation and weights."""

    full: float = _set(3.0, "standard deviations, up to which a residual counts fully", JUDGEMENT)
    none: float = _set(6.0, "the same, from which on it does not count at all", JUDGEMENT)
    least_replicates: int = _set(
        5, "degrees of freedom (readings beyond the first of their group) that show a component at all", JUDGEMENT
    )
    trust_in_stated: float = _set(
        10.0, "degrees of freedom that a stated uncertainty is worth beside the residuals", JUDGEMENT
    )
    least_share: float = _set(
        1e-3, "of a channel's typical displacement: no reading is taken for more exact than that", JUDGEMENT
    )


ESTIMATED = EstimationThresholds()

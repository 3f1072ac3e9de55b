"""Decision thresholds of estimation, identification and diagnosis, each with its origin.

``list_thresholds`` iterates over the tables. Numbers that only control the resolution of a computation are defined next
to the computation, and shape grids in the effects. ``python benchmarks/diagnosis_thresholds.py`` prints the table with
false-positive and false-negative rates on concealed cases, and the same rates with another value of a threshold.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from machopt.measurement.threshold_origin import DEV, JUDGEMENT, POSES, PUBLISHED, STATISTICS, ThresholdOrigin
from machopt.measurement.threshold_origin import define_threshold as _set


@dataclass(frozen=True, kw_only=True)
class StatisticalLevels:
    """Significance levels, multiples of standard deviations, gains of likelihood."""

    significance_level: float = _set(0.01, "significance level of the selection of an effect", JUDGEMENT)
    mismatch_significance_level: float = _set(
        0.005, "significance level of a mismatch and of a comparison of two models (Benjamin et al. 2018)", PUBLISHED
    )
    holdout_significance_level: float = _set(
        0.05, "significance level of a gain on unseen groups (Fisher 1925)", PUBLISHED
    )
    duplicate_probability: float = _set(
        1e-12, "probability of equal readings by chance, below which they are copies", JUDGEMENT
    )
    min_gain: float = _set(
        30.0, "noncentrality of an effect: 5.5 standard deviations; 1 % in 230,000 independent tests", JUDGEMENT
    )
    gain_two_sigma: float = _set(
        4.0, "gain of one coefficient at two standard deviations: the penalty of a coefficient", STATISTICS
    )
    gain_three_sigma: float = _set(9.0, "difference of two gains at three standard deviations", STATISTICS)
    min_evidence: float = _set(
        10.0, "difference of −2 log evidence that is very strong (Kass & Raftery 1995)", PUBLISHED
    )
    power_quantile: float = _set(1.28, "quantile of the normal distribution for a detection power of 90 %", STATISTICS)
    two_sigma: float = _set(2.0, "standard errors of a quantity that differs from zero at 5 %", STATISTICS)
    three_sigma: float = _set(3.0, "standard deviations that noise exceeds in 0.3 % of the readings", STATISTICS)
    difference_sigma: float = _set(
        4.24, "three standard deviations of the difference of two readings, in those of one reading", STATISTICS
    )
    outlier_sigma: float = _set(
        6.0, "robust standard deviations of an outlier; noise does so once in 500 million readings", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class MinimumCounts:
    """Numbers of poses, readings, groups and equations."""

    min_comparisons: int = _set(
        5, "smallest number of comparisons with which a one-sided sign test reaches 5 %", STATISTICS
    )
    min_groups: int = _set(8, "smallest number of groups with which a one-sided sign test reaches 0.5 %", STATISTICS)
    min_degrees_of_freedom: int = _set(
        12, "degrees of freedom with which a standard deviation is known to 20 %", STATISTICS
    )
    min_rows_per_column: int = _set(
        20, "readings per coefficient of a regression with many columns; samples of a segment (Harrell 2015)", PUBLISHED
    )
    min_equations_per_unknown: int = _set(3, "equations per unknown of a fit that estimates its own error", JUDGEMENT)
    min_repetitions: int = _set(3, "readings, joints or load sizes that show the same fault", JUDGEMENT)
    min_identification_poses: int = _set(4, "poses with which joints can be identified separately", JUDGEMENT)
    max_stepwise_effects: int = _set(4, "effects that a stepwise search selects one by one", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class RelativeLimits:
    """Shares, correlations and relative tolerances, dimensionless."""

    majority: float = _set(0.5, "more than half", STATISTICS)
    half_power_amplitude: float = _set(0.7071, "amplitude ratio, or correlation, of half the power", STATISTICS)
    agreement: float = _set(0.9, "share of agreeing readings, or correlation of agreeing series", JUDGEMENT)
    inseparable_correlation: float = _set(0.95, "correlation of two estimates that are reported together", JUDGEMENT)
    min_transfer: float = _set(0.4, "gain on unseen groups or sessions per gain", JUDGEMENT)
    minority: float = _set(0.25, "minor share of a gain, an error or a size", JUDGEMENT)
    corrected_misfit: float = _set(0.2, "misfit with a correction of the recording per misfit as recorded", JUDGEMENT)
    max_relative_error: float = _set(0.5, "standard error per estimate: two standard errors from zero", STATISTICS)
    relevant: float = _set(0.1, "share of a displacement, a torque or a speed that is relevant", JUDGEMENT)
    load_tolerance: float = _set(0.08, "relative difference of equal loads, slopes and sizes", JUDGEMENT)
    outliers: float = _set(0.08, "share of gross errors and heavy tails of a laser tracker", DEV)
    law_error: float = _set(0.06, "gain per gain of an effect that its inexact law leaves", JUDGEMENT)
    body_law_error: float = _set(
        0.15, "gain per gain that an inexact law of a compliant body leaves in measured poses", POSES
    )
    exact_law_error: float = _set(
        5e-06, "gain per gain that the law of a clock error or a lag leaves: its column is exact to first order", DEV
    )
    small: float = _set(0.05, "share of the largest value that is too small for a conclusion", JUDGEMENT)
    negligible: float = _set(0.02, "share of the largest value that has no effect", JUDGEMENT)
    min_gain_per_row: float = _set(
        0.008, "gain per whitened coordinate: a smaller effect is not relevant in a long recording", JUDGEMENT
    )
    geometric_stiffness_gain_per_row: float = _set(
        0.08,
        "gain per whitened coordinate of the geometric stiffness, which every arm has: three tenths of the noise",
        JUDGEMENT,
    )
    pose_misfit: float = _set(
        0.005, "misfit per size of the coordinates of measured poses that indicates a fault", JUDGEMENT
    )
    force_gain: float = _set(
        0.005, "standard deviation of the gain of a load cell in one session: data sheets of 0.5 to 1 %", JUDGEMENT
    )
    drive_gain: float = _set(
        0.005, "gain error of a drive that has a name: torque constants of data sheets are less exact", JUDGEMENT
    )
    rank: float = _set(0.001, "relative singular value or norm that is zero", JUDGEMENT)
    absorbed_power: float = _set(
        0.0001, "share of the square of a column that the base model leaves, below which it is absorbed", JUDGEMENT
    )
    holdout: float = _set(0.22, "share of the groups that is held out", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class RatioLimits:
    """Ratios between a fitted and a stated or typical value."""

    equal_fit: float = _set(1.3, "ratio of the errors of two equally good fits", JUDGEMENT)
    larger: float = _set(1.5, "ratio of a quantity that is larger than another", JUDGEMENT)
    double: float = _set(2.0, "ratio of a quantity that is clearly larger than another", JUDGEMENT)
    stiffness_error: float = _set(3.0, "ratio of stated to actual stiffness of a cell without a wrong unit", JUDGEMENT)
    wrong_unit: float = _set(
        3.5, "ratio to the stiffness of the cell that a wrong unit causes: pounds are 4.45", JUDGEMENT
    )
    doubtful: float = _set(6.0, "ratio to a typical value that is unusual: known arms are within 3.3", JUDGEMENT)
    implausible: float = _set(10.0, "ratio to a stated or typical value that is implausible", JUDGEMENT)
    impossible: float = _set(100.0, "ratio to a stated or typical value that is impossible", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class QuantityLimits:
    """Limits of physical quantities, with their unit; periods and orders of waves."""

    displacement: float = _set(1e-06, "m, rad: smaller displacements are not measured", JUDGEMENT)
    reading_step: float = _set(5e-06, "m, rad: readings with a coarser step are equal by chance", JUDGEMENT)
    lever: float = _set(
        0.3, "m: lever at which moments and rotations are compared with forces and displacements", JUDGEMENT
    )
    large_rotation: float = _set(0.1, "rad: rotation of a frame or a joint that is not linear in the angle", JUDGEMENT)
    small_rotation: float = _set(
        float(np.radians(1.0)), "rad: rotations of a tool and margins of a joint limit that are equal", JUDGEMENT
    )
    attitude_spread: float = _set(
        float(np.radians(30.0)),
        "rad: spread of the attitude of a tool that separates base axes from tool axes",
        JUDGEMENT,
    )
    joint_range: float = _set(
        float(np.radians(10.0)), "rad: range of a joint in which a function of its angle is observable", JUDGEMENT
    )
    joint_motion: float = _set(0.002, "rad, m: smaller motions of a joint are none", JUDGEMENT)
    millimetre_range: float = _set(5.0, "mm: joint values within it are probably in metres", JUDGEMENT)
    force: float = _set(10.0, "N: smaller forces cause no measurable displacement", JUDGEMENT)
    moment: float = _set(1.0, "N·m: smaller moments do not show their lever", JUDGEMENT)
    torque: float = _set(0.001, "N·m: smaller joint torques are rounding", JUDGEMENT)
    temperature_rise: float = _set(1.0, "K between sessions that may shift a robot", JUDGEMENT)
    delay: float = _set(0.001, "s: smaller delays are not reported", JUDGEMENT)
    pause: float = _set(0.03, "s: a longer pause starts a new segment", JUDGEMENT)
    correlation_time: float = _set(0.25, "s in which errors of a motion are correlated", JUDGEMENT)
    segment_time: float = _set(0.5, "s: shortest segment, and longest sampling interval of a motion", JUDGEMENT)
    holdout_time: float = _set(1.0, "s that are held out together", JUDGEMENT)
    warm_up_time: float = _set(600.0, "s: shorter motions show no thermal drift", JUDGEMENT)
    cut_off_frequency: float = _set(80.0, "Hz: highest frequency of a commanded motion", JUDGEMENT)
    reading_rate: float = _set(50.0, "Hz of independent readings of a drive", JUDGEMENT)
    named_periods: float = _set(1.0, "periods within the range of a joint that identify a wave", JUDGEMENT)
    certain_periods: float = _set(2.0, "periods that identify a wave with an amplitude beyond that of gears", DEV)
    ripple_periods: float = _set(1.5, "periods within a motion that identify a torque ripple", JUDGEMENT)
    partial_periods: float = _set(0.5, "periods of a wave or a beat that differ from an offset and a slope", JUDGEMENT)
    weight_order: float = _set(
        2.0, "per turn: lowest order that weight and the mount of a reflector do not cause", JUDGEMENT
    )
    gear_order: float = _set(3.0, "per turn: lowest order that weight and gravity compensators do not cause", JUDGEMENT)


LEVELS, COUNTS, SHARES = StatisticalLevels(), MinimumCounts(), RelativeLimits()
RATIOS, LIMITS = RatioLimits(), QuantityLimits()
TABLES = ("LEVELS", "COUNTS", "SHARES", "RATIOS", "LIMITS")


@dataclass(frozen=True)
class ThresholdEntry:
    """One row of the table of thresholds."""

    concern: str  # name of the table
    name: str
    value: float
    meaning: str
    origin: ThresholdOrigin

    @property
    def key(self) -> str:
        """Name in commands and tables."""
        return f"{self.concern.lower()}.{self.name}"


def list_thresholds() -> Iterator[ThresholdEntry]:
    """Iterate over all thresholds in force."""
    for concern in TABLES:
        table = globals()[concern]
        for f in fields(table):
            yield ThresholdEntry(concern, f.name, getattr(table, f.name), f.metadata["why"], f.metadata["origin"])

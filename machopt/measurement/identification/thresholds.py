"""Decision thresholds of an identification, each with the origin of its value.

Those of recording faults also apply to diagnoses of load tests. All are listed together with those of the diagnosis:
``machopt.measurement.diagnosis.thresholds.list_thresholds()``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.measurement.threshold_origin import JUDGEMENT, STATISTICS
from machopt.measurement.threshold_origin import define_threshold as _set


@dataclass(frozen=True, kw_only=True)
class RecordCheckThresholds:
    """Thresholds of recording faults in load tests."""

    better: float = _set(0.6, "unexplained share of a rival reading per that of the stated one", JUDGEMENT)
    much_better: float = _set(0.35, "the same, from which on the stated one is refused", JUDGEMENT)
    wins: float = _set(0.8, "share of poses in which a rival must be better", JUDGEMENT)
    a_little_better: float = _set(
        0.8, "ratio that is enough for a warning where the rival is better everywhere", JUDGEMENT
    )
    wins_everywhere: float = _set(0.95, "share of poses that is everywhere", JUDGEMENT)
    many_poses: int = _set(8, "poses of which everywhere says something", JUDGEMENT)
    not_worth: float = _set(0.95, "the same by statistics: ratio at most", JUDGEMENT)
    beyond_noise: float = _set(2.5, "standard errors at least, by which the rival is better", JUDGEMENT)
    half: float = _set(0.5, "of what its rival explains: a stated reading that explains less is refused", JUDGEMENT)
    factor: float = _set(1.5, "by which compliances are wrong that are refused", JUDGEMENT)
    matters: float = _set(0.1, "share of the displacement from which on a joint's compliance matters", JUDGEMENT)
    outside: float = _set(float(np.radians(1.0)), "rad beyond a joint limit that no arm stands at", JUDGEMENT)
    most_moved: float = _set(0.02, "of the reach; no arm gives way that far", JUDGEMENT)
    moved_unloaded: float = _set(0.3, "of the usual displacement under load: more without any load is none", JUDGEMENT)
    least_moment: float = _set(1.0, "N·m; a moment that is less says nothing of levers", JUDGEMENT)
    screw: float = _set(
        0.2, "|f·m| / (|f| |m|) that no force through a point makes; rounding and noise make less", JUDGEMENT
    )
    screw_usual: float = _set(
        0.02, "the same, that nine of ten readings of forces through a point stay below", JUDGEMENT
    )
    screw_readings: int = _set(10, "readings with a moment, of which that says something", JUDGEMENT)
    coarse_step: float = _set(
        5e-6, "m; displacements read to a finer step do not repeat by chance in all their axes", JUDGEMENT
    )
    whole_step: float = _set(0.02, "of that, within which a reading is a whole number of such steps", JUDGEMENT)
    few_poses: int = _set(4, "poses; with fewer, joints are not told apart", JUDGEMENT)
    few_equations: int = _set(3, "equations per unknown; fewer do not tell how sure a result is", JUDGEMENT)
    most_generic: float = _set(
        60.0, "ratio to an arm of that reach beyond which units are wrong, where the cell has no stiffness", JUDGEMENT
    )
    most_generic_too: float = _set(
        15.0, "the same where the cell's stiffness is off by more than a hundred, too", JUDGEMENT
    )
    doubtful_generic: float = _set(6.0, "the same for a warning: arms that we know lie within 3.3", JUDGEMENT)
    most_nominal: float = _set(100.0, "ratio to the cell's stiffness that wrong units make", JUDGEMENT)
    doubtful_nominal: float = _set(8.0, "the same for a warning", JUDGEMENT)
    doubtful_rotation: float = _set(8.0, "rotation per translation against what the joints imply", JUDGEMENT)
    explains: float = _set(0.9, "unexplained share beyond which a record says nothing about units", JUDGEMENT)
    near_unit: float = _set(3.0, "factor within which a rotation's size names its unit", JUDGEMENT)
    near_suspect: float = _set(2.2, "factor around a unit's: stiffness is rarely known better beforehand", JUDGEMENT)
    alike: float = _set(1.2, "factor between joints, and from a unit's, that are off alike", JUDGEMENT)
    least_alike: int = _set(3, "joints that say so", JUDGEMENT)
    decisive: float = _set(
        10.0,
        "−2 log evidence by which another convention must be better: very strong (Kass & Raftery 1995)",
        STATISTICS,
    )
    off_axes: float = _set(0.05, "of the displacement, left beside all springs: less asks for no other axes", JUDGEMENT)
    least_turn_deg: float = _set(
        5.0, "deg; smaller rotations of a sensor are effects of the catalogue, linear in the angle", JUDGEMENT
    )
    reaches: float = _set(10.0, "times the reach, a usual lever of moments in another unit", JUDGEMENT)
    far_reaches: float = _set(3.0, "times the reach, the lever of a single reading that is wrong", JUDGEMENT)
    far_lever: float = _set(20.0, "times the usual lever, the same", JUDGEMENT)
    least_force: float = _set(10.0, "N; nothing bends visibly under less", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class IdentificationThresholds:
    """Thresholds of identifiability, outliers and model selection."""

    most_error: float = _set(0.5, "standard error per compliance beyond which a joint is not identified", JUDGEMENT)
    told_apart: float = _set(0.95, "correlation of two estimates beyond which they are named together", JUDGEMENT)
    moves_together: float = _set(
        0.05, "of the largest part of a direction that no reading shows: is named with it", JUDGEMENT
    )
    least_torque: float = _set(1e-3, "N·m; less on a joint is rounding in what should be none", JUDGEMENT)
    out: float = _set(0.5, "weight of a coordinate, below which it is an outlier", JUDGEMENT)
    enough_to_doubt: int = _set(
        2, "equations per unknown; with fewer nothing tells a wrong reading from a right one", JUDGEMENT
    )
    stated_off: float = _set(2.0, "scatter per stated uncertainty beyond which it is worth a word", JUDGEMENT)
    overfitted: float = _set(1.5, "held-out error per fitted error beyond which it is worth a word", JUDGEMENT)
    explains_little: float = _set(0.5, "share of the squared displacements that is", JUDGEMENT)
    below_bound: float = _set(3.0, "standard errors below its bound at which a compliance is worth a word", JUDGEMENT)
    poses_for_subsets: int = _set(6, "poses, below which readings are drawn instead", JUDGEMENT)
    poses_for_grid: int = _set(12, "poses, below which no grid is tried where it is not asked for", JUDGEMENT)
    worth_a_grid: float = _set(
        2.0, "standard errors of the gain on unseen poses; one would take a grid in one of six recordings", JUDGEMENT
    )
    least_gain: float = _set(
        0.03, "of the held-out error; two standard errors alone take a grid in one of twenty constant arms", JUDGEMENT
    )
    varies: float = _set(
        2.0, "standard errors; a joint whose constant compliance is less does not vary by cell", JUDGEMENT
    )
    load_matters: float = _set(
        0.25, "standard errors by which K_C of the load has to move a joint; less hides in the interval", JUDGEMENT
    )
    misfit: float = _set(
        8.0, "twice the log-likelihood; χ² of two bounded components passes 6 in one of fifty", JUDGEMENT
    )
    force_gain: float = _set(
        0.005, "1 sigma of a load cell's gain in one session: data sheets of 0.5 to 1 % of full scale", JUDGEMENT
    )
    branch_pairs: int = _set(12, "pairs of rising and falling loads, below which no loop is estimated", JUDGEMENT)
    same_load: float = _set(0.05, "of the largest load of a cycle, by which loads of a pair may differ", JUDGEMENT)
    weak_torque: float = _set(0.05, "of a joint's largest torque: below it has no side", JUDGEMENT)
    loop_shown: float = _set(3.0, "standard errors of the half width of a loop that is counted", JUDGEMENT)
    replicates: float = _set(
        3.0, "equations per column, from which replicates are judged beside all columns", JUDGEMENT
    )


CHECKED, IDENTIFIED = RecordCheckThresholds(), IdentificationThresholds()

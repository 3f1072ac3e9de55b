"""Decision thresholds: detection, validation, noise estimation, recording faults."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.measurement.threshold_origin import (
    DEV,
    JUDGEMENT,
    LOAD_TESTS,
    POSES,
    STATISTICS,
    VERDICTS,
)
from machopt.measurement.threshold_origin import define_threshold as _set


@dataclass(frozen=True, kw_only=True)
class DetectionThresholds:
    """Thresholds for reporting an effect and its alternatives."""

    chance: float = _set(0.01, "of naming anything in a recording without a mismatch", JUDGEMENT)
    gain: float = _set(
        30.0, "squared noncentrality that an effect must have: five and a half standard deviations", JUDGEMENT
    )
    per_coefficient: float = _set(4.0, "gain that each coefficient of a law costs", JUDGEMENT)
    share: float = _set(
        0.008, "of the whitened sum of squares: less does not matter, however long the recording", JUDGEMENT
    )
    generalises: float = _set(0.4, "of the gain that must come back on unseen groups", JUDGEMENT)
    another_day: float = _set(
        0.4, "of the gain that must come back on sessions that did not see it: as on unseen groups", JUDGEMENT
    )
    without_best: float = _set(0.25, "of it that must not hang on a single group", JUDGEMENT)
    simpler: float = _set(
        4.0, "gain on unseen groups that a second coefficient of the same effect must bring", JUDGEMENT
    )
    beside: float = _set(0.06, "of the largest gain so far that a law not quite the true one leaves", JUDGEMENT)
    beside_here: float = _set(0.3, "the same at its own place, where most of it is", JUDGEMENT)
    beside_body: float = _set(
        0.15,
        "the same of what gives way under weight in measured poses: links taper, and feet are uneven",
        POSES,
    )
    beside_exact: float = _set(5e-06, "the same of a clock or a lag, which its column holds to first order", DEV)
    pair_must_win: float = _set(8.0, "gain by which a pair must beat the best single law", JUDGEMENT)
    possible: float = _set(
        0.7, "of the gain that must stay with the nearest coefficients that something built can have", JUDGEMENT
    )
    shorter: float = _set(
        10.0,
        "−2 log evidence by which other explanations must be shorter: very strong (Kass & Raftery 1995)",
        STATISTICS,
    )
    nine_of_ten: float = _set(1.28, "standard deviations: a limit is shown in nine of ten repeats", STATISTICS)
    apart: float = _set(6.0, "gain that a rival must leave at twice the limit to be told from the effect", JUDGEMENT)
    as_good: float = _set(
        9.0, "difference of gains below which a rival is not excluded: three standard deviations", STATISTICS
    )
    paired: float = _set(
        0.005, "chance of the paired difference over groups below which a rival is excluded", JUDGEMENT
    )
    most_of: float = _set(
        0.6,
        "of the gain on unseen groups that a rival must reach; an effect in few groups alone pairs badly",
        JUDGEMENT,
    )
    absorbed: float = _set(
        1e-4, "of a column's square left beside the base; less cannot be told from the base", JUDGEMENT
    )
    left_apart: float = _set(
        1e-3, "of a law's own square that no rival imitates in any cycle: less is the same by mechanics", JUDGEMENT
    )
    near_shape: float = _set(
        3.84, "loss of gain within which another shape is as likely: χ² of one number at 95 %", STATISTICS
    )
    named: float = _set(
        0.08,
        "gain per whitened coordinate of K_C: three tenths of the noise; it is in every recording, and counted",
        JUDGEMENT,
    )


@dataclass(frozen=True, kw_only=True)
class ProofThresholds:
    """Thresholds for a mismatch and for the validation of findings."""

    certain: float = _set(0.005, "chance of the repeatable power below which there is a mismatch", JUDGEMENT)
    restless: float = _set(
        0.2, "variance of whitened residuals beyond 1 that no noise makes, however many visits", JUDGEMENT
    )
    restless_errors: float = _set(
        1.5, "the same in standard errors of a variance of so many visits, where they are few", JUDGEMENT
    )
    matters: float = _set(0.3, "repeatable rmse per noise of one reading that matters", JUDGEMENT)
    as_noise: float = _set(1.3, "times the noise that unseen readings may leave where findings explain it", JUDGEMENT)
    left_over: float = _set(
        0.55,
        "of the noise that comes back beside what explains the rest, from which on that is said: of 9 such answers 2 "
        "had nothing right in them, of 291 others 3",
        VERDICTS,
    )
    outweighs: float = _set(
        0.5,
        "of the error power that a law takes: where more than that comes back beside it, it is not named",
        LOAD_TESTS,
    )
    outweighs_exact: float = _set(1.5, "the same of a frame, which leaves nothing of itself", LOAD_TESTS)
    closed_by_all: float = _set(
        0.75,
        "share of the mismatch that all effects close together, from which on the rest does not count against each: "
        "a hose outside of the catalogue closes 0.65 as a gravity compensator (run_energy_benchmark.py, outside)",
        DEV,
    )
    excluded_elsewhere: float = _set(
        0.5, "of the gain of an effect on unseen groups that any law or form at another place may reach", JUDGEMENT
    )
    steady: float = _set(
        0.25,
        "of the gain of a frame or an offset, that may come and go with the hours: more, and it stands nowhere",
        JUDGEMENT,
    )
    surely_better: float = _set(
        0.05,
        "chance that unseen groups are predicted better by accident, from which what was found is withdrawn",
        JUDGEMENT,
    )
    half: float = _set(
        0.7, "of the error on unseen readings: less is better, however few groups it shows in", JUDGEMENT
    )
    locked: float = _set(0.22, "share of the groups that the proof locks away", JUDGEMENT)
    fewest_groups: int = _set(8, "groups, below which none can be spared", JUDGEMENT)
    least_visits: int = _set(12, "visits that a test of repeats asks for", JUDGEMENT)
    permitted: float = _set(0.005, "chance of what lasts over time", JUDGEMENT)
    trusted: float = _set(
        3.0, "times the stated 1 sigma: cycles and returns to a pose err by more than a single reading", JUDGEMENT
    )
    unsure: float = _set(1.5, "noise power that was taken from few readings may be so much larger", JUDGEMENT)
    beyond_stated: float = _set(
        10.0, "times the stated 1 sigma: what is left or called noise cannot be the instruments' own", JUDGEMENT
    )
    gain_doubt: float = _set(0.02, "of the displacement under load, that a force may be wrong by", JUDGEMENT)
    concentrated: float = _set(1.35, "power of a bin per the mean before it is worth a word", JUDGEMENT)
    most_closed: float = _set(
        0.5, "share of the repeatable mismatch that is most of it: the contract of the verdict `explained`", JUDGEMENT
    )
    widest: float = _set(
        50.0, "times the largest number of its unit: an interval around zero that is wider says nothing", JUDGEMENT
    )
    widest_percent: float = _set(
        1000.0, "per cent; an interval around zero of a share or gain that is wider says nothing", JUDGEMENT
    )
    named_gain: float = _set(
        0.02,
        "of the error that all corrections take and of the error that is left: a correction that takes less of both is "
        "written and not named",
        JUDGEMENT,
    )
    named_periods: float = _set(
        1.0,
        "periods of a wave that the readings must cover: with 1.5, true waves of 1.1 and 1.3 lost their names in "
        "run_tracker_benchmark.py --seed 62",
        JUDGEMENT,
    )
    largest_wave: float = _set(
        3.0, "1 sigma of a gear's wave (TransmissionError.prior), beyond which its amplitude has no name", STATISTICS
    )
    sure_periods: float = _set(
        2.0,
        "periods that the readings must cover where an amplitude is beyond that of gears: joint 1 with 412 arcsec lost "
        "its name in run_energy_benchmark.py --only 'large*'",
        DEV,
    )
    largest_sure_wave: float = _set(
        10.0, "the same where the readings cover ``sure_periods``: ten arcmin of a worn gear", JUDGEMENT
    )
    closes: float = _set(
        0.005, "share of the mismatch closed, of which less is written as 0 % and closes nothing", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class NoiseThresholds:
    """Thresholds of noise estimation and outlier rejection."""

    gross: float = _set(6.0, "robust standard deviations beyond which a residual takes no part", JUDGEMENT)
    mostly: float = _set(0.5, "share of a session's or a pose's readings beyond which they are no outliers", STATISTICS)
    least_part: int = _set(4, "readings of a session or pose that such a share asks for", JUDGEMENT)
    silent: float = _set(
        1.5, "times the stated 1 sigma: a load component whose rms is less holds nothing but noise", JUDGEMENT
    )
    silent_peak: float = _set(4.0, "times the stated 1 sigma that a reading of such a component may reach", JUDGEMENT)
    silent_share: float = _set(0.01, "of the readings that may exceed it: gross errors", JUDGEMENT)
    silent_small: float = _set(
        0.03, "rms per largest force up to which a component without a stated 1 sigma may be noise alone", JUDGEMENT
    )
    silent_step: float = _set(0.05, "of the largest force: readings under forces so alike are repeats of it", JUDGEMENT)
    same: float = _set(
        4.24, "times the stated 1 sigma: loads that differ less are the same: three of a difference", STATISTICS
    )
    moment_lever: float = _set(0.1, "m, at which a moment counts as a force", JUDGEMENT)
    least: float = _set(1e-6, "m, rad; no instrument of a load test is better", JUDGEMENT)
    least_twins: int = _set(12, "readings with a twin in another visit; with fewer, residuals have to serve", JUDGEMENT)
    least_freedom: int = _set(20, "degrees of freedom that a cycle's own errors ask for", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class RecordingThresholds:
    """Thresholds of recording faults."""

    ordinary: float = _set(
        0.08, "share of gross errors and heavy tails that trackers make now and then; more is worth a finding", DEV
    )
    alike: float = _set(0.8, "cosine of errors that are the same", JUDGEMENT)
    like_size: float = _set(3.0, "ratio of errors that are the same", JUDGEMENT)
    clerical: int = _set(3, "slipped decimals or copies; a tracker's own outliers look like one now and then", DEV)
    mostly: float = _set(0.5, "of the gross rows", JUDGEMENT)
    fits: float = _set(2.0, "noise within which a slipped decimal, put right, meets the prediction", JUDGEMENT)
    slip_up: float = _set(
        2.0, "times that, above which a prediction tells a reading that is ten times too large", JUDGEMENT
    )
    slip_down: float = _set(5.0, "times that, above which one tells a reading that is a tenth of itself", JUDGEMENT)
    apart: float = _set(
        10.0,
        "times the typical misfit that two poses lie apart whose readings cannot agree to the last digit",
        JUDGEMENT,
    )
    copied: float = _set(
        1e-12, "chance that so many readings of a visit agree with those of another pose to the last digit", JUDGEMENT
    )
    misplaced: float = _set(
        3.0, "1 sigma of a reflector's nominal place, beyond which it was written down wrong", JUDGEMENT
    )
    nest: float = _set(0.001, "m, that 1 sigma where the recording states none", JUDGEMENT)
    different_load: float = _set(
        0.05, "of the largest load: readings under loads so unlike do not agree to the last digit", JUDGEMENT
    )
    far: float = _set(5.0, "factor from the cell's stiffness that another unit makes", JUDGEMENT)
    far_alike: float = _set(3.5, "the same where every joint is off alike: pounds", JUDGEMENT)
    shown: float = _set(0.03, "share of the displacement from which on a joint shows", JUDGEMENT)
    alike_factor: float = _set(
        2.5, "ratio of the largest to the least factor between joints that are off alike", JUDGEMENT
    )
    far_spring: float = _set(3.0, "factor by which a cell may miss a spring before it is worth a word", JUDGEMENT)
    gain_far: float = _set(
        4.0, "times what forces scatter between sessions, from which on a session's gain is a fault", JUDGEMENT
    )
    gain_poses: int = _set(
        5, "poses that two sessions share, below which nothing says that their gains differ", JUDGEMENT
    )
    label_poses: int = _set(
        5, "poses that have a size of load and others, below which nothing is held against it", JUDGEMENT
    )
    label_sizes: int = _set(
        3, "sizes of load in a session: of two that disagree nothing says which is wrong", JUDGEMENT
    )
    label_gap: float = _set(0.04, "of the largest load, by which one size of load is apart from the next", JUDGEMENT)
    label_wide: float = _set(0.06, "of it, that loads of one size spread over at most", JUDGEMENT)
    label_alike: float = _set(0.9, "share of the poses at which a wrong weight is off the same way", JUDGEMENT)
    label_others: float = _set(
        0.4, "of what a wrong weight is off by, that other sizes of load may be off by", JUDGEMENT
    )
    label_same: float = _set(0.04, "relative: two sessions have the same weight", JUDGEMENT)
    sure_spring: float = _set(0.2, "standard error per compliance from which on a spring is known", JUDGEMENT)
    near: float = _set(1.6, "factor around that of a unit", JUDGEMENT)
    unusual: float = _set(10.0, "factor from a robot of this size", JUDGEMENT)
    half: float = _set(0.5, "share of the displacement that may be left over", JUDGEMENT)
    clearly: float = _set(0.1, "misfit of another unit per that of the stated one", JUDGEMENT)
    hopeless: float = _set(
        0.6, "unexplained share of the displacement from which on another reading of the load is looked for", JUDGEMENT
    )
    halved: float = _set(0.5, "a reading must leave less than this of what the stated one leaves", JUDGEMENT)
    against: float = _set(0.9, "share of readings that move against their load", JUDGEMENT)
    one_lever: float = _set(0.98, "share of the moments that one lever explains in all postures", JUDGEMENT)
    contradicting_poses: int = _set(5, "poses, below which nothing contradicts itself", JUDGEMENT)
    slope_near: float = _set(0.08, "relative, of a slope to the factor of a unit", JUDGEMENT)
    slope_sure: float = _set(0.9, "correlation from which a slope says something", JUDGEMENT)
    session_falls: float = _set(
        0.3,
        "misfit of a session read otherwise, per that of the stated reading: a wrong sign of one axis shows",
        JUDGEMENT,
    )
    pose_falls: float = _set(0.15, "the same of a single pose, which has no replicates in others", JUDGEMENT)
    whole_off: float = _set(
        0.12, "unexplained share of the displacement from which on whole columns are read otherwise", JUDGEMENT
    )
    whole_pose_off: float = _set(0.005, "the same of measured poses, per the size of their coordinates", JUDGEMENT)
    whole_falls: float = _set(
        0.2, "misfit of the whole record read otherwise, per that of the stated reading", JUDGEMENT
    )
    same_convention: float = _set(
        0.2, "of the error that is left, by which readings of two conventions that are the same may differ", JUDGEMENT
    )
    far_misplaced: float = _set(
        10.0, "1 sigma of a reflector's nominal place: so far off is another convention or another place", JUDGEMENT
    )
    part_level: float = _set(2.0, "misfit of the other sessions or poses that a mended one may have", JUDGEMENT)
    part_stands_out: float = _set(
        2.0, "misfit per that of the others, below which no session or pose is looked at again", JUDGEMENT
    )
    part_readings: int = _set(6, "readings, below which no session or pose is read otherwise", JUDGEMENT)
    part_as_good: float = _set(1.3, "ratio of misfits between which replicates and the cell decide", JUDGEMENT)
    poses_to_compare: int = _set(6, "poses, below which none is held against the others", JUDGEMENT)
    moved_falls: float = _set(
        0.5, "of what a session differs by at the same poses, what a thing moved in between may leave", JUDGEMENT
    )
    moved_as_good: float = _set(1.2, "ratio of such rests between which the one with fewer numbers is taken", JUDGEMENT)
    moved_warmer: float = _set(1.0, "K between sessions, from which on a shift alone may be warmth", JUDGEMENT)
    tilt_doubted: float = _set(
        0.5, "share of tilts that no weight explains, from which on columns are doubted", JUDGEMENT
    )
    tilt_shown: float = _set(0.9, "rest of the points beside a base that rocks, which then shows in them", JUDGEMENT)
    tilt_least: float = _set(5e-6, "rad of tilt that joints and points predict, to tell a unit by", JUDGEMENT)
    tilt_alike: float = _set(0.7, "correlation of tilts with what joints and points predict", JUDGEMENT)
    same_force: float = _set(0.08, "of the largest force of a pose: replicates across sessions", JUDGEMENT)
    rubs: float = _set(
        0.2, "rms of a joint's friction per what is left, which tells forward torque of an outweighed joint", JUDGEMENT
    )
    motor_side: float = _set(
        0.2, "torque below this share of what the arm needs, joint by joint another: before the gear", JUDGEMENT
    )
    geared: float = _set(
        0.05, "the same of one joint beside others that are whole: gears of arms reduce by 20 and more", JUDGEMENT
    )
    loaded: float = _set(0.02, "of the largest torque: a joint that needs less tells nothing of its channel", JUDGEMENT)
    clipped: float = _set(0.01, "share of samples at the very largest value", JUDGEMENT)
    most_twist: float = _set(0.05, "rad of a joint under its load; more is no arm", JUDGEMENT)
    tilt_readings: int = _set(8, "readings of an inclinometer: fewer agree with any axes", JUDGEMENT)
    tilt_like: float = _set(0.2, "of the sag of a nominal arm, that the right axes leave at most", JUDGEMENT)
    tilt_wrong: float = _set(0.7, "of it, that wrong axes leave at least", JUDGEMENT)
    lag_worth_s: float = _set(
        0.001, "s; encoders that follow their command closer than this have no lag worth a word", JUDGEMENT
    )
    lag_explains: float = _set(0.5, "of the tracking error's power", JUDGEMENT)

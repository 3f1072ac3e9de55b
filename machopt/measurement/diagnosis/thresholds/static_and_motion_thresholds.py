"""Thresholds of channels: what static recordings and motions can show, and when two readings are equal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.measurement.threshold_origin import JUDGEMENT
from machopt.measurement.threshold_origin import define_threshold as _set


@dataclass(frozen=True, kw_only=True)
class StaticThresholds:
    """Thresholds of load tests and measured poses."""

    same_load: float = _set(0.08, "of the largest load of a pose: readings so near are of the same load", JUDGEMENT)
    heavy: float = _set(
        2.0, "robust standard deviations, from where on a reading counts less in the first fit of poses", JUDGEMENT
    )
    near_cell: float = _set(
        2.0, "factor around the cell's compliance within which springs stay that weights are seen through", JUDGEMENT
    )
    usual_joint: float = _set(1e-06, "rad/(N·m), where the cell has no stiffness", JUDGEMENT)
    lever: float = _set(
        0.5, "m: an error of rotation counts as the shift it makes so far away, while the noise is not known", JUDGEMENT
    )
    rare: float = _set(
        0.02, "of the readings that lie beyond what counts as a joint's range or largest torque", JUDGEMENT
    )
    near_usual: float = _set(
        20.0, "the same below ``usual_joint`` where the cell has none: springs that weights are seen through", JUDGEMENT
    )
    least_bend: float = _set(
        1e-07, "m at the cell's own stiffness: a joint whose torque moves the TCP less has no column", JUDGEMENT
    )
    taken_up: float = _set(
        0.001, "of a column's length that the base leaves: less is nothing but rounding of the geometry", JUDGEMENT
    )
    distinct: float = _set(
        0.3, "of what the base leaves of a law: less beside a zero offset of the joint, and it is one", JUDGEMENT
    )
    least_wave: float = _set(
        float(np.radians(10.0)), "rad, range of a joint below which a wave is a zero offset and a slope", JUDGEMENT
    )
    fewest_angles: int = _set(8, "distinct angles: what is drawn through fewer is any line", JUDGEMENT)
    angle_decimals: int = _set(3, "decimals of a radian: poses that are returned to differ by less", JUDGEMENT)
    above_balancer: float = _set(3.0, "per turn of its joint, the lowest order that is not a balancer's", JUDGEMENT)
    most_balanced: float = _set(
        100.0,
        "times the largest torque of weight at its joint that a balancer carries, at most",
        JUDGEMENT,
    )
    most_varied: float = _set(
        5.0, "times its least, a joint's largest compliance over its angles: no gear is built so unevenly", JUDGEMENT
    )
    poses_per_order: float = _set(3.0, "distinct angles that each order of a wave asks for", JUDGEMENT)
    least_turn: float = _set(
        float(np.radians(15.0)), "rad, range of a joint below which a torque by its angle does not show", JUDGEMENT
    )
    aside: float = _set(
        8.0,
        "gain on unseen groups by which base and joint 1 must beat the tracker's frame, which the robot has no part in",
        JUDGEMENT,
    )
    crowded: int = _set(4, "places; so few are told better by the search one by one", JUDGEMENT)
    clearer: float = _set(
        1.5,
        "gain of a law of weight per that of the best frame or wave: with less it stands in for several of those",
        JUDGEMENT,
    )
    per_column: int = _set(
        20, "whitened rows that each column asks for: with fewer some sum among many fits any noise", JUDGEMENT
    )
    visible: float = _set(
        0.001, "of a column's own square that must be left beside what was fitted together", JUDGEMENT
    )
    noise_known: float = _set(
        0.5, "whitened variance left, below which the noise held most of what was found", JUDGEMENT
    )
    certain_joint: float = _set(
        0.5, "standard error per compliance from which on a joint keeps the cell's value", JUDGEMENT
    )
    turned: float = _set(
        float(np.radians(30.0)),
        "rad, spread of the tool's attitude at which one lever in base axes is no longer a tool's",
        JUDGEMENT,
    )
    fine: float = _set(5e-06, "m; readings rounded more coarsely agree by chance", JUDGEMENT)
    whole_step: float = _set(0.02, "of that, within which a reading is a whole number of such steps", JUDGEMENT)
    stiffest: float = _set(
        0.2,
        "times the cell's compliance: less, or a spring that pushes back, is what frames and waves make of it",
        JUDGEMENT,
    )
    seen_spring: float = _set(
        0.02,
        "of what the first fit leaves: a spring that gives less beside all frames would take up anything else",
        JUDGEMENT,
    )
    seen_apart: float = _set(
        1e-3, "of the best seen direction of frames and reflectors: less is held by nominal places alone", JUDGEMENT
    )
    shown_geometry: float = _set(0.03, "of a direction's own size that the base must leave", JUDGEMENT)
    weak_geometry: float = _set(
        0.02, "of the strongest direction that is shown: weaker ones would need millimetres to be seen", JUDGEMENT
    )
    stand_turned: float = _set(
        0.1, "rad of a tracker's own frame against base_link: beyond, it is brought there first", JUDGEMENT
    )
    stand_shifted: float = _set(0.3, "m, the same of its place", JUDGEMENT)
    same_spread: float = _set(0.03, "relative: within, the points of a stand spread as the arm's do", JUDGEMENT)
    same_rotation: float = _set(
        float(np.radians(1.0)), "rad: rotations on a job that differ by less are the same choice", JUDGEMENT
    )
    worth_turning: float = _set(0.01, "of the deflection on a job: to turn the tool for less is of no use", JUDGEMENT)
    flat: float = _set(0.02, "of the longest extent of a stand's points: less to any other side is a line", JUDGEMENT)
    turned_by_load: float = _set(
        0.001, "of the torque of the most loaded joint: a joint that bears less shows nothing", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class MotionThresholds:
    """Thresholds of motions."""

    long_s: float = _set(600.0, "s; heat needs ten minutes to show", JUDGEMENT)
    under_way: float = _set(0.1, "of a joint's usual speed, above which it tells the clock of its torque", JUDGEMENT)
    mostly_under_way: float = _set(0.2, "of the readings; with fewer under way all of them tell the clock", JUDGEMENT)
    moves: float = _set(0.002, "rad (m); a joint that turns less does not move", JUDGEMENT)
    slow_s: float = _set(0.5, "s between samples: a clock in milliseconds rather than a motion", JUDGEMENT)
    least_gain_percent: float = _set(
        0.5, "per cent; torque constants of data sheets hold to several, so less is no wrong unit", JUDGEMENT
    )
    few_degrees: float = _set(6.3, "deg; a range within it is rather of radians", JUDGEMENT)
    few_millimetres: float = _set(5.0, "mm; a range within it is rather of metres", JUDGEMENT)
    loaded: float = _set(
        0.05, "of the largest load: one that changes by less shows no friction that grows with it", JUDGEMENT
    )
    slowest_order: float = _set(
        2.0, "per turn: a joint's first order is that of weight and of how a reflector is mounted", JUDGEMENT
    )
    turns: float = _set(1.5, "waves within the range of the joint, at least: fewer are no ripple", JUDGEMENT)
    beats: float = _set(0.5, "of a beat within the range of the joint: two orders that show less are one", JUDGEMENT)
    few_turns: float = _set(0.6, "waves within the range, at least: less is an offset and a slope", JUDGEMENT)
    of_few_turns: float = _set(4.0, "penalty of a wave of which less than ``turns`` are seen", JUDGEMENT)
    late_s: float = _set(
        0.001, "s; encoders that are later than their command by less have no clock of their own", JUDGEMENT
    )
    follows: float = _set(
        0.00001, "rad, 1 sigma; encoders that stay closer to the command than this show no lag of their own", JUDGEMENT
    )
    above_noise: float = _set(10.0, "times its noise that the power of a velocity must reach to be motion", JUDGEMENT)
    cycle_differs: float = _set(
        0.02, "of the usual length of a labelled cycle by which another may be longer or shorter", JUDGEMENT
    )
    describes: float = _set(
        0.1, "of the range of a joint's torque that rigid bodies may leave where gears are loaded by them", JUDGEMENT
    )
    part_of_load: float = _set(
        8.0,
        "gain that a motion asks for before it holds mass or place of a load for as stated",
        JUDGEMENT,
    )
    links_chance: float = _set(
        1e-2, "of masses so far off: below it a payload that predicts no worse is the better reason", JUDGEMENT
    )
    links_gain: float = _set(
        0.02, "share of the held-out error that scales of link masses must take beyond what a payload takes", JUDGEMENT
    )
    gap: float = _set(3.0, "sampling intervals; a longer pause starts a new segment", JUDGEMENT)
    pause_s: float = _set(0.03, "s that such a pause lasts at least", JUDGEMENT)
    stretch_s: float = _set(1.0, "s that are held out together, at least", JUDGEMENT)
    cycle_s: float = _set(0.25, "s whose errors may be correlated", JUDGEMENT)
    top_hz: float = _set(80.0, "Hz; no drive of an arm is asked for more", JUDGEMENT)
    rate_hz: float = _set(
        50.0, "Hz of readings at least, where the record has so many; faster is mostly noise of the drives", JUDGEMENT
    )
    uneven: float = _set(
        0.05, "mean scatter of the sampling intervals from which on filters need an even grid", JUDGEMENT
    )
    dropped: float = _set(0.5, "of a sampling interval, by which a longer one has a sample missing", JUDGEMENT)
    shortest_s: float = _set(0.5, "s; shorter segments are left out", JUDGEMENT)
    shortest_readings: int = _set(24, "readings; segments and cycles of fewer are left out, or are none", JUDGEMENT)
    same_slot: float = _set(0.05, "of a block, within which those of two cycles lie at the same phase", JUDGEMENT)
    same_phase: float = _set(
        0.02, "of the spread of the joints; a motion that comes back closer than this is periodic", JUDGEMENT
    )
    gear_swing: float = _set(0.02, "of the largest load of a gear by which it must change", JUDGEMENT)
    followed: float = _set(
        0.3, "of a lag of the encoders that the TCP may show where it is the encoders' clock", JUDGEMENT
    )
    alike: float = _set(0.2, "scatter of the joints per their mean lag, where one clock is late", JUDGEMENT)
    links_groups: float = _set(0.75, "of the stretches that scales of link masses must make better", JUDGEMENT)
    needed: float = _set(
        0.02, "of the torque that the most loaded joint needs: less says nothing of units or signs", JUDGEMENT
    )
    torque_factor: float = _set(0.5, "relative, of slopes of torque to a thousand and to each other", JUDGEMENT)
    current_alike: float = _set(25.0, "neighbouring readings that share what a gain of a current is off by", JUDGEMENT)
    current_sure: float = _set(
        0.25, "relative 1 sigma of a joint's gain that its masses give, beyond which nothing says it", JUDGEMENT
    )
    turn_over: float = _set(0.995, "of the power left, below which another breakaway path is better", JUDGEMENT)

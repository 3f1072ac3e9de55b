"""What an arm at rest, or in motion, can show at all; how two readings are the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.estimate.origin import JUDGED
from machopt.estimate.origin import threshold as _set


@dataclass(frozen=True, kw_only=True)
class Resting:
    """Load tests and poses."""

    same_load: float = _set(0.08, "of the largest load of a pose: readings so near are of the same load", JUDGED)
    known_to: float = _set(0.2, "share of K_C that the compliances found leave open", JUDGED)
    force_gain: float = _set(0.02, "1 sigma of the force between sessions", JUDGED)
    first_moment: float = _set(
        10.0, "kg·m per m⁴ of reach, 1 sigma of what a long link bears where no file tells its weight", JUDGED
    )
    heavy: float = _set(
        2.0, "robust standard deviations, from where on a reading counts less in the first fit of poses", JUDGED
    )
    rubber: float = _set(
        5.0, "times the cell's compliance, 1 sigma: frames and waves must not turn a spring to rubber", JUDGED
    )
    near_cell: float = _set(
        2.0, "factor around the cell's compliance within which springs stay that weights are seen through", JUDGED
    )
    spring_prior: float = _set(
        1.0, "relative 1 sigma of the cell's stiffness, which the first fit leans on where weight says nothing", JUDGED
    )
    usual_joint: float = _set(1e-06, "rad/(N·m), where the cell has no stiffness", JUDGED)
    lever: float = _set(
        0.5, "m: an error of rotation counts as the shift it makes so far away, while the noise is not known", JUDGED
    )
    rare: float = _set(0.02, "of the readings that lie beyond what counts as a joint's range or largest torque", JUDGED)
    near_usual: float = _set(
        20.0, "the same below ``usual_joint`` where the cell has none: springs that weights are seen through", JUDGED
    )
    least_bend: float = _set(
        1e-07, "m at the cell's own stiffness: a joint whose torque moves the TCP less has no column", JUDGED
    )
    taken_up: float = _set(
        0.001, "of a column's length that the base leaves: less is nothing but rounding of the geometry", JUDGED
    )
    distinct: float = _set(
        0.3, "of what the base leaves of a law: less beside a zero offset of the joint, and it is one", JUDGED
    )
    least_wave: float = _set(
        float(np.radians(10.0)), "rad, range of a joint below which a wave is a zero offset and a slope", JUDGED
    )
    fewest_angles: int = _set(8, "distinct angles: what is drawn through fewer is any line", JUDGED)
    angle_decimals: int = _set(3, "decimals of a radian: poses that are returned to differ by less", JUDGED)
    above_balancer: float = _set(3.0, "per turn of its joint, the lowest order that is not a balancer's", JUDGED)
    most_balanced: float = _set(
        100.0,
        "times the largest torque of weight at its joint that a balancer carries, at most",
        JUDGED,
    )
    most_varied: float = _set(
        5.0, "times its least, a joint's largest compliance over its angles: no gear is built so unevenly", JUDGED
    )
    poses_per_order: float = _set(3.0, "distinct angles that each order of a wave asks for", JUDGED)
    least_turn: float = _set(
        float(np.radians(15.0)), "rad, range of a joint below which a torque by its angle does not show", JUDGED
    )
    held_by_maker: float = _set(0.0005, "m, 1 sigma of an axis beside its drawing", JUDGED)
    turned_by_maker: float = _set(float(np.radians(0.05)), "rad, the same of its direction", JUDGED)
    doubt_of_maker: float = _set(
        1.0,
        "times what a maker holds, 1 sigma of a frame: what poses hardly tell apart stays near the drawing",
        JUDGED,
    )
    aside: float = _set(
        8.0,
        "gain on unseen groups by which base and joint 1 must beat the tracker's frame, which the robot has no part in",
        JUDGED,
    )
    crowded: int = _set(4, "places; so few are told better by the search one by one", JUDGED)
    clearer: float = _set(
        1.5,
        "gain of a law of weight per that of the best frame or wave: with less it stands in for several of those",
        JUDGED,
    )
    per_column: int = _set(
        20, "whitened rows that each column asks for: with fewer some sum among many fits any noise", JUDGED
    )
    visible: float = _set(0.001, "of a column's own square that must be left beside what was fitted together", JUDGED)
    noise_known: float = _set(0.5, "whitened variance left, below which the noise held most of what was found", JUDGED)
    certain_joint: float = _set(
        0.5, "standard error per compliance from which on a joint keeps the cell's value", JUDGED
    )
    turned: float = _set(
        float(np.radians(30.0)),
        "rad, spread of the tool's attitude at which one lever in base axes is no longer a tool's",
        JUDGED,
    )
    fine: float = _set(5e-06, "m; readings rounded more coarsely agree by chance", JUDGED)
    whole_step: float = _set(0.02, "of that, within which a reading is a whole number of such steps", JUDGED)
    stiffest: float = _set(
        0.2,
        "times the cell's compliance: less, or a spring that pushes back, is what frames and waves make of it",
        JUDGED,
    )
    seen_spring: float = _set(
        0.02,
        "of what the first fit leaves: a spring that gives less beside all frames would take up anything else",
        JUDGED,
    )
    seen_apart: float = _set(
        1e-3, "of the best seen direction of frames and reflectors: less is held by nominal places alone", JUDGED
    )
    shown_geometry: float = _set(0.03, "of a direction's own size that the base must leave", JUDGED)
    weak_geometry: float = _set(
        0.02, "of the strongest direction that is shown: weaker ones would need millimetres to be seen", JUDGED
    )
    nest_placed: float = _set(
        0.002, "m, 1 sigma of a reflector's nominal place in the first fit, where the recording states none", JUDGED
    )
    stand_turned: float = _set(
        0.1, "rad of a tracker's own frame against base_link: beyond, it is brought there first", JUDGED
    )
    stand_shifted: float = _set(0.3, "m, the same of its place", JUDGED)
    same_spread: float = _set(0.03, "relative: within, the points of a stand spread as the arm's do", JUDGED)
    same_rotation: float = _set(
        float(np.radians(1.0)), "rad: rotations on a job that differ by less are the same choice", JUDGED
    )
    worth_turning: float = _set(0.01, "of the deflection on a job: to turn the tool for less is of no use", JUDGED)
    flat: float = _set(0.02, "of the longest extent of a stand's points: less to any other side is a line", JUDGED)
    turned_by_load: float = _set(
        0.001, "of the torque of the most loaded joint: a joint that bears less shows nothing", JUDGED
    )


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motions."""

    long_s: float = _set(600.0, "s; heat needs ten minutes to show", JUDGED)
    under_way: float = _set(0.1, "of a joint's usual speed, above which it tells the clock of its torque", JUDGED)
    mostly_under_way: float = _set(0.2, "of the readings; with fewer under way all of them tell the clock", JUDGED)
    moves: float = _set(0.002, "rad (m); a joint that turns less does not move", JUDGED)
    slow_s: float = _set(0.5, "s between samples: a clock in milliseconds rather than a motion", JUDGED)
    few_degrees: float = _set(6.3, "deg; a range within it is rather of radians", JUDGED)
    few_millimetres: float = _set(5.0, "mm; a range within it is rather of metres", JUDGED)
    loaded: float = _set(
        0.05, "of the largest load: one that changes by less shows no friction that grows with it", JUDGED
    )
    slowest_order: float = _set(
        2.0, "per turn: a joint's first order is that of weight and of how a reflector is mounted", JUDGED
    )
    turns: float = _set(1.5, "waves within the range of the joint, at least: fewer are no ripple", JUDGED)
    beats: float = _set(0.5, "of a beat within the range of the joint: two orders that show less are one", JUDGED)
    few_turns: float = _set(0.6, "waves within the range, at least: less is an offset and a slope", JUDGED)
    of_few_turns: float = _set(4.0, "penalty of a wave of which less than ``turns`` are seen", JUDGED)
    late_s: float = _set(
        0.001, "s; encoders that are later than their command by less have no clock of their own", JUDGED
    )
    follows: float = _set(
        0.00001, "rad, 1 sigma; encoders that stay closer to the command than this show no lag of their own", JUDGED
    )
    above_noise: float = _set(10.0, "times its noise that the power of a velocity must reach to be motion", JUDGED)
    cycle_differs: float = _set(
        0.02, "of the usual length of a labelled cycle by which another may be longer or shorter", JUDGED
    )
    describes: float = _set(
        0.1, "of the range of a joint's torque that rigid bodies may leave where gears are loaded by them", JUDGED
    )
    link_scale: float = _set(0.05, "1 sigma of what a URDF states of a link", JUDGED)
    part_of_load: float = _set(
        8.0,
        "gain that a motion asks for before it holds mass or place of a load for as stated",
        JUDGED,
    )
    links_chance: float = _set(
        1e-2, "of masses so far off: below it a payload that predicts no worse is the better reason", JUDGED
    )
    link_off: float = _set(0.15, "the same where the data say plainly that links are off", JUDGED)
    links_gain: float = _set(
        0.02, "share of the held-out error that scales of link masses must take beyond what a payload takes", JUDGED
    )
    gap: float = _set(3.0, "sampling intervals; a longer pause starts a new segment", JUDGED)
    pause_s: float = _set(0.03, "s that such a pause lasts at least", JUDGED)
    stretch_s: float = _set(1.0, "s that are held out together, at least", JUDGED)
    cycle_s: float = _set(0.25, "s whose errors may be correlated", JUDGED)
    top_hz: float = _set(80.0, "Hz; no drive of an arm is asked for more", JUDGED)
    rate_hz: float = _set(
        50.0, "Hz of readings at least, where the record has so many; faster is mostly noise of the drives", JUDGED
    )
    uneven: float = _set(0.05, "mean scatter of the sampling intervals from which on filters need an even grid", JUDGED)
    dropped: float = _set(0.5, "of a sampling interval, by which a longer one has a sample missing", JUDGED)
    shortest_s: float = _set(0.5, "s; shorter segments are left out", JUDGED)
    shortest_readings: int = _set(24, "readings; segments and cycles of fewer are left out, or are none", JUDGED)
    same_slot: float = _set(0.05, "of a block, within which those of two cycles lie at the same phase", JUDGED)
    same_phase: float = _set(
        0.02, "of the spread of the joints; a motion that comes back closer than this is periodic", JUDGED
    )
    gear_swing: float = _set(0.02, "of the largest load of a gear by which it must change", JUDGED)
    followed: float = _set(
        0.3, "of a lag of the encoders that the TCP may show where it is the encoders' clock", JUDGED
    )
    alike: float = _set(0.2, "scatter of the joints per their mean lag, where one clock is late", JUDGED)
    links_groups: float = _set(0.75, "of the stretches that scales of link masses must make better", JUDGED)
    needed: float = _set(
        0.02, "of the torque that the most loaded joint needs: less says nothing of units or signs", JUDGED
    )
    torque_factor: float = _set(0.5, "relative, of slopes of torque to a thousand and to each other", JUDGED)
    current_alike: float = _set(25.0, "neighbouring readings that share what a gain of a current is off by", JUDGED)
    current_sure: float = _set(
        0.25, "relative 1 sigma of a joint's gain that its masses give, beyond which nothing says it", JUDGED
    )
    turn_over: float = _set(0.995, "of the power left, below which another breakaway path is better", JUDGED)

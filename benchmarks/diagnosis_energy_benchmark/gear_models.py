"""Gears with more than a spring: extra angle under the torque that acts, laws of this lab's own choosing.

backlash: a contact smoothed over the seal's drag; memory: Dahl's bristles (exact exponential along each monotone step)
or a Preisach plane of relays; creep: logarithmic, superposed over every change of load; softness at small torque:
arctangent; a stiffness that differs over one bump of the joint's angle (von Mises). Torques N·m, angles rad.
Sources: Dahl 1968; Mayergoyz, Mathematical Models of Hysteresis, 1991; Findley 1976 on creep.
"""

from __future__ import annotations

import numpy as np
from dual_quaternions import Array
from elastic_arm import Gear, Script


def soft_start(extra: float, knee: float) -> Gear:
    """``extra`` compliance at rest, rad/(N·m), that is used up beyond ``knee`` N·m."""

    def law(torque: Array, script: Script) -> Array:
        return extra * knee * np.arctan(torque / knee)

    return law


def clearance(width: float, drag: float) -> Gear:
    """Play of ``width`` rad between flanks, carried over within a few ``drag`` N·m."""

    def law(torque: Array, script: Script) -> Array:
        return 0.5 * width * np.tanh(torque / drag)

    return law


def starts(script: Script, memory: str) -> Array:
    """(N,) True where a gear forgets: ``kept`` never, ``wound`` on arrival at a pose, ``cycle`` at every load cycle."""
    if memory == "kept":
        same = np.ones(len(script.time), dtype=bool)
    elif memory == "wound":
        same = np.r_[False, script.visit[1:] == script.visit[:-1]]
    else:
        same = np.r_[False, (script.cycle[1:] == script.cycle[:-1]) & (script.visit[1:] == script.visit[:-1])]
    return ~same


def dahl(width: float, reach: float, memory: str) -> Gear:
    """Loop ``width`` rad wide at its full opening, which needs about ``reach`` N·m of torque to turn over.

    What friction holds back of the twist: it follows every change of the torque, against it, and takes up energy.
    z' = (1 - z sign(τ') 2/width) width/reach; a fresh start is wound from no torque to the one on arrival (wound) or
    begins at rest (cycle).
    """

    def law(torque: Array, script: Script) -> Array:
        fresh = starts(script, memory)
        out = np.zeros_like(torque)
        z, last = 0.0, 0.0
        half = width / 2
        for k, now in enumerate(torque):
            if fresh[k]:
                z, last = 0.0, (0.0 if memory == "wound" else now)
            change = now - last
            goal = half if change > 0 else -half
            z = goal + (z - goal) * np.exp(-2.0 * abs(change) / reach)
            out[k], last = -z, now
        return out

    return law


def preisach(width: float, reach: float, memory: str) -> Gear:
    """Relays on a triangle of thresholds up to ``reach`` N·m, weights falling off from the middle."""
    grid = np.linspace(-reach, reach, 15)
    up, down = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
    kept = up > down
    up, down = up[kept], down[kept]
    weight = np.exp(-((up + down) ** 2) / (0.5 * reach) ** 2 - ((up - down) - 0.5 * reach) ** 2 / (0.5 * reach) ** 2)
    weight *= 0.5 * width / weight.sum()

    def law(torque: Array, script: Script) -> Array:
        fresh = starts(script, memory)
        state = np.zeros(len(up))
        out = np.zeros_like(torque)
        base = 0.0
        soft = reach / 14
        for k, now in enumerate(torque):
            if fresh[k]:
                state, base = np.zeros(len(up)), (0.0 if memory == "wound" else now)
            there = now - base if memory == "cycle" else now
            # relays one after the other would step: each turns over smoothly within one cell of the plane
            state = np.maximum(state, np.tanh((there - up) / soft))
            state = np.minimum(state, np.tanh((there - down) / soft))
            out[k] = float(weight @ state)
        return out

    return law


# a load from none up and down and up again: where it comes through zero either way
ROUND = np.concatenate([np.linspace(0, 1, 12), np.linspace(1, -1, 49)[1:], np.linspace(-1, 1, 49)[1:]])
BACK, FORTH = 35, 83


def opening(gear: Gear, largest: float) -> float:
    """rad between the branches where the load passes through zero, cycled to ± ``largest`` N·m.

    What a loop would open to under torques that never came is not in a record.
    """
    none = np.zeros(len(ROUND), dtype=int)
    twist = gear(
        largest * ROUND, Script(np.zeros((len(ROUND), 6)), np.zeros((len(ROUND), 6)), none * 1.0, none, none, none)
    )
    return abs(float(twist[BACK] - twist[FORTH]))


def slow(share: float, compliance: float, first: float = 3.0) -> Gear:
    """Creep: after a minute under a load ``share`` of its elastic angle more, logarithmic from ``first`` s on."""

    def law(torque: Array, script: Script) -> Array:
        steps = np.diff(torque, prepend=0.0)
        steps[0] = 0.0  # had all the time before
        fresh = np.r_[True, script.session[1:] != script.session[:-1]]
        steps[fresh] = 0.0
        age = script.time[:, None] - script.time[None, :]
        kernel = np.where(age > 0, np.log1p(np.maximum(age, 0) / first), 0.0) / np.log1p(60.0 / first)
        kernel *= script.session[:, None] == script.session[None, :]
        return np.asarray(share * compliance * (kernel @ steps))

    return law


def sector(extra: float, centre: float, narrow: float, joint: int) -> Gear:
    """``extra`` compliance rad/(N·m) where ``joint`` stands at ``centre`` rad, less away from it (von Mises)."""

    def law(torque: Array, script: Script) -> Array:
        return extra * np.exp(narrow * (np.cos(script.q[:, joint] - centre) - 1.0)) * torque

    return law

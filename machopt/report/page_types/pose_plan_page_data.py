"""Data of the page of ``machopt plan-poses``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from machopt.numerics.array_types import Array, Bools, Ints
from machopt.report.scene.scene_types import CellScene, ScenePostures


@dataclass(frozen=True, kw_only=True)
class HeuristicRow:
    """Published rule of choosing poses, for comparison."""

    name: str
    words: str
    poses: int  # it draws from
    sigma: Array  # (P,) relative, median
    rms: tuple[float, float, float]  # 10, 50, 90 % of the draws
    efficiency: tuple[float, float, float]  # D, A, E
    readings: float  # times ours, of full loads, for the same rms
    curve: Array  # rms at each number of poses


@dataclass(frozen=True, kw_only=True)
class LoadCycles:
    """N load cycles in the order of work."""

    session: Ints  # (N,) round, from 1
    pose: Ints  # (N,) from 1
    cycle: Ints  # (N,) at its pose, from 1
    q: Array  # (N, 6) rad
    load: tuple[str, ...]  # (N,) in words
    deflection: Array  # (N,) m
    kci: Array  # (N,)
    nu_p: Array  # (N,)
    clearance: Array  # (N,) m, NaN where not looked for
    way_free: tuple[bool | None, ...]  # (N,) straight joint motion from the row before


@dataclass(frozen=True, kw_only=True)
class ExplanationPair:
    """Two explanations and how well the plan separates them."""

    pair: str
    why: str
    per_cycle: float  # noncentrality of one round, the worse way round
    planned: float  # of all rounds
    is_distinguished: bool  # in nine of ten cases, by diagnose's own test
    cycles: int | None  # for 90 % at the 1 % level
    cycles_until_excluded: int | None  # rounds until diagnose excludes the wrong one, given these readings alone
    random: float  # of one round at random poses and loads, median
    advice: str  # what would split them where this cannot


@dataclass(frozen=True, kw_only=True)
class JointDemand:
    """Load of one joint in the job and in the load tests."""

    joint: int
    job: tuple[float, float] | None  # N·m, weight and process; None: not known
    tests: tuple[float, float]  # N·m, weight and load at the readings
    shows_play: bool  # a usual play would show


@dataclass(frozen=True, kw_only=True)
class PosePlanPageData:
    """What the page shows; lengths in m. Without a plan only the reason and the counts."""

    title: str
    cell: str
    version: str
    tried: int
    passed: int
    cases: int
    rejected_poses: tuple[tuple[str, int], ...]
    rejected_loads: tuple[tuple[str, int], ...]
    warnings: tuple[str, ...]
    options: tuple[tuple[str, str], ...]
    hashes: tuple[tuple[str, str], ...]
    reason: str = ""  # why there is no plan
    unknowns: tuple[str, ...] = ()
    relative: Bools = field(default_factory=lambda: np.zeros(0, bool))  # (P,) sigma is a share of the prior value
    sigma: Array = field(default_factory=lambda: np.zeros(0))  # (P,) expected 1 sigma; inf where not seen
    rms: float = math.nan
    condition: float = math.nan
    bound: float = math.nan  # least D-efficiency
    poses: int = 0
    readings: int = 0
    per_pose: int = 0  # readings at a pose, every step of every cycle
    heuristics: tuple[HeuristicRow, ...] = ()
    curve_poses: tuple[int, ...] = ()
    curve: Array = field(default_factory=lambda: np.zeros(0))
    target: float = math.nan
    needed: int | None = None  # poses for the target
    cloud: Array = field(default_factory=lambda: np.zeros((0, 3)))  # TCPs of candidates, base_link
    arms: Array = field(default_factory=lambda: np.zeros((0, 8, 3)))  # points along the arm at each pose
    work: LoadCycles | None = None
    explanation_pairs: tuple[ExplanationPair, ...] = ()  # of a plan that discriminates
    rounds: int = 0
    required_noncentrality: float = math.nan  # noncentrality for 90 % at the 1 % level
    job: tuple[JointDemand, ...] = ()
    steps: tuple[float, ...] = (1.0,)  # shares of its load that a cycle is read at
    scene: CellScene | None = None
    postures: ScenePostures | None = None

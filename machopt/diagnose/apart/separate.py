"""Poses and loads at which the explanations that a diagnosis left differ most.

::

    diagnosis.json ─► disputes ─► laws at candidate poses × loads ─► contests ─► least separation, maximised ─► PosePlan
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.design.accuracy import accuracy
from machopt.design.candidates import PosePool
from machopt.design.loadcases import LoadCases
from machopt.design.loads import LoadWay
from machopt.design.maximin import (
    Contest,
    left_of_all,
    needed_noncentrality,
    random_readings,
)
from machopt.design.measurement import UNLOADED_TWICE, ReadingNoise
from machopt.design.poseplan import PlanSize, PosePlan, problem_of, unknowns_of
from machopt.design.schedule import schedule, shortest_way
from machopt.design.search import Design, information
from machopt.diagnose import calibrated
from machopt.diagnose.apart.advice import advice, words
from machopt.diagnose.apart.disputes import HIDDEN, MOST, NOTHING, PLACES, Diagnosed, Dispute, Stand
from machopt.diagnose.apart.predicted import (
    Law,
    Predicted,
    forms_of,
    law_of,
    load_tests,
    noise_of_cases,
    standing,
    steps_for,
)
from machopt.diagnose.apart.sized import (
    Side,
    chosen,
    rounds_for,
    rounds_of_all,
    rounds_to_exclude,
    separation,
    toughened,
)
from machopt.domain.cell import Cell
from machopt.model.elastic import ArmElasticity
from machopt.model.robot import Masses, Robot

Ints = NDArray[np.int64]

ROWS = 60_000  # numbers × cases looked at: more take minutes and change nothing
FEWEST = 200  # poses looked at; rather fewer loads at each
DRAWS = 30  # random designs beside
TURNS = 3  # of choosing readings and of looking for forms of the rivals that these tell worse


@dataclass(frozen=True)
class Asked:
    """What the user says of the measurement."""

    noise: ReadingNoise  # of a reading, with the rounds that are wanted at least
    stated: bool  # the user typed the noise: it counts even where the diagnosis saw another
    targets: float  # m, between the targets on the tool


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two laws and how well the plan tells them apart."""

    one: Stand
    two: Stand
    why: str  # which finding
    per_cycle: float  # noncentrality of one round over all poses, the worse way round
    planned: float  # of all rounds
    cycles: int | None  # for 90 % at the 1 % level; None: not within 50
    until: int | None  # until diagnose, given these readings alone, excludes the wrong one; None: rounds do not do it
    random: float  # median noncentrality of one round at random poses and loads
    advice: str  # what would split them where this cannot
    told: bool = False  # by all rounds, in nine of ten cases, by diagnose's own test

    @property
    def possible(self) -> bool:
        return not self.advice


@dataclass(frozen=True, kw_only=True)
class Discriminating:
    """A plan that tells explanations apart."""

    plan: PosePlan
    noise: ReadingNoise  # with the plan's cycles
    steps: tuple[float, ...]
    pairs: tuple[Pair, ...]
    least: float  # noncentrality per round of the worst pair that can be split
    random: float
    notes: tuple[str, ...]


def noise_for(asked: Asked, found: Diagnosed, cycles: int) -> ReadingNoise:
    """Noise of ``cycles`` rounds: what the diagnosis saw, or what was typed."""
    stated = asked.noise
    if found.scatter is None or asked.stated:
        return replace(stated, cycles=cycles, targets=stated.targets if found.coordinates == 6 else None)
    own, visit = found.scatter
    targets = None
    if found.coordinates == 6:
        targets = own / found.turn if found.turn else asked.targets
    # each round arrives anew, so what a visit shares is new in each
    return ReadingNoise(
        displacement=own / np.sqrt(UNLOADED_TWICE),
        cycle=0.0,
        pose=visit / np.sqrt(cycles),
        force=stated.force,
        targets=targets,
        cycles=cycles,
    )


def compliance_for(found: Diagnosed, stiffness: Array) -> Array:
    """(6,) rad/(N·m) of the diagnosis; the cell's where it has none."""
    return np.array([found.compliance.get(j, 0.0) or 1.0 / stiffness[j - 1] for j in range(1, 7)])


def discriminating(
    asked: Asked,
    found: Diagnosed,
    cell: Cell,
    robot: Robot,
    masses: Masses | None,
    pool: PosePool,
    cases: LoadCases,
    ways: Sequence[LoadWay],
    prior: ArmElasticity,
    size: PlanSize,
    progress: Callable[[str], None] = lambda _: None,
) -> Discriminating:
    """Choose poses, loads and rounds.

    Args:
        asked: what is believed of the instrument, and rounds.
        found: the diagnosis.
        cell, robot, masses: the arm.
        pool, cases, ways: what may be measured; at least one case.
        prior: stiffness of the arm as diagnosed.
        size: poses, loads, seed.
    """
    rng = np.random.default_rng(size.seed)
    noise = noise_for(asked, found, 1)
    compliance = compliance_for(found, prior.stiffness.joints)
    stands = [s for d in found.disputes for s in (*d.stands, *d.beside)]
    steps = steps_for(stands) if found.channel == "deflection" else (1.0,)
    few = _thinned(cases, ROWS // (len(steps) * noise.dimensions), rng)
    progress("what each explanation predicts")
    q = pool.q[few.pose]
    if found.channel == "deflection":
        T = cell.tool.T_flange_tcp
        at = load_tests(found, few, q, robot, T, masses, compliance, steps, noise.dimensions)
    else:
        at = standing(found, few, q, cell, robot, masses, compliance, noise.dimensions, rng)
    covariance, shared = noise_of_cases(few, noise, steps)
    open_, closed, notes = _contests(found, at, covariance + shared, noise.dimensions)
    progress("choosing poses and loads")
    contests = [both for _, both, _ in open_]
    for turn in range(TURNS):
        blocks = chosen(contests, at.base, covariance, shared, few.pose, size, rng, grow=turn > 0)
        known = [len(both) for both in contests]
        pool_of = zip(contests, open_, strict=True)
        contests = [toughened(both, sides, covariance + shared, blocks) for both, (_, _, sides) in pool_of]
        if turn > 0 and known == [len(both) for both in contests]:
            break
    home, velocity = cell.home[:6], cell.limits.velocity[:6]
    blocks = tuple(blocks[i] for i in shortest_way(pool.q[few.pose[[b[0] for b in blocks]]], home, velocity))
    draws = [random_readings(few.pose, len(blocks), size.loads, rng) for _ in range(DRAWS)]
    progress("how well they tell apart")
    enough = needed_noncentrality()
    each = [separation(both, covariance, shared, few.pose, blocks) for both in contests]
    chance = np.array([[separation(both, covariance, shared, few.pose, b) for b in draws] for both in contests])
    excluded = [rounds_to_exclude(both, covariance + shared, blocks, at.base) for both in contests]
    wanted = []
    for both, first in zip(contests, each, strict=True):

        def planned(n: int, both: Sequence[Contest] = both) -> float:
            own, together = noise_of_cases(few, noise_for(asked, found, n), steps)
            return separation(both, own, together, few.pose, blocks)

        wanted.append(rounds_for(planned, first, enough))
    cycles = max(asked.noise.cycles, rounds_of_all(wanted, excluded))
    final = noise_for(asked, found, cycles)
    own, together = noise_of_cases(few, final, steps)
    pairs = []
    for k, ((pair, _, _), both) in enumerate(zip(open_, contests, strict=True)):
        whole, until = separation(both, own, together, few.pose, blocks), excluded[k]
        pairs.append(
            replace(
                pair,
                per_cycle=each[k],
                planned=whole,
                cycles=wanted[k],
                until=until,
                random=float(np.median(chance[k])),
                told=whole >= enough and until is not None and until <= cycles,
                advice="" if wanted[k] is not None else advice(pair.one, pair.two),
            )
        )
    plan = _plan(prior, few, Design(blocks, min(each, default=0.0)), final, rng)
    least = min(each, default=0.0)
    worst = float(np.median(chance.min(axis=0))) if len(open_) else 0.0
    return Discriminating(
        plan=plan,
        noise=final,
        steps=steps,
        pairs=(*pairs, *closed),
        least=least,
        random=worst,
        notes=(*found.notes, *notes),
    )


def _contests(
    found: Diagnosed, at: Predicted, covariance: Array, dimensions: int
) -> tuple[list[tuple[Pair, list[Contest], list[Side]]], list[Pair], list[str]]:
    """Pairs that can be split with their contests and what else their rivals may be, pairs that nothing here can split,
    and what was left out."""
    share = 3.0 / dimensions
    open_: list[tuple[Pair, list[Contest], list[Side]]] = []
    forms: dict[tuple[str, str], tuple[Array, ...]] = {}
    closed: list[Pair] = []
    notes: list[str] = []
    made: dict[tuple[int, int], Array] = {}
    for number, d in enumerate(found.disputes):
        laws, pairs = _laws(d, at, covariance, share, notes)
        beside = [law_of(s, at, share) for s in d.beside]
        base = np.concatenate([at.base, *(b.columns[0] for b in beside if b is not None)], axis=2)
        for i, j in pairs:
            one, two = laws[i], laws[j]
            pair = Pair(
                one=one.stand,
                two=two.stand,
                why=d.why,
                per_cycle=0.0,
                planned=0.0,
                cycles=None,
                until=None,
                random=0.0,
                advice="",
            )
            contests: list[Contest] = []
            sides: list[Side] = []
            for t, r in ((i, j), (j, i)):
                if laws[t].stand is NOTHING:
                    continue
                for n, columns in enumerate(laws[r].columns):
                    key = (number * 1000 + r, n)
                    if key not in made:
                        made[key] = np.concatenate([base, columns], axis=2)
                    contests.append(Contest(t, r, made[key], laws[t].signal))
                rival = laws[r].stand
                if rival.name not in forms:
                    forms[rival.name] = forms_of(rival, at)
                sides.append(Side(t, r, laws[t].signal, base, forms[rival.name]))
            left = [left_of_all(c, covariance) for c in contests]
            if min(rest / max(whole, 1e-300) for rest, whole in left) < calibrated.DETECTION.left_apart:
                closed.append(replace(pair, advice=advice(one.stand, two.stand)))
            else:
                open_.append((pair, contests, sides))
    return open_, closed, notes


def _laws(
    d: Dispute, at: Predicted, covariance: Array, share: float, notes: list[str]
) -> tuple[list[Law], list[tuple[int, int]]]:
    """The laws of a dispute at these poses, as many as can be told apart in time."""
    found = {k: law_of(s, at, share) for k, s in enumerate(d.stands)}
    for k, law in found.items():
        if law is None and d.stands[k].coefficients:
            s = d.stands[k]
            notes.append(f"{words(s)} ({s.law}) cannot be predicted at these poses and is left out")
    kept = [k for k, law in found.items() if law is not None]
    sized = [k for k in kept if d.stands[k].size is not None]
    if sized:  # detection limits: what could hide most
        moves = {k: float(np.mean(_signal(found, k) ** 2)) for k in sized}
        kept = [k for k in kept if k not in sized] + sorted(sized, key=lambda k: -moves[k])[:HIDDEN]
    elif any(d.stands[k].rms is not None for k in kept):
        kept = kept[:PLACES]
    else:
        most = kept if NOTHING in d.stands else kept[:MOST]
        notes += [
            f"{words(d.stands[k])} stands too, but the nearest {MOST} are enough at once"
            for k in kept[MOST:]
            if k not in most
        ]
        kept = most
    place = {k: n for n, k in enumerate(kept)}
    laws = [law for k in kept if (law := found[k]) is not None]
    return laws, [(place[i], place[j]) for i, j in d.pairs if i in place and j in place]


def _signal(found: dict[int, Law | None], k: int) -> Array:
    law = found[k]
    assert law is not None  # kept are those that were found
    return law.signal


def _thinned(cases: LoadCases, most: int, rng: np.random.Generator) -> LoadCases:
    """At most so many cases, of poses that come first in the quasi-random sequence: they fill the space evenly."""
    if len(cases) <= most:
        return cases
    poses = np.unique(cases.pose)
    enough = max(FEWEST, most * len(poses) // len(cases))
    keep = np.flatnonzero(np.isin(cases.pose, poses[:enough]))
    keep = np.sort(rng.permutation(keep)[:most])
    return LoadCases(
        pose=cases.pose[keep],
        way=cases.way[keep],
        magnitude=cases.magnitude[keep],
        wrench=cases.wrench[keep],
        point=cases.point[keep],
        twist=cases.twist[keep],
        response=cases.response[keep],
        nu_p=cases.nu_p[keep],
        nu_r=cases.nu_r[keep],
        rejected=cases.rejected,
    )


def _plan(
    prior: ArmElasticity, cases: LoadCases, design: Design, noise: ReadingNoise, rng: np.random.Generator
) -> PosePlan:
    """The design as plan-poses writes it out; joints are identified on the way."""
    unknowns = unknowns_of(prior, (), cases)
    problem, _ = problem_of(cases, unknowns, noise, 1.0, rng)
    seen = accuracy(information(problem, design.blocks))
    judged = unknowns.relative & seen.seen
    visits = schedule(design.blocks, noise.cycles, rng)
    poses = len(design.blocks)
    return PosePlan(
        unknowns=unknowns,
        cases=cases,
        design=design,
        found=seen,
        judged=judged,
        believed=(),
        bound=float("nan"),
        comparisons=(),
        curve_poses=(poses,),
        curve=(seen.rms(judged),),
        needed=None,
        visits=visits,
    )


def described(pair: Pair) -> str:
    """``link compliance of link 3 | link compliance of link 4``."""
    return f"{words(pair.one)} | {words(pair.two)}"

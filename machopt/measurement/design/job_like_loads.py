"""Loads like the job's: readings at two sizes of each load, and loads that turn every joint both ways round.

Full loads alone call play or a knee a softer spring. A reading of a load test counts from the unloaded arm, whose
weight rests on one side of each gear's play already: only a load that turns the joint's whole torque round goes
through it, and only two sizes of it tell the step from a slope. For springs a load and its opposite say the same, so
loads are exchanged at their poses, at most LOST of the design's efficiency given for it, until play shows at every
joint that the poses and loads at hand allow it at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.design.d_optimal_search import (
    RIDGE,
    DesignProblem,
    ReadingDesign,
    compute_design_criterion,
    compute_information_matrix,
)
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.maximin_discrimination import compute_required_noncentrality
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.numerics.array_types import Array, Bools
from machopt.stiffness.discrepancy_columns import TYPICAL_PLAY_RAD

SMALLEST, LARGEST = 0.2, 0.5  # of a full load, the smaller one of the two it is read at
MAX_EFFICIENCY_LOSS = 0.05  # of the D-efficiency
REVERSAL_WEIGHT = 0.1  # of the logarithm of what shows of play: a joint whose loads all turn it one way
ROUNDS = 6  # of exchange
MIN_REVERSAL_SHARE = 0.02  # of a joint's largest torque by loads: less to a side is not turned round


@dataclass(frozen=True, kw_only=True)
class ProcessLoads:
    """What a job asks of the arm."""

    force: tuple[float, float]  # N, least and largest of the process
    torque: Array | None = None  # (2, 6) N·m, least and largest of weight and process along the path; None: not known
    words: str = ""  # where it comes from


@dataclass(frozen=True)
class JointLoadComparison:
    """One joint: torque of weight and load in the job and in the load tests, and whether play would show."""

    joint: int  # from 1
    job: tuple[float, float] | None  # N·m
    tests: tuple[float, float]  # N·m, at the readings
    backlash_noncentrality: float  # noncentrality of a usual play, USUAL_PLAY to either side, beside the springs

    @property
    def is_reversed_in_job(self) -> bool | None:
        """Whether the job turns it round; None: not known."""
        return None if self.job is None else bool(self.job[0] < 0.0 < self.job[1])

    @property
    def detects_backlash(self) -> bool:
        """Whether these tests would show a usual play in nine of ten cases, at the 1 % level."""
        return self.backlash_noncentrality >= compute_required_noncentrality()


def compute_load_steps(job: ProcessLoads, cases: LoadCases) -> tuple[float, ...]:
    """Shares of each load that are read: the job's least force where that is within SMALLEST … LARGEST of it."""
    full = float(cases.magnitude.max())
    return (float(np.round(np.clip(job.force[0] / full, SMALLEST, LARGEST), 2)), 1.0)


@dataclass(frozen=True)
class TorqueReversalCases:
    """Every case of a load test as play and springs see it, whitened; joints' springs in units of the prior."""

    load: Array  # (N, 6) N·m of the load alone
    weight: Array  # (N, 6) N·m
    spring_information: Array  # (N, 6, 6) of the six springs alone, over all steps
    cross: Array  # (N, 6, 6) springs × play of each joint
    backlash_information: Array  # (N, 6) play of each joint

    @classmethod
    def from_cases(
        cls,
        cases: LoadCases,
        pool: PosePool,
        robot: Robot,
        masses: RobotMasses | None,
        scale: Array,
        noise: ReadingNoise,
        steps: Sequence[float],
    ) -> TorqueReversalCases:
        """Args:
        scale: (6,) or more, of the unknowns, the six joints' compliances first.
        """
        J = pool.state.J[cases.pose][:, :3]
        load = np.einsum("nci,nc->ni", pool.state.J[cases.pose], cases.wrench)
        held = np.zeros(pool.q.shape) if masses is None else compute_weight_torque(robot, masses, pool.state)
        weight = held[cases.pose]
        shares = np.array(steps)
        sigma = noise.reading
        each = J / sigma  # (N, 3, 6)
        spring = each * (load * scale[:6])[:, None, :]
        dead = MIN_REVERSAL_SHARE * np.abs(load).max(axis=0)
        turned = (
            _find_backlash_flank(weight[:, None] + shares[:, None] * load[:, None], dead)
            - _find_backlash_flank(weight, dead)[:, None]
        )
        return cls(
            load,
            weight,
            float(shares @ shares) * np.einsum("ndp,ndq->npq", spring, spring),
            np.einsum("ndi,ndj,s,nsj->nij", spring, each, shares, turned, optimize=True),
            np.einsum("ndj,nsj->nj", each**2, turned**2),
        )

    def compute_backlash_noncentrality(self, rows: Sequence[int]) -> Array:
        """(6,) noncentrality of a usual play at each joint, the six springs refitted."""
        at = np.asarray(rows, np.int64)
        M, c = self.spring_information[at].sum(axis=0), self.cross[at].sum(axis=0)
        back = np.linalg.pinv(M, rcond=1e-9, hermitian=True)
        left = self.backlash_information[at].sum(axis=0) - np.einsum("ij,ik,kj->j", c, back, c)
        return np.asarray(TYPICAL_PLAY_RAD**2 * np.maximum(left, 0.0))

    def value(self, rows: Sequence[int]) -> float:
        """What an exchange makes larger."""
        at = np.asarray(rows, np.int64)
        shown = np.log1p(self.compute_backlash_noncentrality(rows) / compute_required_noncentrality()).sum()
        whole = np.abs(self.load[at]).sum(axis=0)
        one_way = np.abs(self.load[at].sum(axis=0)) / np.maximum(whole, np.finfo(float).tiny)
        return float(shown - REVERSAL_WEIGHT * (one_way**2).sum())


def exchange_loads_for_reversal(
    design: ReadingDesign, cases: LoadCases, t: TorqueReversalCases, problem: DesignProblem
) -> ReadingDesign:
    """The design with loads exchanged at their poses."""
    blocks = [tuple(b) for b in design.blocks]
    at_pose = {int(p): np.flatnonzero(cases.pose == p).tolist() for p in np.unique(cases.pose[design.readings])}
    known: dict[tuple[int, ...], Array] = {}

    def told(chosen: Sequence[tuple[int, ...]]) -> float:
        """log det of what the plan is made for."""
        for b in chosen:
            if b not in known:
                known[b] = compute_information_matrix(problem, [b])
        M = np.sum([known[b] for b in chosen], axis=0)
        return float(np.linalg.slogdet(M + RIDGE * np.eye(len(M)))[1])

    unknowns = problem.models[0].response.shape[2]
    least = told(blocks) + unknowns * float(np.log1p(-MAX_EFFICIENCY_LOSS))
    value = t.value(design.readings.tolist())
    for _ in range(ROUNDS):
        before = value
        for row, k in [(row, k) for row, block in enumerate(blocks) for k in range(len(block))]:
            for n in at_pose[int(cases.pose[blocks[row][k]])]:
                if n in blocks[row]:
                    continue
                other = (*blocks[row][:k], n, *blocks[row][k + 1 :])
                changed = [*blocks[:row], other, *blocks[row + 1 :]]
                now = t.value([m for block in changed for m in block])
                if now > value and told(changed) >= least:
                    blocks, value = changed, now
        if value <= before:
            break
    return replace(design, blocks=tuple(blocks), value=compute_design_criterion(problem, blocks))


def compare_joint_loads(
    job: ProcessLoads, design: ReadingDesign, t: TorqueReversalCases, steps: Sequence[float]
) -> tuple[JointLoadComparison, ...]:
    """What the load tests and the job ask of each joint."""
    rows = design.readings
    reached = np.concatenate([t.weight[rows], *(t.weight[rows] + s * t.load[rows] for s in steps)])
    play = t.compute_backlash_noncentrality(rows.tolist())
    return tuple(
        JointLoadComparison(
            j + 1,
            None if job.torque is None else (float(job.torque[0, j]), float(job.torque[1, j])),
            (float(reached[:, j].min()), float(reached[:, j].max())),
            float(play[j]),
        )
        for j in range(6)
    )


def describe_joint_loads(job: ProcessLoads, joints: Sequence[JointLoadComparison], largest: float) -> tuple[str, ...]:
    """What the user should know.

    Args:
        largest: N, of the loads planned.
    """
    out = []
    if job.force[1] > largest * (1.0 + 1e-9):
        out.append(
            f"the job's force of {job.force[1]:.4g} N is more than any load planned ({largest:.4g} N): what is said of "
            f"it goes beyond what is measured; --pull-N {job.force[1]:.0f} would measure it"
        )
    hidden = [j for j in joints if not j.detects_backlash and j.is_reversed_in_job is not False]
    if hidden:
        names = ", ".join(str(j.joint) for j in hidden)
        why = " The job turns them round." if any(j.is_reversed_in_job for j in hidden) else ""
        arcmin = 2.0 * TYPICAL_PLAY_RAD * 10800.0 / np.pi
        out.append(
            f"play of {arcmin:.2g} arcmin at joint {names} would not show with these loads, which do not turn the "
            f"torque of weight and load round there, or move the tool too little.{why} Larger loads or other ways "
            "(--anchors, --arms-mm) may show it"
        )
    return tuple(out)


def _find_backlash_flank(torque: Array, dead: Array) -> Array:
    """−1, 0 or 1: which flank of its play a joint rests on."""
    turned: Bools = np.asarray(np.abs(torque) > dead)
    return np.asarray(np.where(turned, np.sign(torque), 0.0))

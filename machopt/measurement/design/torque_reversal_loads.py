"""Loads similar to the job: readings at two sizes of each load, and loads that reverse the torque of every joint.

With full loads alone, backlash or a stiffness knee looks like a softer spring. A load-test reading is relative to the
unloaded arm, whose weight already rests on one flank of each gear. Only a load that reverses the total torque of a
joint crosses the backlash, and only two load sizes separate the step from a slope. For linear springs a load and its
opposite are equivalent. Therefore loads are exchanged at their poses until backlash would be detected at every joint
for which the poses and loads allow it. At most :data:`MAX_EFFICIENCY_LOSS` of the design's efficiency is given up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.design.d_optimal_search import RIDGE, compute_design_criterion, compute_information_matrix
from machopt.measurement.design.design_problem import DesignProblem, ReadingDesign
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.maximin_discrimination import compute_required_noncentrality
from machopt.measurement.design.pose_candidates import PosePool
from machopt.measurement.design.reading_noise import ReadingNoise
from machopt.numerics.array_types import Array, Bools
from machopt.stiffness.discrepancy_columns import TYPICAL_PLAY_RAD

SMALLEST, LARGEST = 0.2, 0.5  # range of the smaller load step, relative to the full load
MAX_EFFICIENCY_LOSS = 0.05  # largest relative loss of D-efficiency
REVERSAL_WEIGHT = 0.1  # weight of unbalanced load directions relative to the backlash term
ROUNDS = 6  # exchange rounds
MIN_REVERSAL_SHARE = 0.02  # least torque in either direction that counts as a reversal, relative to the largest


@dataclass(frozen=True, kw_only=True)
class ProcessLoads:
    """Loads of the job on the arm."""

    force: tuple[float, float]  # N, least and largest of the process
    torque: Array | None = (
        None  # (2, 6) N·m, least and largest torque of weight and process along the path; None: unknown
    )
    words: str = ""  # source of the loads


@dataclass(frozen=True)
class JointLoadComparison:
    """Torque range of one joint in the job and in the load tests, and whether backlash would be detected."""

    joint: int  # from 1
    job: tuple[float, float] | None  # N·m
    tests: tuple[float, float]  # N·m, at the readings
    backlash_noncentrality: float  # noncentrality of typical backlash with the springs refitted

    @property
    def is_reversed_in_job(self) -> bool | None:
        """Whether the job reverses the torque of the joint; None if unknown."""
        return None if self.job is None else bool(self.job[0] < 0.0 < self.job[1])

    @property
    def detects_backlash(self) -> bool:
        """Whether the tests would detect typical backlash with 90 % power at the 1 % level."""
        return self.backlash_noncentrality >= compute_required_noncentrality()


def compute_load_steps(job: ProcessLoads, cases: LoadCases) -> tuple[float, ...]:
    """Compute the load steps: the job's least force if it lies within SMALLEST … LARGEST of the full load.

    Args:
        job: Process loads of the job for which the stiffness is needed.
        cases: Admissible load cases.

    Returns:
        Shares of the full load.
    """
    full = float(cases.magnitude.max())
    return (float(np.round(np.clip(job.force[0] / full, SMALLEST, LARGEST), 2)), 1.0)


@dataclass(frozen=True)
class TorqueReversalCases:
    """Information of every load case on backlash and springs, whitened; spring compliances in units of the prior."""

    load: Array  # (N, 6) N·m, joint torques of the load alone
    weight: Array  # (N, 6) N·m
    spring_information: Array  # (N, 6, 6) information on the six springs, over all steps
    cross: Array  # (N, 6, 6) cross information of springs and backlash of each joint
    backlash_information: Array  # (N, 6) information on the backlash of each joint

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
        """Compute the information of all load cases.

        Args:
            cases: Admissible load cases.
            pool: Candidate poses.
            robot: Kinematic model of the arm.
            masses: Link and tool masses; None if unknown.
            scale: (6,) or more scales of the unknowns, the six joint compliances first.
            noise: Noise of a reading.
            steps: Shares of the full load at which a load cycle is read.

        Returns:
            The cases.
        """
        J = pool.state.J[cases.pose][:, :3]
        load = np.einsum("nci,nc->ni", pool.state.J[cases.pose], cases.wrench)
        weight_torque = np.zeros(pool.q.shape) if masses is None else compute_weight_torque(robot, masses, pool.state)
        weight = weight_torque[cases.pose]
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
        """Compute the noncentrality of typical backlash at each joint, with the six springs refitted.

        Args:
            rows: Indices of load cases.

        Returns:
            (6,).
        """
        at = np.asarray(rows, np.int64)
        M, c = self.spring_information[at].sum(axis=0), self.cross[at].sum(axis=0)
        back = np.linalg.pinv(M, rcond=1e-9, hermitian=True)
        left = self.backlash_information[at].sum(axis=0) - np.einsum("ij,ik,kj->j", c, back, c)
        return np.asarray(TYPICAL_PLAY_RAD**2 * np.maximum(left, 0.0))

    def value(self, rows: Sequence[int]) -> float:
        """Compute the objective of the exchange: detectable backlash minus a penalty on unbalanced load directions.

        Args:
            rows: Indices of load cases.

        Returns:
            Value; larger is better.
        """
        at = np.asarray(rows, np.int64)
        shown = np.log1p(self.compute_backlash_noncentrality(rows) / compute_required_noncentrality()).sum()
        whole = np.abs(self.load[at]).sum(axis=0)
        one_way = np.abs(self.load[at].sum(axis=0)) / np.maximum(whole, np.finfo(float).tiny)
        return float(shown - REVERSAL_WEIGHT * (one_way**2).sum())


def exchange_loads_for_reversal(
    design: ReadingDesign, cases: LoadCases, t: TorqueReversalCases, problem: DesignProblem
) -> ReadingDesign:
    """Exchange loads at their poses so that backlash becomes detectable.

    Args:
        design: Selected readings.
        cases: Admissible load cases.
        t: Information of the load cases on backlash.
        problem: Design problem: candidate readings and models.

    Returns:
        The design with exchanged loads.
    """
    blocks = [tuple(b) for b in design.blocks]
    at_pose = {int(p): np.flatnonzero(cases.pose == p).tolist() for p in np.unique(cases.pose[design.readings])}
    known: dict[tuple[int, ...], Array] = {}

    def compute_information(chosen: Sequence[tuple[int, ...]]) -> float:
        """log det of what the plan is made for."""
        for b in chosen:
            if b not in known:
                known[b] = compute_information_matrix(problem, [b])
        M = np.sum([known[b] for b in chosen], axis=0)
        return float(np.linalg.slogdet(M + RIDGE * np.eye(len(M)))[1])

    unknowns = problem.models[0].response.shape[2]
    least = compute_information(blocks) + unknowns * float(np.log1p(-MAX_EFFICIENCY_LOSS))
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
                if now > value and compute_information(changed) >= least:
                    blocks, value = changed, now
        if value <= before:
            break
    return replace(design, blocks=tuple(blocks), value=compute_design_criterion(problem, blocks))


def compare_joint_loads(
    job: ProcessLoads, design: ReadingDesign, t: TorqueReversalCases, steps: Sequence[float]
) -> tuple[JointLoadComparison, ...]:
    """Compare the joint torques of load tests and job.

    Args:
        job: Process loads of the job for which the stiffness is needed.
        design: Selected readings.
        t: Information of the load cases on backlash.
        steps: Shares of the full load at which a load cycle is read.

    Returns:
        One entry per joint.
    """
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
    """Describe differences between load tests and job.

    Args:
        job: Process loads of the job for which the stiffness is needed.
        joints: Comparison of each joint.
        largest: Largest planned load, N.

    Returns:
        Notes.
    """
    out = []
    if job.force[1] > largest * (1.0 + 1e-9):
        out.append(
            f"the job's force of {job.force[1]:.4g} N is more than any load planned ({largest:.4g} N): the "
            f"statement about it exceeds the measurement; --pull-N {job.force[1]:.0f} would measure it"
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
    """Return −1, 0 or 1: the flank of its backlash on which a joint rests."""
    turned: Bools = np.asarray(np.abs(torque) > dead)
    return np.asarray(np.where(turned, np.sign(torque), 0.0))

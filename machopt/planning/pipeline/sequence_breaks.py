"""Breaks of the sequence of configurations inside a run, with their causes and remedies.

A break into station s is examined from every configuration reached at the previous station. Each
of its continuations (the same branch where branches are kept, a rotation within the window, joints within
:func:`machopt.planning.sequence_search.search_kernels.compute_joint_jump_limit`) has its own reason why it is
infeasible. The reported reason is the most frequent one, with the joint or the bodies nearest to permitting it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.collision_free_search import CollisionFreeSequence
from machopt.planning.pipeline.planning_setup import PlanningSetup, ScoredAssignment
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.search_kernels import compute_joint_jump_limit
from machopt.planning.stations.planning_path import PlanningPath

FLIP = np.radians(120.0)  # larger joint steps between two points never come from a rotation about the tool axis
Code = Literal[
    "joint_jump",
    "joint_limit",
    "singularity",
    "stability",
    "collision",
    "no_pose",
    "rotation",
    "configuration",
    "home_collides",
    "rapid_collides",
    "rapid_blocked",
    "rapid_search_cut_short",
    "no_room",
    "not_driven",
]
NO_WAY_FOUND = ("rapid_blocked", "rapid_search_cut_short")  # unsuccessful search, which proves nothing

HOME, CHANGE = "home", "the tool change"  # where a motion begins or ends


@dataclass(frozen=True, kw_only=True)
class SequenceBreak:
    """Two successive places without a motion between them."""

    before: float  # toolpath index the motion comes from, NaN for home
    after: float  # toolpath index it should go to, NaN for home
    code: Code
    text: str
    help: str
    joint: int = 0  # 1…6, 0 where it is no joint
    value: float = float("nan")  # deg
    limit: float = float("nan")  # deg
    pair: str = ""  # the bodies, "a ~ b"
    begin: str = HOME  # where the motion begins and ends, if that is not at home
    end: str = HOME

    @property
    def ends(self) -> tuple[str, str]:
        """Descriptions of both places."""
        return describe_place(self.before, self.begin), describe_place(self.after, self.end)

    @property
    def where(self) -> str:
        """Description of the move."""
        begin, end = self.ends
        return f"at {begin}" if begin == end else f"from {begin} to {end}"


def _get_help(code: Code) -> str:
    return f"{_HELP[code]} would help; --allow-gaps leaves the cut out"


def describe_place(index: float, elsewhere: str = HOME) -> str:
    """Return the description of a place along the toolpath.

    Args:
        index: fractional toolpath index, NaN where the place has none.
        elsewhere: description of a place without an index.
    """
    return elsewhere if not np.isfinite(index) else f"point {index:g}"


_HELP: dict[str, str] = {
    "joint_jump": "a retract or rapid move between them, a finer rotation_step_deg, a wider rotation_range_deg, "
    "smaller singularity margins or another pose of the part",
    "joint_limit": "a wider range of that joint, a wider rotation_range_deg, a retract or rapid move before it (the "
    "arm may unwind there) or another pose of part or tool",
    "singularity": "a smaller singularity margin, another pose of part or tool, or a retract between them",
    "stability": "a smaller min_stability_ratio, another spindle speed or depth of cut, or a retract between them",
    "collision": "a finer rotation_step_deg, a wider rotation_range_deg, a smaller clearance_mm, another pose of part "
    "or tool, or moving what is in the way",
    "no_pose": "a finer rotation_step_deg, or more points between them",
    "rotation": "a wider rotation_range_deg, other fixed rotations, or a retract between them",
    "configuration": "a retract or rapid move between them, where the arm may turn over",
}


def build_undriven_break(before: float, after: float, why: str) -> SequenceBreak:
    """Return the break of a stretch that cannot be retimed.

    Args:
        before: fractional toolpath index before it.
        after: fractional toolpath index after it.
        why: message with the cause.
    """
    return SequenceBreak(
        before=before,
        after=after,
        code="not_driven",
        text=why,
        help="more points there, a finer rotation_step_deg or larger singularity margins would help",
    )


def find_sequence_breaks(
    path: PlanningPath, setup: PlanningSetup, candidates: CandidateGrid, sequence: CollisionFreeSequence
) -> tuple[SequenceBreak, ...]:
    """Return every break of the search's choice.

    Args:
        path: planning points.
        setup: planning setup of the cell.
        candidates: candidate grid with its exclusions.
        sequence: result of the search.
    """
    return tuple(_build_break(path, setup, candidates, sequence, s) for s in sequence.choice.broken)


def find_configuration_jumps(path: PlanningPath, scored: ScoredAssignment) -> tuple[SequenceBreak, ...]:
    """Return the breaks of a baseline: changes of configuration between two points of a run.

    Args:
        path: planning points.
        scored: the baseline.
    """
    a, out = scored.assignment, []
    ok = a.reason == InfeasibilityReason.OK
    for p in np.flatnonzero(ok[1:] & ok[:-1] & (path.run[1:] == path.run[:-1])) + 1:
        step = np.abs(a.q[p] - a.q[p - 1])
        if step.max() > FLIP:
            out.append(_build_jump(path.index[p - 1], path.index[p], int(step.argmax()), float(step.max()), FLIP))
    return tuple(out)


def _build_jump(before: float, after: float, joint: int, value: float, limit: float) -> SequenceBreak:
    value, limit = float(np.degrees(value)), float(np.degrees(limit))
    text = f"joint {joint + 1} would have to jump by {value:.1f}° (at most {limit:g}° is continuous)"
    return SequenceBreak(
        before=float(before),
        after=float(after),
        code="joint_jump",
        text=text,
        help=_get_help("joint_jump"),
        joint=joint + 1,
        value=value,
        limit=limit,
    )


@dataclass
class _Tally:
    """Number of continuations by reason, and the nearest one of each kind."""

    why: Counter[str]
    pair: Counter[int]
    over: tuple[float, int, float, float] = (np.inf, 0, np.nan, np.nan)  # rad beyond; joint, value, limit in rad
    jump: tuple[float, int] = (np.inf, 0)  # rad, joint


def _build_break(
    path: PlanningPath, setup: PlanningSetup, c: CandidateGrid, sequence: CollisionFreeSequence, s: int
) -> SequenceBreak:
    st, choice = path.stations, sequence.choice
    before, after = float(path.index[st[s - 1]]), float(path.index[st[s]])
    tally, largest = _count_continuations(setup, c, sequence, s), compute_joint_jump_limit(c.stable)

    def made(
        code: Code, text: str, joint: int = 0, value: float = np.nan, limit: float = np.nan, pair: str = ""
    ) -> SequenceBreak:
        return SequenceBreak(
            before=before,
            after=after,
            code=code,
            text=text,
            help=_get_help(code),
            joint=joint,
            value=value,
            limit=limit,
            pair=pair,
        )

    if tally.why:
        most = max(tally.why, key=lambda k: (tally.why[k], k))
        counts = ", ".join(f"{n} {_SENTENCE[k]}" for k, n in tally.why.most_common())
        of = f"of {sum(tally.why.values())} continuous ways {counts}"
        if most == "limit":
            _, joint, value, limit = tally.over
            v, x = float(np.degrees(value)), float(np.degrees(limit))
            text = f"joint {joint + 1} would have to go to {v:.1f}°, its limit with the margin is {x:.1f}° ({of})"
            return made("joint_limit", text, joint + 1, v, x)
        if most == "singular":
            return made("singularity", f"the arm would come too near a singularity ({of})")
        if most == "unstable":
            return made("stability", f"the stable depth of cut would fall below min_stability_ratio ({of})")
        pair = _name(setup, tally.pair.most_common(1)[0][0] if tally.pair else sequence.banned.get(s, -1))
        if pair:
            return made("collision", f"{pair} touch or come nearer than the clearance on the way ({of})", pair=pair)
        return made("no_pose", f"between the two no pose of the same configuration is within limits and margins ({of})")
    if np.isfinite(tally.jump[0]):
        return _build_jump(before, after, tally.jump[1], tally.jump[0], largest)
    reached, there = _list_rotations(choice.reached, c, s)
    gap = np.abs(wrap_angle(reached[:, None] - there[None, :]))
    if gap.size and path.plunge[st[s]] and gap.min() > 1e-6:
        v = float(np.degrees(gap.min()))
        return made(
            "rotation",
            f"the rotation is kept along a plunge, and none works at both ends (the nearest are {v:.1f}° apart)",
            value=v,
            limit=0.0,
        )
    if gap.size and gap.min() > largest:
        v = float(np.degrees(gap.min()))
        return made(
            "rotation", f"the rotations that work are {v:.0f}° apart", value=v, limit=float(np.degrees(largest))
        )
    return made("configuration", "what works here is another configuration of the arm than what works before")


_SENTENCE = {
    "limit": "break a joint limit",
    "singular": "come too near a singularity",
    "unstable": "lie below min_stability_ratio",
    "collision": "collide",
    "way": "collide or have no pose on the way",
}


def _count_continuations(setup: PlanningSetup, c: CandidateGrid, sequence: CollisionFreeSequence, s: int) -> _Tally:
    """Count every continuation from the configurations reached at station s − 1 into station s."""
    arm = setup.arm
    _, R, B, T = c.feasible.shape
    reached = sequence.choice.reached
    alive = np.zeros((R, B, T), bool) if reached is None else reached[s - 1].reshape(R, B, T)
    window = max(int(compute_joint_jump_limit(c.stable) / (2 * np.pi / R)), 1)
    tally = _Tally(Counter(), Counter())
    for bu in range(B):
        if not alive[:, bu].any():
            continue
        for b in (bu,) if c.stable else range(B):
            for dr in range(-window, window + 1):
                target = (np.arange(R) + dr) % R
                qa, step = c.q[s - 1, :, bu], wrap_angle(c.q[s, target, b] - c.q[s - 1, :, bu])
                size = np.abs(step).max(axis=1)
                for r in np.flatnonzero(alive[:, bu].any(axis=1) & np.isfinite(size)):
                    why = InfeasibilityReason(int(c.reason[s, target[r], b]))
                    if why in (InfeasibilityReason.BOUNDS, InfeasibilityReason.UNREACHABLE):
                        continue
                    if size[r] > compute_joint_jump_limit(c.stable):
                        if why == InfeasibilityReason.OK and size[r] < tally.jump[0]:
                            tally.jump = (float(size[r]), int(np.abs(step[r]).argmax()))
                        continue
                    _count_continuation(
                        tally,
                        arm.lower,
                        arm.upper,
                        qa[r] + step[r] + c.turns[alive[r, bu]],
                        why,
                        int(sequence.pairs[s, target[r], b]),
                    )
    return tally


def _count_continuation(
    tally: _Tally, lower: Array, upper: Array, q: Array, why: InfeasibilityReason, pair: int
) -> None:
    over = np.maximum(lower - q, q - upper)
    if why in (
        InfeasibilityReason.SINGULAR_WRIST,
        InfeasibilityReason.SINGULAR_ELBOW,
        InfeasibilityReason.SINGULAR_SHOULDER,
    ):
        tally.why["singular"] += 1
    elif (over > 0).any(axis=1).all():
        tally.why["limit"] += 1
        n = int(over.max(axis=1).argmin())
        j = int(over[n].argmax())
        if over[n, j] < tally.over[0]:
            tally.over = (float(over[n, j]), j, float(q[n, j]), float(lower[j] if q[n, j] < lower[j] else upper[j]))
    elif why == InfeasibilityReason.UNSTABLE:
        tally.why["unstable"] += 1
    elif why == InfeasibilityReason.COLLIDING:
        tally.why["collision"] += 1
        tally.pair[pair] += 1
    else:
        tally.why["way"] += 1


def _list_rotations(reached: NDArray[np.bool_] | None, c: CandidateGrid, s: int) -> tuple[Array, Array]:
    R = len(c.phi)
    grid = c.phi_at()
    here = np.zeros(R, bool) if reached is None else reached[s - 1].reshape(R, -1).any(axis=1)
    return grid[s - 1, here], grid[s, c.feasible[s].reshape(R, -1).any(axis=1)]


def _name(setup: PlanningSetup, k: int) -> str:
    return setup.collision.pairs[k].name if setup.collision is not None and k >= 0 else ""

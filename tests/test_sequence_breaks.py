"""Reasons of sequence breaks, constructed by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.planning.pipeline.sequence_breaks import SequenceBreak, find_sequence_breaks
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice

ROTATIONS, BRANCHES = 8, 2
LIMIT = np.radians(50.0)  # of every joint
AHEAD = (0, 1, 7)  # rotations that a small rotation step from rotation 0 reaches


def build_break(
    reasons: dict[int, InfeasibilityReason],
    joints: dict[int, tuple[int, float]] | None = None,
    pairs: dict[int, int] | None = None,
    **changes: Any,
) -> SequenceBreak:
    """Return the one break of three stations; the last is not reached, rotation 0 of branch 0 is feasible before it.

    Args:
        reasons: of branch 0 at the last station, by rotation; the others are outside the requested range.
        joints: at the last station, by rotation: index and angle in degrees of the joint that is not at zero.
        pairs: colliding bodies for which a vertex was removed, by rotation.
        changes: ``banned``, ``plunge``, ``other`` (rotation at which branch 1 is feasible).
    """
    q = np.zeros((3, ROTATIONS, BRANCHES, 6))
    q[:, :, 1, 0] = np.radians(170.0)  # another branch
    reason = np.full((3, ROTATIONS, BRANCHES), InfeasibilityReason.BOUNDS, np.uint8)
    struck = np.full(reason.shape, -1, np.int32)
    reason[:2, 0, 0] = InfeasibilityReason.OK
    for r, why in reasons.items():
        reason[2, r, 0] = why
    for r, (joint, degrees) in (joints or {}).items():
        q[2, r, 0, joint] = np.radians(degrees)
    for r, pair in (pairs or {}).items():
        struck[2, r, 0] = pair
    feasible = (reason == InfeasibilityReason.OK)[..., None]
    if "other" in changes:
        reason[2, changes["other"], 1], feasible[2, changes["other"], 1] = InfeasibilityReason.OK, True
    phi = np.arange(ROTATIONS) * 2 * np.pi / ROTATIONS - np.pi
    candidates = CandidateGrid(
        branch=np.arange(BRANCHES),
        phi=phi,
        q=q,
        turns=np.zeros((1, 6)),
        reason=reason,
        feasible=feasible,
        stable=True,
        shortfall=np.zeros(3),
    )
    reached = np.zeros((3, ROTATIONS * BRANCHES), bool)
    reached[1, 0] = True
    nothing = np.zeros(3, int)
    choice = SequenceChoice(
        rotation=nothing, branch=nothing, turn=nothing, q=np.zeros((3, 6)), broken=(2,), reached=reached
    )
    plunge = np.array([False, False, changes.get("plunge", False)])
    path: Any = SimpleNamespace(stations=np.arange(3), index=np.array([0.0, 1.0, 2.0]), plunge=plunge)
    bodies = SimpleNamespace(pairs=[SimpleNamespace(name="link_4 ~ post"), SimpleNamespace(name="tool ~ table")])
    setup: Any = SimpleNamespace(arm=SimpleNamespace(lower=np.full(6, -LIMIT), upper=np.full(6, LIMIT)))
    setup.collision = bodies
    found: Any = SimpleNamespace(choice=choice, pairs=struck, banned=changes.get("banned", {}))
    (one,) = find_sequence_breaks(path, setup, candidates, found)
    assert (one.before, one.after) == (1.0, 2.0)
    assert one.help.endswith("would help; --allow-gaps leaves the cut out")
    return one


def test_joint_limit_of_the_nearest_continuation_is_named() -> None:
    one = build_break(dict.fromkeys(AHEAD, InfeasibilityReason.LIMIT), {0: (3, 54.0), 1: (3, 52.5), 7: (4, -58.0)})
    assert (one.code, one.joint) == ("joint_limit", 4)
    assert (one.value, one.limit) == pytest.approx((52.5, 50.0))
    assert one.text == (
        "joint 4 would have to go to 52.5°, its limit with the margin is 50.0° "
        "(of 3 continuous ways 3 break a joint limit)"
    )
    below = build_break({7: InfeasibilityReason.LIMIT}, {7: (4, -58.0)})
    assert (below.joint, below.value, below.limit) == (5, pytest.approx(-58.0), pytest.approx(-50.0))


def test_most_frequent_reason_is_reported() -> None:
    one = build_break(
        {
            0: InfeasibilityReason.SINGULAR_WRIST,
            1: InfeasibilityReason.SINGULAR_ELBOW,
            7: InfeasibilityReason.COLLIDING,
        },
        pairs={7: 0},
    )
    assert one.code == "singularity"
    assert "of 3 continuous ways 2 come too near a singularity, 1 collide" in one.text
    assert "a smaller singularity margin" in one.help


def test_most_frequent_contact_pair_is_named() -> None:
    one = build_break(dict.fromkeys(AHEAD, InfeasibilityReason.COLLIDING), pairs={0: 1, 1: 0, 7: 1})
    assert (one.code, one.pair) == ("collision", "tool ~ table")
    assert one.text.startswith("tool ~ table touch or come nearer than the clearance on the way (of 3 ")


def test_blocked_motion_between_free_poses_names_the_obstacle() -> None:
    barred = build_break({0: InfeasibilityReason.OK}, banned={2: 0})
    assert (barred.code, barred.pair) == ("collision", "link_4 ~ post")
    poseless = build_break({0: InfeasibilityReason.OK}, banned={2: -1})
    assert (poseless.code, poseless.pair) == ("no_pose", "")
    assert "no pose of the same configuration is within limits and margins" in poseless.text
    assert "more points between them" in poseless.help


def test_smallest_joint_jump_is_reported() -> None:
    one = build_break({0: InfeasibilityReason.OK, 1: InfeasibilityReason.OK}, {0: (1, 160.0), 1: (2, -150.0)})
    assert (one.code, one.joint) == ("joint_jump", 3)
    assert one.value == pytest.approx(150.0)
    assert one.text.startswith("joint 3 would have to jump by 150.0° (at most ")


def test_plunge_keeps_its_rotation() -> None:
    one = build_break({}, other=1, plunge=True)
    assert (one.code, one.limit) == ("rotation", 0.0)
    assert one.value == pytest.approx(45.0)
    assert "the rotation is kept along a plunge, and none works at both ends (the nearest are 45.0° apart)" in one.text


def test_too_large_rotation_steps_are_reported() -> None:
    one = build_break({}, other=4)
    assert (one.code, one.value) == ("rotation", pytest.approx(180.0))
    assert one.limit < 180.0
    assert one.text == "the rotations that work are 180° apart"


def test_flipped_configuration_suggests_a_retract() -> None:
    one = build_break({}, other=0)
    assert one.code == "configuration"
    assert "where the arm may turn over" in one.help

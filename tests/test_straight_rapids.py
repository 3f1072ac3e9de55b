"""Straight rapid moves checked together, compared with single checks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from small_cell import small_cell

from machopt.collision.collision_model import CollisionModel
from machopt.kinematics.urdf_loading import load_chain
from machopt.planning.motion.straight_rapid_collisions import EndContacts, build_rapid_key, find_free_rapids

STEP = 0.02  # rad


def test_moves_checked_together_equal_those_checked_alone(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, 0.002)
    rng = np.random.default_rng(4)
    spread = np.array([0.6, 0.7, 0.7, 1.0, 1.0, 1.0])
    ends = [(cell.home + spread * a, cell.home + spread * b) for a, b in rng.uniform(-1.0, 1.0, (40, 2, 6))]
    free = find_free_rapids(model, ends, STEP)
    none = np.zeros(2, bool)
    alone = [
        not (model.check_configurations(np.array(e), none).any or model.check_motion(np.array(e), none, STEP).any)
        for e in ends
    ]
    assert [build_rapid_key(*e) in free for e in ends] == alone
    assert 5 < sum(alone) < 35
    assert find_free_rapids(model, [], STEP) == frozenset()
    q = np.array([a for a, _ in ends])
    touch = EndContacts.build(model, q, range(0, 40, 2))
    rapid, cut = (model.check_configurations(q[::2], np.full(20, kind)).hit for kind in (False, True))
    assert touch.checked_rows == {*range(0, 40, 2)}
    assert touch.rapid == {*(2 * np.flatnonzero(rapid)).tolist()}
    assert touch.cut == {*(2 * np.flatnonzero(rapid & cut)).tolist()}
    assert touch.rapid

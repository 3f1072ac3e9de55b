"""A cell by itself as a picture: every body that is looked at for collisions, the arm at home."""

from __future__ import annotations

import numpy as np

from machopt.domain.cell import Cell
from machopt.model.correction import correction_of
from machopt.model.robot import load_chain
from machopt.report.gather.scene import bodies_of, scene_of
from machopt.report.scene import Postures, Scene


def cell_scene(cell: Cell) -> tuple[Scene, Postures]:
    """The scene, and home.

    Raises:
        InputError: the arm's bodies cannot be read.
    """
    robot, shapes = load_chain(cell)
    correction = correction_of(cell.kinematics)
    arm = cell.home if correction is None else correction.true_angles(cell.home)
    home = np.r_[arm, cell.external_home][None]
    return scene_of(cell, robot, bodies_of(cell, robot, shapes)), Postures(q=home, label="Posture", names=("home",))

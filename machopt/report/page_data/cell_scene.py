"""3-D scene of a cell: every body that is checked for collisions, the arm at home."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.kinematics.encoder_corrections import build_encoder_correction
from machopt.kinematics.urdf_loading import load_chain
from machopt.report.page_data.machine_scene import build_bodies, build_machine_scene
from machopt.report.scene.scene_types import CellScene, ScenePostures


def build_cell_scene(cell: Cell) -> tuple[CellScene, ScenePostures]:
    """Return the scene and the home posture.

    Args:
        cell: The robot cell.

    Raises:
        InputError: the arm's bodies cannot be read.
    """
    robot, shapes = load_chain(cell)
    correction = build_encoder_correction(cell.kinematics)
    arm = cell.home if correction is None else correction.compute_true_angles(cell.home)
    home = np.r_[arm, cell.external_home][None]
    return build_machine_scene(cell, robot, build_bodies(cell, robot, shapes)), ScenePostures(
        q=home, label="Posture", names=("home",)
    )

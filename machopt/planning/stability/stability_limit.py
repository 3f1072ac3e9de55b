"""Least permitted stability of configurations: ``min_stability_ratio``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions, ProcessForce
from machopt.data_types.toolpath import Toolpath
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array, Bools
from machopt.planning.cost.stiffness_index import compute_load_directions
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stability.depth_ratio import StabilityModel
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.stiffness.arm_stiffness import ArmElasticity


@dataclass
class StabilityLimit:
    """Limit of the depth of cut over the planned depth, which no configuration may fall below."""

    model: StabilityModel  # of any path of the toolpath
    elasticity: ArmElasticity
    force: ProcessForce
    ratio: float
    _last: tuple[PlanningArm, PlanningPath, StabilityModel] | None = field(default=None, repr=False)

    @classmethod
    def build(
        cls, cell: Cell, toolpath: Toolpath, arm: PlanningArm, robot: Robot, elasticity: ArmElasticity, o: PlanOptions
    ) -> StabilityLimit | None:
        """Return the limit; None where the options state none, or the stability of no point can be computed.

        Args:
            cell: The cell with the tool and the process.
            toolpath: Toolpath of one tool.
            arm: Arm model.
            robot: Kinematic model.
            elasticity: Compliance model of the arm.
            o: Planning options.
        """
        if o.min_stability_ratio is None:
            return None
        path = build_planning_path(toolpath, ())
        at_home = np.broadcast_to(np.asarray(cell.external_home, float), (len(path.index), len(cell.external_joints)))
        path = replace(path, external=np.array(at_home))
        directions = compute_load_directions(path, arm, elasticity, o.force)
        model = StabilityModel.build(cell, toolpath, path, arm, robot, directions)
        return None if model is None else cls(model, elasticity, o.force, o.min_stability_ratio)

    def compute_ratios(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Array:
        """Return (M,) the limit of the depth of cut over the planned depth; inf where nothing limits it.

        Args:
            arm: Arm model.
            path: Planning points of the same toolpath.
            points: (M,) planning points.
            q: (M, 6) rad.
        """
        last = self._last
        if last is None or last[0].machine is not arm.machine or last[1] is not path:
            directions = compute_load_directions(path, arm, self.elasticity, self.force)
            last = arm, path, replace(self.model, arm=arm).with_path(path, directions)
            self._last = last
        return last[2].compute_ratios(points, q)

    def find_violations(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Bools:
        """Return (M,) configurations below the least ratio.

        Args:
            arm: Arm model.
            path: Planning points of the same toolpath.
            points: (M,) planning points.
            q: (M, 6) rad.
        """
        return np.asarray(self.compute_ratios(arm, path, points, q) < self.ratio)

"""Kinematics of the cell for the planning steps, and the interface of a further limit on its configurations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.kinematics.inverse.solver import (
    InverseKinematicsSolver,
    SingularityMargins,
    choose_angle_origin,
    list_whole_turns,
)
from machopt.kinematics.machine import Machine
from machopt.numerics.array_types import Array, Bools
from machopt.planning.stations.planning_path import PlanningPath


class ConfigurationLimit(Protocol):
    """Limit that the process sets to the stability of the cut."""

    ratio: float  # least permitted limit of the depth of cut over the planned depth

    def compute_ratios(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Array:
        """Return (M,) the limit of the depth of cut over the planned depth; inf where nothing limits it.

        Args:
            arm: arm model.
            path: planning points.
            points: (M,) planning points.
            q: (M, 6) rad.
        """

    def find_violations(self, arm: PlanningArm, path: PlanningPath, points: NDArray[np.intp], q: Array) -> Bools:
        """Return (M,) configurations that violate the limit.

        Args:
            arm: arm model.
            path: planning points.
            points: (M,) planning points.
            q: (M, 6) rad.
        """


@dataclass(frozen=True, kw_only=True)
class PlanningArm:
    """Kinematics of the cell for the planning steps."""

    solver: InverseKinematicsSolver
    machine: Machine  # pose of the workpiece in base_link, by the external joints
    T_flange_tcp: Array  # (4, 4)
    lower: Array  # (6,) rad, reduced by the limit margin
    upper: Array  # (6,)
    turns: Array  # (K, 6) rad, whole turns that can bring joints in (−π, π] inside the limits
    origin: Array  # (6,) rad, candidates' joints are counted from it: in [origin, origin + 2π)
    windings: Array  # (T, 6) rad, whole turns that can bring these joints inside the limits
    margins: SingularityMargins
    stability: ConfigurationLimit | None = None  # min_stability_ratio; None: no limit

    @classmethod
    def build(cls, cell: Cell, solver: InverseKinematicsSolver, machine: Machine, options: PlanOptions) -> PlanningArm:
        """Return the arm model of a cell with the margins of the options.

        Args:
            cell: robot cell with true angles.
            solver: inverse kinematics.
            machine: kinematics of the external joints.
            options: plan options with margins.
        """
        lower = cell.limits.lower[:6] + options.limit_margin
        upper = cell.limits.upper[:6] - options.limit_margin
        origin, windings = choose_angle_origin(lower, upper)
        return cls(
            solver=solver,
            origin=origin,
            windings=windings,
            machine=machine,
            T_flange_tcp=cell.tool.T_flange_tcp,
            lower=lower,
            upper=upper,
            turns=list_whole_turns(lower, upper),
            margins=SingularityMargins(
                options.singularity_wrist, options.singularity_elbow, options.singularity_shoulder, options.limit_margin
            ),
        )

    def in_base(self, external: Array, poses: Array) -> Array:
        """Return poses converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            poses: (n, …, 4, 4) in the workpiece frame.
        """
        T = self._stands(external)
        return np.asarray(T.reshape(*T.shape[:-2], *(1,) * (poses.ndim - T.ndim), 4, 4) @ poses)

    def directions(self, external: Array, v: Array) -> Array:
        """Return directions (n, 3) converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            v: (n, 3) in the workpiece frame.
        """
        return turn_directions(self._stands(external)[..., :3, :3], v)

    def back(self, external: Array, v: Array) -> Array:
        """Return directions (n, 3) converted from base_link to the workpiece frame.

        Args:
            external: (n, E) m or rad, external joints.
            v: (n, 3) in base_link.
        """
        return turn_directions(np.swapaxes(self._stands(external)[..., :3, :3], -1, -2), v)

    def places(self, external: Array, p: Array) -> Array:
        """Return points (n, 3) in m converted from the workpiece frame to base_link.

        Args:
            external: (n, E) m or rad, external joints.
            p: (n, 3) m in the workpiece frame.
        """
        T = self._stands(external)
        return np.asarray(turn_directions(T[..., :3, :3], p) + T[..., :3, 3])

    def compute_workpiece_frame(self, external: Array) -> tuple[Array, Array]:
        """Return rotation (n, 3, 3) and origin (n, 3) in m of the workpiece frame in base_link.

        Both are without n where no joint moves the frame.

        Args:
            external: (n, E) m or rad, external joints.
        """
        T = self._stands(external)
        return T[..., :3, :3], T[..., :3, 3]

    def _stands(self, external: Array) -> Array:
        """T_base_workpiece (n, 4, 4), or (4, 4) where no joint moves it."""
        return (
            self.machine.compute_T_base_workpiece(external)
            if self.machine.external_count
            else self.machine.T_base_workpiece_zero
        )


def turn_directions(R: Array, v: Array) -> Array:
    """Return directions (n, 3) turned by R (3, 3) or (n, 3, 3).

    Args:
        R: rotations.
        v: directions.
    """
    return np.asarray(v @ R.T if R.ndim == 2 else np.einsum("nij,nj->ni", R, v))

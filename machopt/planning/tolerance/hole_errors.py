"""Errors of holes and the probability that their tolerances hold.

Of one hole and one draw: the position is the distance of the tip from nominal across the axis at the entry pose; the
axis angle is the larger turn of the tool axis at entry and exit; the depth error is along the axis at the exit pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.process import CuttingProcess
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.draws import UncertaintyDraws, build_nominal_draw
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.targets import HoleTargets
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.tolerance.arm_accuracy import PositionScatter, compute_position_scatter, draw_position
from machopt.planning.tolerance.error_columns import TargetPoses, compute_twist_columns, locate_poses
from machopt.process.binding.point_loads import compute_mean_wear

ENTRY, EXIT = 0, 1


@dataclass(frozen=True, kw_only=True)
class HoleErrorModel:
    """Linear error model of H holes."""

    targets: HoleTargets
    poses: tuple[TargetPoses, TargetPoses]  # entry and exit
    axial: tuple[Array, Array]  # (H, 6, 1 + R) twist per N along the axis, at entry and exit
    turning: tuple[Array, Array]  # (H, 6, 1 + R) twist per N·m about the axis
    lateral: tuple[Array, Array]  # (H, 6, 1 + R) twist of the nominal load along travel and normal
    scatter: tuple[PositionScatter, PositionScatter]
    process: CuttingProcess
    spread: StiffnessSpread
    local: float  # m/N, compliance of a pose alone


@dataclass(frozen=True)
class HoleDraws:
    """Errors of one hole over D draws."""

    across: Array  # (D, 2) m, components at entry
    along: Array  # (D,) m, at exit
    axis: Array  # (D,) rad

    @property
    def distance(self) -> Array:
        """(D,) m across the axis."""
        return np.asarray(np.linalg.norm(self.across, axis=1))


def build_hole_model(
    plan: Plan, chosen: ScoredAssignment, process: CuttingProcess, targets: HoleTargets, spread: StiffnessSpread
) -> HoleErrorModel:
    """Return the error model of the holes of a plan.

    Args:
        plan: Plan of one tool.
        chosen: An assignment along its path: the choice or a baseline.
        process: Content of process.yaml.
        targets: The holes.
        spread: Random part of the stiffness.
    """
    poses = (locate_poses(plan, chosen, targets.entry), locate_poses(plan, chosen, targets.exit))
    reference = np.array([process.operations[k].tolerance.reference for k in targets.operation], dtype=object)
    axial, turning, lateral, scatter = [], [], [], []
    for pose in poses:
        zero = np.zeros_like(pose.axis)
        axial.append(compute_twist_columns(plan, spread, pose, np.hstack([pose.axis, zero])))
        turning.append(compute_twist_columns(plan, spread, pose, np.hstack([zero, pose.axis])))
        across = targets.force[:, :1] * pose.travel + targets.force[:, 1:] * pose.normal
        lateral.append(compute_twist_columns(plan, spread, pose, np.hstack([across, zero])))
        wrench = np.hstack([targets.thrust[:, None] * pose.axis + across, targets.torque[:, None] * pose.axis])
        scatter.append(compute_position_scatter(plan, pose, reference, wrench))
    discrepancy = plan.setup.elasticity.stiffness.discrepancy
    return HoleErrorModel(
        targets=targets,
        poses=poses,
        axial=(axial[ENTRY], axial[EXIT]),
        turning=(turning[ENTRY], turning[EXIT]),
        lateral=(lateral[ENTRY], lateral[EXIT]),
        scatter=(scatter[ENTRY], scatter[EXIT]),
        process=process,
        spread=spread,
        local=0.0 if discrepancy is None else discrepancy.local,
    )


def draw_hole_errors(model: HoleErrorModel, h: int, draws: UncertaintyDraws, *, position: bool) -> HoleDraws:
    """Return the errors of one hole.

    Args:
        model: The error model.
        h: Index of the hole.
        draws: The draws.
        position: Include position, lost motion and pose of the part; False: deflection alone.
    """
    return draw_hole_terms(model, h, draws, position=position).compute_errors()


@dataclass(frozen=True, kw_only=True)
class HoleTerms:
    """Drawn parts of the errors of one hole, so that its load can be changed; D draws."""

    model: HoleErrorModel
    hole: int
    noise: UncertaintyDraws | None  # None: deflection alone
    thrust: Array  # (D,) N, without the clamp
    torque: Array  # (D,) N·m
    axial: tuple[Array, Array]  # (D, 6) twist by a unit thrust, entry and exit
    turning: tuple[Array, Array]  # (D, 6) by a unit torque
    rest: tuple[Array, Array]  # (D, 6) that does not depend on thrust and torque

    def compute_errors(self, scale: float = 1.0) -> HoleDraws:
        """Return the errors for a multiple of thrust and torque.

        Args:
            scale: Factor on thrust and torque; the clamp stays.
        """
        thrust = np.maximum(scale * self.thrust, self.model.targets.clamp[self.hole])
        twists = [
            thrust[:, None] * self.axial[pose] + (scale * self.torque)[:, None] * self.turning[pose] + self.rest[pose]
            for pose in (ENTRY, EXIT)
        ]
        return _project(self.model, self.hole, twists, self.noise)


def draw_hole_terms(model: HoleErrorModel, h: int, draws: UncertaintyDraws, *, position: bool) -> HoleTerms:
    """Return the drawn parts of the errors of one hole.

    Args:
        model: The error model.
        h: Index of the hole.
        draws: The draws.
        position: Include position, lost motion and pose of the part; False: deflection alone.
    """
    process = model.process
    one = process.operations[model.targets.operation[h]]
    wear = compute_mean_wear(one)
    factor = draws.compute_load_factor(process, one)
    axial, turning, rest = [], [], []
    for pose in (ENTRY, EXIT):
        along = draws.stiffness @ model.axial[pose][h].T
        along[:, :3] += model.local * draws.local
        axial.append(along)
        turning.append(draws.stiffness @ model.turning[pose][h].T)
        still = (factor / wear)[:, None] * (draws.stiffness @ model.lateral[pose][h].T)
        still[:, :3] += model.poses[pose].offset[h]
        if position:
            still += draw_position(model.scatter[pose], h, draws)
            still[:, :3] += np.nan_to_num(model.scatter[pose].std[h]) * draws.position
        rest.append(still)
    return HoleTerms(
        model=model,
        hole=h,
        noise=draws if position else None,
        thrust=model.targets.thrust[h] / wear * factor,
        torque=model.targets.torque[h] / wear * draws.compute_load_factor(process, one, torque=True),
        axial=(axial[ENTRY], axial[EXIT]),
        turning=(turning[ENTRY], turning[EXIT]),
        rest=(rest[ENTRY], rest[EXIT]),
    )


def compute_nominal_hole_errors(model: HoleErrorModel, h: int) -> HoleDraws:
    """Return the errors of one hole at nominal values.

    Args:
        model: The error model.
        h: Index of the hole.
    """
    return draw_hole_errors(model, h, build_nominal_draw(model.spread), position=False)


def compute_hole_probability(model: HoleErrorModel, h: int, errors: HoleDraws) -> float:
    """Return the share of draws in which all tolerances of a hole hold.

    Args:
        model: The error model.
        h: Index of the hole.
        errors: Its errors over the draws.
    """
    limits = model.process.operations[model.targets.operation[h]].tolerance
    good = errors.distance <= limits.position
    good &= (errors.axis <= limits.axis) & (np.abs(errors.along) <= limits.depth)
    return float(np.mean(good))


def _project(model: HoleErrorModel, h: int, twists: list[Array], noise: UncertaintyDraws | None) -> HoleDraws:
    """Return the errors from the twists (D, 6) at entry and exit."""
    sideways = [build_sideways(model.poses[pose].axis[h]) for pose in (ENTRY, EXIT)]
    tilt_noise = 0.0 if noise is None else model.scatter[ENTRY].tilt_std[h] * noise.tilt
    tilts = [np.linalg.norm(t[:, 3:] @ s.T + tilt_noise, axis=1) for t, s in zip(twists, sideways, strict=True)]
    return HoleDraws(
        across=twists[ENTRY][:, :3] @ sideways[ENTRY].T,
        along=twists[EXIT][:, :3] @ model.poses[EXIT].axis[h],
        axis=np.maximum(*tilts),
    )


def build_sideways(axis: Array) -> Array:
    """Return two unit vectors across an axis, (2, 3).

    Args:
        axis: (3,) unit.
    """
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])

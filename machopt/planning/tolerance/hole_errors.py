"""Errors of holes and the probability that their tolerances hold.

Of one hole and one draw: the position is the distance of the tip from nominal across the axis at the entry pose; the
axis angle is the larger turn of the tool axis at entry and exit; the depth error is along the axis at the exit pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.process import CuttingProcess
from machopt.numerics.array_types import Array
from machopt.numerics.tall_products import multiply_tall
from machopt.planning.error_probability.random_draws import UncertaintyDraws, build_nominal_draw
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.toleranced_points import HoleTargets
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.tolerance.arm_accuracy import (
    PositionScatter,
    compute_position_scatter,
    draw_position,
    has_position_draws,
)
from machopt.planning.tolerance.draws_in_tolerance import count_good_draws
from machopt.planning.tolerance.error_sensitivities import TargetPoses, compute_twist_columns, locate_poses
from machopt.process.binding.point_loads import compute_mean_wear

ENTRY, EXIT = 0, 1
ACROSS, TILT_ENTRY, ALONG, TILT_EXIT = slice(0, 2), slice(2, 4), 4, slice(5, 7)  # of the components


@dataclass(frozen=True, kw_only=True)
class HoleErrorModel:
    """Linear error model of H holes."""

    targets: HoleTargets
    poses: tuple[TargetPoses, TargetPoses]  # entry and exit
    rows: tuple[Array, Array]  # (H, 4, 6) and (H, 3, 6) what of a twist at entry and exit the errors need
    axial: Array  # (H, 7, 1 + R) these components per N along the axis
    turning: Array  # (H, 7, 1 + R) per N·m about the axis
    lateral: Array  # (H, 7, 1 + R) of the nominal load along travel and normal
    nominal: tuple[Array, Array, Array]  # (H, 3) displacement at entry: per N, per N·m, of the load across
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
        return np.asarray(np.hypot(self.across[:, 0], self.across[:, 1]))


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
    rows = _list_component_rows(poses)
    discrepancy = plan.setup.elasticity.stiffness.discrepancy
    return HoleErrorModel(
        targets=targets,
        poses=poses,
        rows=rows,
        axial=_project(rows, axial),
        turning=_project(rows, turning),
        lateral=_project(rows, lateral),
        nominal=(axial[ENTRY][:, :3, 0], turning[ENTRY][:, :3, 0], lateral[ENTRY][:, :3, 0]),
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
    thrust: Array  # (D,) N, without the clamp
    torque: Array  # (D,) N·m
    parts: (
        Array  # (D, 21) components in the order of _list_component_rows: 7 by a unit thrust, 7 by a unit torque, rest
    )
    tilt: Array  # (D, 2) rad, turns of the arm that no load causes; zeros where they do not count

    def take_first(self, count: int) -> HoleTerms:
        """Return the parts of the first draws.

        Args:
            count: Number of draws.
        """
        some = {name: getattr(self, name)[:count] for name in ("thrust", "torque", "parts", "tilt")}
        return replace(self, **some)

    def compute_errors(self, scale: float = 1.0) -> HoleDraws:
        """Return the errors for a multiple of thrust and torque.

        Args:
            scale: Factor on thrust and torque; the clamp stays.
        """
        thrust = np.maximum(scale * self.thrust, self.model.targets.clamp[self.hole])
        y = thrust[:, None] * self.parts[:, :7] + (scale * self.torque)[:, None] * self.parts[:, 7:14]
        y += self.parts[:, 14:]
        at_entry, at_exit = y[:, TILT_ENTRY] + self.tilt, y[:, TILT_EXIT] + self.tilt
        tilt = np.maximum(np.hypot(at_entry[:, 0], at_entry[:, 1]), np.hypot(at_exit[:, 0], at_exit[:, 1]))
        return HoleDraws(across=y[:, ACROSS], along=y[:, ALONG], axis=tilt)

    def compute_probability(self, scale: float = 1.0, turn: float | None = None) -> float:
        """Return the share of draws in which all tolerances hold, for a multiple of thrust and torque.

        Args:
            scale: Factor on the thrust; the clamp stays.
            turn: Factor on the torque; None: that of the thrust.
        """
        turn = scale if turn is None else turn
        limits = self.model.process.operations[self.model.targets.operation[self.hole]].tolerance
        clamp, sizes = float(self.model.targets.clamp[self.hole]), (limits.position, limits.axis, limits.depth)
        good = count_good_draws(scale * self.thrust, turn * self.torque, self.parts, self.tilt, clamp, sizes)
        return float(good / len(self.thrust))


@dataclass(frozen=True)
class LoadFactors:
    """Factors of thrust and torque of one operation relative to an unworn tool, (D,) each."""

    thrust: Array
    torque: Array

    @classmethod
    def build(cls, process: CuttingProcess, operation: int, draws: UncertaintyDraws) -> LoadFactors:
        """Return the factors, which all holes of an operation share.

        Args:
            process: Content of process.yaml.
            operation: Operation of the process.
            draws: The draws.
        """
        one = process.operations[operation]
        thrust, torque = (draws.compute_load_factor(process, one, torque=flag) for flag in (False, True))
        return cls(thrust, torque)


def draw_hole_terms(
    model: HoleErrorModel, h: int, draws: UncertaintyDraws, *, position: bool, factors: LoadFactors | None = None
) -> HoleTerms:
    """Return the drawn parts of the errors of one hole.

    Args:
        model: The error model.
        h: Index of the hole.
        draws: The draws.
        position: Include position, lost motion and pose of the part; False: deflection alone.
        factors: Factors of its load, where they are known.
    """
    operation = int(model.targets.operation[h])
    wear = compute_mean_wear(model.process.operations[operation])
    if factors is None:
        factors = LoadFactors.build(model.process, operation, draws)
    rows = model.rows[ENTRY][h], model.rows[EXIT][h]
    columns = np.concatenate([model.axial[h], model.turning[h], model.lateral[h]])
    parts = multiply_tall(draws.stiffness, columns.T)  # (D, 21)
    rest = parts[:, 14:]
    if model.lateral[h].any():
        rest *= (factors.thrust / wear)[:, None]
    linear = np.concatenate([P[:, :3] for P in rows])  # (7, 3) of a displacement that both poses share
    if model.local:
        parts[:, :7] += model.local * (draws.local @ linear.T)
    rest += np.concatenate([P[:, :3] @ model.poses[pose].offset[h] for pose, P in enumerate(rows)])
    tilt = np.zeros((len(draws), 2))
    if position:
        first = 0
        for pose, P in enumerate(rows):
            if has_position_draws(model.scatter[pose], h):
                rest[:, first : first + len(P)] += draw_position(model.scatter[pose], h, draws) @ P.T
            first += len(P)
        std = np.concatenate([np.full(len(P), np.nan_to_num(model.scatter[n].std[h])) for n, P in enumerate(rows)])
        rest += draws.position @ (std[:, None] * linear).T
        tilt = model.scatter[ENTRY].tilt_std[h] * draws.tilt
    return HoleTerms(
        model=model,
        hole=h,
        thrust=model.targets.thrust[h] / wear * factors.thrust,
        torque=model.targets.torque[h] / wear * factors.torque,
        parts=parts,
        tilt=tilt,
    )


def _list_component_rows(poses: tuple[TargetPoses, TargetPoses]) -> tuple[Array, Array]:
    """Return (H, 4, 6) and (H, 3, 6): what of a twist at entry and at exit the errors need.

    In this order: two displacements across the axis and two turns at entry, the displacement along the axis and two
    turns at exit.
    """
    entry, leave = (build_sideways(pose.axis) for pose in poses)
    zero, along = np.zeros_like(entry), poses[EXIT].axis[:, None]
    turns = [np.concatenate([zero, across], axis=2) for across in (entry, leave)]
    ahead = np.concatenate([along, np.zeros_like(along)], axis=2)
    return (
        np.concatenate([np.concatenate([entry, zero], axis=2), turns[ENTRY]], axis=1),
        np.concatenate([ahead, turns[EXIT]], axis=1),
    )


def _project(rows: tuple[Array, Array], columns: list[Array]) -> Array:
    """Return (H, 7, 1 + R) the components of the twists (H, 6, 1 + R) at entry and exit."""
    return np.concatenate([rows[ENTRY] @ columns[ENTRY], rows[EXIT] @ columns[EXIT]], axis=1)


def compute_nominal_hole_errors(model: HoleErrorModel, h: int) -> HoleDraws:
    """Return the errors of one hole at nominal values.

    Args:
        model: The error model.
        h: Index of the hole.
    """
    return draw_hole_errors(model, h, build_nominal_draw(model.spread), position=False)


def build_sideways(axis: Array) -> Array:
    """Return two unit vectors across each axis, (H, 2, 3).

    Args:
        axis: (H, 3) unit.
    """
    helper = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axis, first)], axis=1)

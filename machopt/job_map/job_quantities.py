"""Quantities of a map under the forces of a job: error, probability and stability of each operation.

Each operation is represented by its directions of travel, to 15°, each with its point of the largest force on the arm,
at the programmed feed. A direction is the angle about the tool axis from the map's x axis (y where x is parallel to
it), with the part in its place; at another tool axis it is turned by the same angle. The worst direction counts.
Errors are those at the place itself: of a hole across its axis, of a milled point normal to its surface. Other
tolerances and lost motion do not count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.toolpath import Toolpath
from machopt.dynamics.rigid_body import MissingInertiaError, RigidBodyDynamics, load_dynamics
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.planning.cost.process_force_direction import SIDEWAYS
from machopt.planning.error_probability.missing_inputs import find_missing_input, find_stated_std
from machopt.planning.error_probability.random_draws import UncertaintyDraws, build_draws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.toleranced_points import (
    compute_tip_length,
    list_hole_targets,
    list_surface_targets,
)
from machopt.planning.stability.depth_ratio import find_missing_input as find_missing_stability_input
from machopt.planning.stability.tool_mode_depth_limit import compute_tool_limit
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear
from machopt.process.milling.engagement_angles import ContactArc
from machopt.process.milling.milling_cut import CutSide, MillingCut
from machopt.process.stability.depth_limit import compute_depth_limit, compute_tooth_period
from machopt.process.stability.directional_matrix import compute_directional_matrix
from machopt.process.stability.structural_modes import compute_arm_modes
from machopt.workspace_map.quantities import MapQuantity, MapSettings, PostureStates

DRAWS = 256
WIDEST = 4.0  # times the planned depth: a larger limit is mapped as this
DIRECTION_STEP = np.radians(15.0)  # between directions of travel that count separately
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True, kw_only=True)
class OperationLoad:
    """One operation of the job in one direction of travel, by its point with the largest force."""

    one: ProcessOperation
    row: int  # toolpath point
    force: Array  # (3,) N of the process along travel, normal, axis
    clamp: float = 0.0  # N, of a hole: the arm carries at least this along the axis
    moment: float  # N·m about the axis
    normal_sign: float  # of a milled wall: its normal is this times axis × travel; 0: the floor, or a hole
    is_known: bool  # a hole, or a surface whose normal is known
    direction: float = 0.0  # rad, of the travel about the tool axis, from the map's x axis


def build_job_quantities(
    cell: Cell, toolpath: Toolpath, setting: MapSettings
) -> tuple[tuple[MapQuantity, ...], tuple[str, ...]]:
    """Return the quantities of a job's operations, and why some are missing.

    Args:
        cell: The cell with tool and process.
        toolpath: Toolpath of that tool, with its process operations.
        setting: Constant inputs of the map.

    Raises:
        InputError: cell or toolpath have nothing that could be mapped.
    """
    process, loads = cell.process, compute_loads(cell, toolpath, toolpath.feed)
    if process is None or loads is None:
        raise InputError("needs process.yaml; --process FILE would work", where="--toolpath")
    if setting.elasticity is None:
        raise InputError("needs a cell with stiffness", where="--toolpath")
    model = _JobModel.build(cell, toolpath, setting, process, loads)
    out: list[MapQuantity] = []
    notes: list[str] = []
    for n, every in enumerate(_list_operation_loads(cell, toolpath, loads, setting), 1):
        load = every[0]
        if load.one.is_hole or all(one.is_known for one in every):
            out.append(_build_error_quantity(model, n, every))
        else:
            notes.append(f"{load.one.label}: no error is mapped: its surface does not follow from the travel direction")
        why = model.find_missing(every)
        if why:
            notes.append(f"{load.one.label}: no probability is mapped: {why}")
        else:
            out.append(_build_probability_quantity(model, n, every))
        if load.one.kind == "milling" and model.dynamics is not None and not load.one.takes_stock:
            out.append(_build_stability_quantity(model, n, every))
        elif load.one.kind == "milling":
            notes.append(
                f"{load.one.label}: no stability is mapped: {model.no_stability or 'engagement from the stock'}"
            )
    if not out:
        raise InputError("no operation of the job has a force and a tolerance", where="--toolpath")
    return tuple(out), tuple(notes)


def _list_operation_loads(
    cell: Cell, toolpath: Toolpath, loads: PointLoads, setting: MapSettings
) -> list[tuple[OperationLoad, ...]]:
    """Return the operations with a tolerance, in the order of process.yaml, each by its directions of travel."""
    cutter, process = cell.tool.cutter, cell.process
    assert process is not None
    R_frame_work = setting.R_base_frame.T @ cell.T_world_base[:3, :3].T @ cell.workpiece.T_link_workpiece[:3, :3]
    holes = list_hole_targets(process, toolpath, loads, compute_tip_length(cutter))
    surfaces = list_surface_targets(process, toolpath, loads, cutter)
    out: list[tuple[OperationLoad, ...]] = []
    for k, one in enumerate(process.operations):
        mine = np.flatnonzero(holes.operation == k)
        if len(mine):
            h = int(mine[np.argmax(holes.thrust[mine])])
            force = np.append(holes.force[h], holes.thrust[h])
            hole = OperationLoad(
                one=one,
                row=int(holes.row[h]),
                force=force,
                clamp=float(holes.clamp[h]),
                moment=float(holes.torque[h]),
                normal_sign=0.0,
                is_known=True,
            )
            out.append((hole,))
        mine = np.flatnonzero((surfaces.operation == k) & ~loads.is_unknown[surfaces.row])
        if len(mine):
            size = np.linalg.norm(loads.arm_force[surfaces.row[mine]], axis=1)
            angle = _measure_directions(toolpath, surfaces.row[mine], R_frame_work)
            order = np.argsort(-size, kind="stable")
            strongest = order[np.unique(angle[order], return_index=True)[1]]  # of each direction
            out.append(
                tuple(
                    OperationLoad(
                        one=one,
                        row=int(surfaces.row[mine[n]]),
                        force=loads.arm_force[surfaces.row[mine[n]]],
                        moment=float(loads.moment[surfaces.row[mine[n]]]),
                        normal_sign=float(surfaces.normal_sign[mine[n]]),
                        is_known=bool(surfaces.is_known[mine[n]])
                        and not np.isfinite(surfaces.stated_normal[mine[n]]).all(),
                        direction=float(angle[n]),
                    )
                    for n in sorted(strongest.tolist(), key=lambda n: -size[n])
                )
            )
    return out


def _measure_directions(toolpath: Toolpath, rows: NDArray[np.intp], R_frame_work: Array) -> Array:
    """Return (n,) rad the direction of the move to each point about its tool axis, from the map's x axis, to 15°."""
    axis = toolpath.axis[rows] @ R_frame_work.T
    step = (toolpath.position[rows] - toolpath.position[np.maximum(rows - 1, 0)]) @ R_frame_work.T
    reference = np.where(np.abs(axis[:, :1]) > 1.0 - 1e-9, np.eye(3)[1], np.eye(3)[0])
    reference = reference - np.sum(reference * axis, axis=1, keepdims=True) * axis
    along, across = np.sum(reference * step, axis=1), np.sum(np.cross(axis, reference) * step, axis=1)
    sideways = np.flatnonzero(np.hypot(along, across) >= SIDEWAYS * np.linalg.norm(step, axis=1) + 1e-12)
    if not len(sideways):
        return np.zeros(len(rows))
    own = sideways[np.minimum(np.searchsorted(sideways, np.arange(len(rows))), len(sideways) - 1)]
    angle = np.arctan2(across, along)[own]  # a plunge has the direction of the next move that has one
    steps = round(2.0 * np.pi / DIRECTION_STEP)
    return np.asarray(np.mod(np.round(angle / DIRECTION_STEP), steps) * DIRECTION_STEP)


@dataclass(frozen=True, kw_only=True)
class _JobModel:
    """What all operations share."""

    cell: Cell
    process: CuttingProcess
    setting: MapSettings
    loads: PointLoads
    spread: StiffnessSpread
    draws: UncertaintyDraws
    dynamics: RigidBodyDynamics | None  # None: no stability
    no_stability: str

    @classmethod
    def build(
        cls, cell: Cell, toolpath: Toolpath, setting: MapSettings, process: CuttingProcess, loads: PointLoads
    ) -> _JobModel:
        assert setting.elasticity is not None
        spread = StiffnessSpread.build(setting.elasticity, (setting.lower, setting.upper))
        missing, dynamics = find_missing_stability_input(cell, toolpath), None
        if not missing:
            try:
                dynamics = load_dynamics(cell)
            except MissingInertiaError:
                missing = "inertias of the robot's links"
        return cls(
            cell=cell,
            process=process,
            setting=setting,
            loads=loads,
            spread=spread,
            draws=build_draws(spread, DRAWS),
            dynamics=dynamics,
            no_stability=missing,
        )

    def find_missing(self, every: tuple[OperationLoad, ...]) -> str:
        """Return why an operation has no probability; empty where it has one."""
        load = every[0]
        if not all(one.is_known for one in every):
            return "the surface normal changes along the path"
        limit = load.one.tolerance.position if load.one.is_hole else load.one.tolerance.surface
        if not np.isfinite(limit):
            return "it states no limit of position or surface"
        std = find_stated_std(self.cell, self.spread.elasticity.stiffness, load.one.tolerance.reference)
        return find_missing_input(self.process, load.one, self.spread, std)

    def compute_axes(self, s: PostureStates, direction: float) -> tuple[Array, Array, Array]:
        """Return (M, 3) travel, normal and axis in base_link, for a direction of travel in rad."""
        axis = -s.tool_axes[:, :, 2]
        reference = s.compute_axis(0)
        parallel = np.abs(np.sum(axis * reference, axis=1, keepdims=True)) > 1.0 - 1e-9
        reference = np.where(parallel, s.compute_axis(1), reference)
        travel = reference - np.sum(axis * reference, axis=1, keepdims=True) * axis
        travel = travel / np.linalg.norm(travel, axis=1, keepdims=True)
        travel = np.cos(direction) * travel + np.sin(direction) * np.cross(axis, travel)
        return travel, np.cross(axis, travel), axis

    def compute_error_rows(self, s: PostureStates, load: OperationLoad, force: Array, moment: float) -> Array:
        """Return (M, K, 1 + R) error components by nominal stiffness and each of its errors: two across, or one.

        Force (3,) in N lies along travel, normal and axis, the moment in N·m about the axis.
        """
        travel, normal, axis = self.compute_axes(s, load.direction)
        wrench = np.hstack([force[0] * travel + force[1] * normal + force[2] * axis, moment * axis])
        external = None
        if self.setting.external_compliance is not None and self.setting.external is not None:
            values = np.tile(self.setting.external, (len(axis), 1))
            external = self.setting.external_compliance.compute_compliance(values, s.state.T_base_tool[:, :3, 3])
        columns = self.spread.compute_columns(s.elasticity, s.state.q, wrench, external)
        ways = [travel, normal] if load.one.is_hole else [axis if load.normal_sign == 0 else load.normal_sign * normal]
        return np.stack([np.einsum("mi,mir->mr", way, columns[:, :3]) for way in ways], axis=1)


def _build_error_quantity(model: _JobModel, n: int, every: tuple[OperationLoad, ...]) -> MapQuantity:
    load = every[0]
    where = "across the hole" if load.one.is_hole else "normal to the surface"

    def compute_one(s: PostureStates, load: OperationLoad) -> Array:
        borne = np.append(load.force[:2], max(load.force[2], load.clamp))  # by the arm
        return np.asarray(np.linalg.norm(model.compute_error_rows(s, load, borne, load.moment)[:, :, 0], axis=1))

    def compute(s: PostureStates) -> Array:
        return np.asarray(np.max([compute_one(s, one) for one in every], axis=0))

    f = np.append(load.force[:2], max(load.force[2], load.clamp))
    return _build_quantity(
        f"error_{n}",
        f"Error of {load.one.label}",
        "m",
        "less",
        f"Size of the error {where} under the force of point {load.row}: {f[0]:.0f} N along travel, {f[1]:.0f} N "
        f"normal, {f[2]:.0f} N along the axis. {_describe_directions(every)}",
        compute,
    )


def _describe_directions(every: tuple[OperationLoad, ...]) -> str:
    if every[0].one.is_hole:
        return "The sideways directions are those of γ = 0."
    shown = ", ".join(f"{np.degrees(load.direction):.0f}°" for load in every)
    return f"Travel from the map's x axis about the tool axis: {shown}; the worst counts."


def _build_probability_quantity(model: _JobModel, n: int, every: tuple[OperationLoad, ...]) -> MapQuantity:
    one, draws = every[0].one, model.draws
    std = find_stated_std(model.cell, model.spread.elasticity.stiffness, one.tolerance.reference)
    factor = draws.compute_load_factor(model.process, one) / compute_mean_wear(one)
    limit = one.tolerance.position if one.is_hole else one.tolerance.surface

    def compute(s: PostureStates) -> Array:
        is_stated = model.spread.find_stated(s.state.T_base_tool[:, :3, 3])
        return np.where(is_stated, np.min([compute_one(s, load) for load in every], axis=0), np.nan)

    def compute_one(s: PostureStates, load: OperationLoad) -> Array:
        # the force of the process is drawn; the clamp, which bears where it is larger, is not
        rows = model.compute_error_rows(s, load, np.append(load.force[:2], 0.0), load.moment)
        along = model.compute_error_rows(s, load, np.array([0.0, 0.0, 1.0]), 0.0)
        scaled = (factor[:, None] * draws.stiffness).T
        borne = (np.maximum(factor * load.force[2], load.clamp)[:, None] * draws.stiffness).T
        parts = [rows[:, k] @ scaled + along[:, k] @ borne + std * draws.position[:, k] for k in range(rows.shape[1])]
        return np.asarray(np.mean(sum(p * p for p in parts) <= limit**2, axis=1))

    return _build_quantity(
        f"p_in_{n}",
        f"Probability of {one.label} in tolerance",
        "1",
        "more",
        f"Share of {DRAWS} draws of stiffness, force and accuracy within ± {1e3 * limit:g} mm: pass from "
        f"{model.process.quantile:g}, fail below 0.5, marginal between.",
        compute,
    )


def _build_stability_quantity(model: _JobModel, n: int, every: tuple[OperationLoad, ...]) -> MapQuantity:
    parts = [_build_depth_ratio(model, load) for load in every]
    depth = float(model.loads.ap[every[0].row])
    return _build_quantity(
        f"stability_{n}",
        f"Stable depth of {every[0].one.label} over planned depth",
        "1",
        "more",
        f"Largest stable depth of cut over {1e3 * depth:g} mm, by the coupled modes of the arm with locked rotors and "
        f"the modes of the tool; above 1 the cut is stable. Larger ones count as {WIDEST:g}. "
        f"{_describe_directions(every)}",
        lambda s: np.asarray(np.min([part(s) for part in parts], axis=0)),
    )


def _build_depth_ratio(model: _JobModel, load: OperationLoad) -> Callable[[PostureStates], Array]:
    """Return the function of the stable depth over the planned depth in one direction of travel."""
    dynamics, process, row, one = model.dynamics, model.process, load.row, load.one
    coefficients, damping = process.materials[one.material].milling, process.damping
    assert dynamics is not None
    assert coefficients is not None
    assert damping is not None
    ratios = damping.ratios[0] if len(damping.ratios) == 1 else damping.ratios[:6]
    cutter, loads, zero = build_milling_cutter(model.cell.tool.cutter), model.loads, np.zeros(())
    arc = ContactArc(loads.entry_angle[row], loads.exit_angle[row], zero, zero)
    cut = MillingCut(_SIDES[int(loads.side[row])], one.spindle)
    H = compute_directional_matrix(coefficients, cutter, cut, arc)
    depth = float(loads.ap[row])
    period = compute_tooth_period(60.0 * loads.spindle_speed[row : row + 1], cutter.teeth)

    def compute(s: PostureStates) -> Array:
        axes = np.stack(model.compute_axes(s, load.direction), axis=1)
        J = axes @ s.state.J[:, :3]
        modes = compute_arm_modes(dynamics.compute_mass_matrix(s.state.q), 1.0 / s.elasticity.k, J, ratios)
        periods = np.broadcast_to(period, (len(J),))
        limit = compute_depth_limit(modes, H, periods, largest=WIDEST * depth).depth
        tool = compute_tool_limit(model.cell.tool.cutter, H, periods, axes, s.tool_axes)
        limit = limit if tool is None else np.fmin(limit, tool)
        return np.minimum(np.where(np.isnan(limit), np.inf, limit) / depth, WIDEST)

    return compute


def _build_quantity(
    key: str, name: str, unit: str, better: str, note: str, function: Callable[[PostureStates], Array]
) -> MapQuantity:
    return MapQuantity(
        key=key,
        name=name,
        unit=unit,  # type: ignore[arg-type]
        better=better,  # type: ignore[arg-type]
        needs=frozenset({"stiffness"}),
        note=note,
        function=function,
    )

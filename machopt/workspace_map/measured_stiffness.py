"""Comparison of measured stiffness with the model: at the measured places, and interpolated over the map's samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.measurements.measured_tcp_stiffness import MeasuredStiffness
from machopt.errors import OptionError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform
from machopt.workspace_map.inverse_distance_weighting import InterpolatedValues, interpolate_idw, predict_leave_one_out
from machopt.workspace_map.postures import ReachingArm, build_tool_poses, choose_postures
from machopt.workspace_map.quantities import MapQuantity, MapSettings
from machopt.workspace_map.request import MapOptions, MapRequest

MAX_POSITION_OFFSET_M = (
    5e-3  # m; a larger difference between places and joints of a table indicates another tool or frame
)


@dataclass(frozen=True, kw_only=True)
class MeasuredComparison:
    """P readings, their predictions from the other readings and from the model, and their interpolation over M
    samples.
    """

    file: str
    axes: tuple[str, ...]  # measured ones of x, y, z (F)
    position: Array  # (P, 3) m in the map's frame
    measured: Array  # (P, F) N/m
    left_out: Array  # (P, F) N/m, interpolated from the other readings
    model: Array  # (P, F) N/m, 1/(eᵀCe); NaN where the model has no posture
    held_stiffness: Array  # (P, F) N/m, diagonal of K_m
    spread: InterpolatedValues  # (M, F) over the map
    power: float
    neighbours: int | None
    from_joints: bool  # the readings' own postures were used
    warnings: tuple[str, ...]

    def compute_errors(self) -> dict[str, dict[str, float | None]]:
        """Return root mean square and median relative error by axis: left-out readings, and the model."""
        out: dict[str, dict[str, float | None]] = {}
        for f, axis in enumerate(self.axes):
            row: dict[str, float | None] = {}
            for name, predicted in (("left_out", self.left_out), ("model", self.model), ("held", self.held_stiffness)):
                relative = predicted[:, f] / self.measured[:, f] - 1.0
                relative = relative[np.isfinite(relative)]
                row[f"{name}_rms"] = float(np.sqrt(np.mean(relative**2))) if len(relative) else None
                row[f"{name}_median"] = float(np.median(np.abs(relative))) if len(relative) else None
            out[axis] = row
        return out


def _evaluate_model(setting: MapSettings, q: Array, axes: tuple[str, ...]) -> tuple[Array, Array]:
    """Return the model's stiffness along the axes at q (n, 6), free and with the other directions held, N/m."""
    model, constrained = (np.full((len(q), len(axes)), np.nan) for _ in range(2))
    there = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(there):
        at = setting.evaluate_states(q[there])
        for f, axis in enumerate(axes):
            direction = at.compute_axis("xyz".index(axis))
            model[there, f] = 1.0 / at.elasticity.compute_compliance_along(direction)
            constrained[there, f] = at.compute_held_stiffness(direction)
    return model, constrained


def compare_with_measured(
    table: MeasuredStiffness,
    request: MapRequest,
    options: MapOptions,
    arm: ReachingArm,
    setting: MapSettings,
    criterion: MapQuantity,
    places: Array,
) -> MeasuredComparison:
    """Compare a table with the model and interpolate it over the map's places.

    Args:
        table: measured stiffness.
        request: options as the user wrote them.
        options: map options.
        arm: kinematics, limits, margins.
        setting: constant inputs of the quantities.
        criterion: quantity by which postures are selected.
        places: (M, 3) m in the map's frame, NaN: no place.

    Raises:
        InputError: the cell has no stiffness.
    """
    if setting.elasticity is None:
        raise OptionError("measured stiffness is compared with a model; the cell has no stiffness", where="--measured")
    axes = tuple(table.stiffness)
    measured = np.column_stack([table.stiffness[axis] for axis in axes])
    position, q, warnings = _locate_readings(table, options, arm, setting, criterion)
    model, constrained = _evaluate_model(setting, q, axes)
    known = np.isfinite(places).all(axis=1)
    value, inside = np.full((len(places), len(axes)), np.nan), np.zeros(len(places), bool)
    nearest = np.full(len(places), np.nan)
    if known.any():
        found = interpolate_idw(position, measured, places[known], request.power, request.neighbours)
        value[known], inside[known], nearest[known] = found.value, found.inside, found.nearest
    if not inside.any():
        low, high = position.min(axis=0) * 1e3, position.max(axis=0) * 1e3
        spans = ", ".join(f"{c} {a:.0f} to {b:.0f}" for c, a, b in zip("xyz", low, high, strict=True))
        warnings.append(
            f"no sample of the map lies between the measured places ({spans} mm): all interpolated values are guesses"
        )
    return MeasuredComparison(
        file=table.file.name,
        axes=axes,
        position=position,
        measured=measured,
        left_out=predict_leave_one_out(position, measured, request.power, request.neighbours),
        model=model,
        held_stiffness=constrained,
        spread=InterpolatedValues(value, inside, nearest),
        power=request.power,
        neighbours=request.neighbours,
        from_joints=table.q is not None,
        warnings=tuple(warnings),
    )


def _locate_readings(
    table: MeasuredStiffness, options: MapOptions, arm: ReachingArm, setting: MapSettings, criterion: MapQuantity
) -> tuple[Array, Array, list[str]]:
    """Positions (P, 3) in the map's frame, postures (P, 6) with NaN where none, and what to warn of."""
    warnings: list[str] = []
    if table.q is not None:
        T = invert_transform(options.T_base_frame) @ arm.robot.compute_fk(table.q, arm.T_flange_tcp)
        if table.position is None:
            return T[:, :3, 3], table.q, warnings
        apart = np.linalg.norm(T[:, :3, 3] - table.position, axis=1)
        worst = int(np.argmax(apart))
        if apart[worst] > MAX_POSITION_OFFSET_M:
            warnings.append(
                f"{table.file.name} line {table.lines[worst]}: the joints put the TCP {1e3 * apart[worst]:.0f} mm "
                "from the stated place; another tool, frame or unit?"
            )
        return table.position, table.q, warnings
    if table.position is None:
        raise ValueError("a table of measured stiffness has places or joints")
    place, gamma = table.position, options.gamma[:1]
    postures = choose_postures(
        arm,
        lambda part: options.T_base_frame @ build_tool_poses(place[part], options.tool_axis, gamma),
        (len(place), 1),
        gamma,
        lambda joints: criterion.compute_goodness(setting.evaluate_states(joints)),
        options.pick,
    )
    missing = int((~postures.ok).sum())
    if missing:
        warnings.append(
            f"{missing} of {len(place)} measured places cannot be reached with this tool axis and "
            "rotation; joint columns in the table would define their postures"
        )
    return place, postures.q, warnings

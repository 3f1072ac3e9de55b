"""Predicted errors of holes and milled points, recomputed pose by pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.process import CutSide, ProcessOperation
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.process.contact_load import compute_contact_wall_force
from machopt.verification.motion.process.draws_in_tolerance import count_within
from machopt.verification.motion.process.hole_strokes import HoleVisit
from machopt.verification.motion.process.mill_load import compute_wall_force
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.motion.process.pose_compliance import (
    DrawnLoads,
    PoseCompliance,
    compute_components,
    list_hole_rows,
)
from machopt.verification.motion.process.random_draws import (
    DRAWS,
    SEED,
    draw_compliances,
    draw_load_factors,
    get_position_std,
)
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}
_STATED = {"up": 1, "down": -1}


@dataclass(frozen=True, kw_only=True)
class PredictedErrors:
    """Errors of N points, SI; NaN where there is none."""

    along: Array
    across: Array
    normal: Array
    axis: Array
    size: Array  # (N,) m, length of the displacement
    p_in: Array


def predict_errors(
    cell: Cell,
    toolpath: Toolpath,
    loads: RecomputedLoads,
    motion: ExportedMotion,
    points: ExportedPoints,
    arm: UrdfKinematics,
    law: ComplianceModel,
) -> PredictedErrors:
    """Return errors and probabilities of all points with a tolerance.

    Args:
        cell: The cell with the tool and the process.
        toolpath: The toolpath.
        loads: Its recomputed loads.
        motion: The motion, true joint angles.
        points: Rows of points.csv, true joint angles.
        arm: Kinematics of the arm.
        law: Compliance of the arm.
    """
    n = len(toolpath)
    names = ("along", "across", "normal", "axis", "size", "p_in")
    out = PredictedErrors(**{name: np.full(n, np.nan) for name in names})
    predictor = _Predictor(cell, toolpath, loads, motion, points, arm, law)
    predictor.add_holes(out)
    predictor.add_surfaces(out)
    return out


@dataclass(frozen=True, kw_only=True)
class _SurfaceDeflection:
    """What the nominal load does at K milled points, in base_link."""

    normal: Array  # (K, 3) unit, away from the material
    twist: Array  # (K, 6) of the tool relative to the part
    tool: Array  # (K,) m, deflection of the tool along the normal
    by_joint: Array  # (K, 6) m, error along the normal by each joint
    rest: Array  # (K,) m, error by everything else


@dataclass(frozen=True)
class _HoleDraws:
    """Draws that all holes of one operation share; D of them."""

    thrust: Array  # (D,) factor of the unworn force
    torque: Array  # (D,)
    noise: Array  # (D, 3) standard normal
    part: Array  # (D, 6) pose of the part, m and rad
    tilt: Array  # (D, 2) rad


class _Predictor:
    def __init__(
        self,
        cell: Cell,
        toolpath: Toolpath,
        loads: RecomputedLoads,
        motion: ExportedMotion,
        points: ExportedPoints,
        arm: UrdfKinematics,
        law: ComplianceModel,
    ) -> None:
        assert cell.process is not None
        assert cell.stiffness is not None
        self.cell, self.toolpath, self.loads, self.motion, self.points = cell, toolpath, loads, motion, points
        self.arm, self.law, self.process = arm, law, cell.process
        self.side = compute_sideways_directions(toolpath)
        known = np.flatnonzero(np.isfinite(motion.point))
        self.order = known[np.argsort(motion.point[known], kind="stable")]
        self.walls: dict[tuple[str, str], tuple[Array, Array]] = {}
        self.hole_draws: dict[int, _HoleDraws] = {}  # by operation
        self.compliances = draw_compliances(cell.stiffness, np.random.default_rng(SEED))
        self.by_joint = np.empty((6, 0)) if self.compliances is None else np.ascontiguousarray(self.compliances.T)

    def add_holes(self, out: PredictedErrors) -> None:
        holes = [
            hole
            for hole in self.loads.holes
            if self.process.operations[hole.operation].tolerance.is_given and self.points.ok[hole.deepest]
        ]
        if not holes:
            return
        entry = self._locate_poses(np.array([self._find_entry(hole) for hole in holes]))
        bottom = self._locate_poses(np.array([float(hole.deepest) for hole in holes]))
        for hole, *poses in zip(holes, entry.list_rows(), bottom.list_rows(), strict=True):
            self._add_hole(hole, poses, out)

    def _add_hole(self, hole: HoleVisit, poses: list[PoseCompliance], out: PredictedErrors) -> None:
        one = self.process.operations[hole.operation]
        strongest = max((s.point for s in hole.strokes), key=lambda p: self.loads.force[p, 2], default=hole.deepest)
        thrust, torque = float(self.loads.force[strongest, 2]), float(self.loads.moment[strongest])
        sideways = self.loads.force[strongest, :2]
        least = one.clamp or -math.inf  # without a foot the arm carries the thrust
        single = DrawnLoads(
            thrust=np.array([max(thrust, least)]), torque=np.array([torque]), sideways=np.ones(1), nominal=sideways
        )
        entry, bottom = (compute_components(p, self.cell, single, None, np.eye(6))[0] for p in poses)
        row, e, axis = hole.deepest, entry[:3] + poses[0].offset, poses[0].axis
        out.across[row] = np.linalg.norm(e - (e @ axis) * axis)
        out.along[row] = (bottom[:3] + poses[1].offset) @ poses[1].axis
        turns = zip((entry, bottom), poses, strict=True)
        out.axis[row] = max(float(np.linalg.norm(np.cross(t[3:], p.axis))) for t, p in turns)
        out.size[row] = np.linalg.norm(bottom[:3])
        sigma = get_position_std(self.cell, one.tolerance.reference)
        if self.compliances is not None and np.isfinite(sigma):
            if hole.operation not in self.hole_draws:
                self.hole_draws[hole.operation] = self._draw_operation(one)
            draws = self.hole_draws[hole.operation]
            out.p_in[row] = self._draw_hole(one, poses, (thrust, torque, sideways), sigma, draws)

    def _draw_operation(self, one: ProcessOperation) -> _HoleDraws:
        """Return the draws that all holes of an operation share."""
        rng = np.random.default_rng(SEED + 1)
        factor, turn = draw_load_factors(self.process, one, rng)
        noise = rng.standard_normal((DRAWS, 3))
        part = self._draw_part(one, rng)
        return _HoleDraws(factor, turn, noise, part, self._draw_tilt(one, rng))

    def _draw_hole(
        self,
        one: ProcessOperation,
        poses: list[PoseCompliance],
        load: tuple[float, float, Array],
        sigma: float,
        draws: _HoleDraws,
    ) -> float:
        thrust, torque, sideways = load
        wear, limits = 0.5 * (one.wear[0] + one.wear[1]), one.tolerance
        loads = DrawnLoads(
            thrust=np.maximum(thrust / wear * draws.thrust, one.clamp or -math.inf),
            torque=torque / wear * draws.torque,
            sideways=draws.thrust / wear,
            nominal=sideways,
        )
        good = np.ones(DRAWS, bool)
        for n, pose in enumerate(poses):
            every = list_hole_rows(pose.axis)
            rows = every[[0, 1, 3, 4]] if n == 0 else every[2:]
            error = compute_components(pose, self.cell, loads, self.compliances, rows)
            error += rows[:, :3] @ pose.offset
            error[:, :-2] += draws.noise @ (sigma * rows[:-2, :3]).T
            if draws.part.any():
                error += self._move_part(pose.place, pose.R, draws.part) @ rows.T
            if math.isfinite(limits.axis):
                turn = error[:, -2:] + draws.tilt
                good &= turn[:, 0] ** 2 + turn[:, 1] ** 2 <= limits.axis**2
            if n == 0:
                good &= error[:, 0] ** 2 + error[:, 1] ** 2 <= limits.position**2
            else:
                good &= np.abs(error[:, 0]) <= limits.depth
        return float(np.mean(good))

    def add_surfaces(self, out: PredictedErrors) -> None:
        rng = np.random.default_rng(SEED + 2)
        for k, one in enumerate(self.process.operations):
            if not np.isfinite(one.tolerance.surface):
                continue
            mine = (self.toolpath.move == MoveKind.CUT) & (self.loads.operation == k) & self.points.ok
            rows = np.flatnonzero(mine)
            factor = draw_load_factors(self.process, one, rng)[0] / (0.5 * (one.wear[0] + one.wear[1]))
            part, noise = self._draw_part(one, rng), rng.standard_normal(DRAWS)
            contact, limit = rng.standard_normal(DRAWS), one.tolerance.surface
            if not len(rows):
                continue
            table = self._locate_poses(rows.astype(float))
            found = self._deflect_surfaces(one, rows, table)
            out.size[rows] = np.linalg.norm(found.twist[:, :3], axis=1) + np.abs(found.tool)
            known = self._has_normal(one, rows) & ~self.loads.is_unknown[rows]
            nominal = np.sum(found.normal * (found.twist[:, :3] + table.offset), axis=1) + found.tool
            out.normal[rows] = np.where(known, nominal, np.nan)
            sigma = get_position_std(self.cell, one.tolerance.reference)
            if self.compliances is None or not np.isfinite(sigma):
                continue
            for n in np.flatnonzero(known).tolist():
                row, spread = int(rows[n]), self.loads.contact_sigma[rows[n]]
                own = factor * np.exp(spread * contact) if spread else factor
                moved = sigma * noise
                if part.any():
                    moved = moved + self._move_part(table.place[n], table.R[n], part)[:, :3] @ found.normal[n]
                shift = float(found.normal[n] @ table.offset[n])
                good = count_within(self.by_joint, found.by_joint[n], found.rest[n], own, moved, shift, limit)
                out.p_in[row] = good / DRAWS

    def _deflect_surfaces(
        self, one: ProcessOperation, rows: NDArray[np.intp], table: PoseCompliance
    ) -> _SurfaceDeflection:
        """Return what the nominal load does at milled points."""
        left = np.cross(table.axis, table.travel)
        normal = self._find_normals(one, rows, table, left)
        f = self.loads.arm_force[rows]
        force = f[:, :1] * table.travel + f[:, 1:2] * left + f[:, 2:] * table.axis
        wrench = np.hstack([force, self.loads.moment[rows, None] * table.axis])
        bent = np.einsum("nj,njk->nk", wrench, table.J) * table.joints
        twist = np.einsum("nij,nj->ni", table.J, bent) + np.einsum("nij,nj->ni", table.rest, wrench)
        if self.cell.workpiece.stiffness is not None:
            pressed = np.einsum("nij,ni->nj", table.R, wrench[:, :3]) / self.cell.workpiece.stiffness
            twist[:, :3] += np.einsum("nij,nj->ni", table.R, pressed)
        tool = np.array([self._bend_tool(one, row) for row in rows.tolist()]) * np.sum(normal * left, axis=1)
        by_joint = np.einsum("ni,nij->nj", normal, table.J[:, :3]) * bent  # error by each joint at nominal
        rest = np.sum(normal * twist[:, :3], axis=1) - by_joint.sum(axis=1) + tool
        return _SurfaceDeflection(normal=normal, twist=twist, tool=tool, by_joint=by_joint, rest=rest)

    def _has_normal(self, one: ProcessOperation, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return (n,) whether the normal of the surface is known."""
        cutter = self.cell.tool.cutter
        rounded = cutter is not None and cutter.corner > 0
        if not (rounded or one.surface == "table"):
            return np.ones(len(rows), bool)
        given = self.toolpath.surface_normal
        return np.zeros(len(rows), bool) if given is None else np.asarray(np.isfinite(given[rows]).all(axis=1))

    def _bend_tool(self, one: ProcessOperation, row: int) -> float:
        """Return the deflection of the tool along axis × travel when the wall is made, m."""
        cutter = self.cell.tool.cutter
        if cutter is None or cutter.side_stiffness is None or one.kind != "milling" or one.surface != "side":
            return 0.0
        if one.takes_stock:
            return self._bend_at_contact(one, row)
        side = _SIDES[int(self.loads.side[row])]
        key = (one.label, side)
        if key not in self.walls:
            coefficients = self.process.materials[one.material].milling
            assert coefficients is not None
            assert one.ap is not None
            depths = (cutter.diameter if one.ae is None else one.ae, one.ap)
            self.walls[key] = compute_wall_force(coefficients, cutter, side, one.spindle, depths)
        edge, slope = self.walls[key]
        return self._bend_by(edge, slope, one, row)

    def _bend_at_contact(self, one: ProcessOperation, row: int) -> float:
        """Return the deflection of the tool at a point with stated arcs of contact, m."""
        arcs, cutter = self.toolpath.engagement, self.cell.tool.cutter
        coefficients = self.process.materials[one.material].milling
        assert arcs is not None
        assert cutter is not None
        assert coefficients is not None
        own = arcs.take_range(row, row + 1)
        parts = list(zip(own.low.tolist(), own.high.tolist(), own.start.tolist(), own.end.tolist(), strict=True))
        if not parts:
            return 0.0
        side = int(self.loads.side[row])
        edge, slope = compute_contact_wall_force(coefficients, cutter, side, one.spindle, parts)
        return self._bend_by(edge, slope, one, row)

    def _bend_by(self, edge: Array, slope: Array, one: ProcessOperation, row: int) -> float:
        cutter = self.cell.tool.cutter
        assert cutter is not None
        assert cutter.side_stiffness is not None
        force = edge + slope * float(self.loads.bite[row])
        wear = 0.5 * (one.wear[0] + one.wear[1])
        return wear * float(force[np.argmax(np.abs(force))]) / cutter.side_stiffness

    def _find_normals(self, one: ProcessOperation, rows: NDArray[np.intp], table: PoseCompliance, left: Array) -> Array:
        """Return (n, 3) the outward normals of the surface: away from the material."""
        if one.surface == "floor":
            out = table.axis.copy()
        else:
            side = np.where(self.loads.side[rows] != 0, self.loads.side[rows], _STATED.get(one.cut or "", 0))
            hand = 1 if one.spindle == "cw" else -1
            out = np.where(side == 0, 1, -side * hand)[:, None] * left  # material left of travel: up milling with M3
        given = self.toolpath.surface_normal
        if given is not None:
            own = np.einsum("nij,nj->ni", table.R, given[rows])
            out = np.where(np.isfinite(own).all(axis=1, keepdims=True), own, out)
        return out

    def _find_entry(self, hole: HoleVisit) -> float:
        cutter = self.cell.tool.cutter
        tip = 0.0
        if cutter is not None and cutter.point_angle is not None:
            tip = 0.5 * cutter.diameter / math.tan(0.5 * cutter.point_angle)
        wanted = min(tip, hole.depth)
        for stroke in hole.strokes:
            if stroke.end >= wanted - 1e-12:
                axis = self.toolpath.axis[stroke.point]
                step = self.toolpath.position[stroke.point] - self.toolpath.position[max(stroke.point - 1, 0)]
                length = abs(float(step @ axis))
                back = (stroke.end - wanted) / length if length > 0 else 0.0
                return stroke.point - min(back, 1.0)
        return float(hole.deepest)

    def _locate_poses(self, index: Array) -> PoseCompliance:
        """Return a table of the poses at fractional toolpath indices (K,), K > 0."""
        joints = [self._interpolate_joints(float(i)) for i in index]
        q, external = (np.array([pair[n] for pair in joints]) for n in (0, 1))
        low = np.floor(index).astype(int)
        high, f = np.minimum(np.ceil(index).astype(int), len(self.toolpath) - 1), (index - low)[:, None]
        position = (1 - f) * self.toolpath.position[low] + f * self.toolpath.position[high]
        axis = interpolate_axis(self.toolpath.axis[low], self.toolpath.axis[high], f[:, 0])
        T = np.broadcast_to(self.arm.T_base_workpiece(external), (len(index), 4, 4))
        R = T[:, :3, :3]
        stance = self.arm.compute_configuration(q, external)
        state = self.law.evaluate(stance, np.einsum("nij,nj->ni", R, position) + T[:, :3, 3])
        shift = np.zeros((len(index), 3))
        if self.points.shift is not None:
            driven = self.arm.compute_tcp_in_workpiece(q, external)[:, :3, 3] - position  # inside of a move
            shift = np.where(f > 0.0, driven, self.points.shift[low])
        compliance = 1.0 / state.k
        by_joints = np.einsum("nij,nj,nkj->nik", state.J, compliance, state.J)
        return PoseCompliance(
            axis=np.einsum("nij,nj->ni", R, axis),
            travel=np.einsum("nij,nj->ni", R, self.side[low]),
            R=R,
            place=position,
            J=state.J,
            joints=compliance,
            rest=state.small_load_compliance - by_joints,
            offset=np.einsum("nij,nj->ni", R, shift),
        )

    def _interpolate_joints(self, index: float) -> tuple[Array, Array]:
        """Return (6,) and (E,) joint positions at a fractional toolpath index."""
        row = round(index)
        if abs(index - row) < 1e-9:
            return self.points.q[row], self.points.external[row]
        at = self.motion.point[self.order]
        after = int(np.clip(np.searchsorted(at, index), 1, len(at) - 1))
        a, b = self.order[after - 1], self.order[after]
        span = self.motion.point[b] - self.motion.point[a]
        f = (index - self.motion.point[a]) / span if span > 0 else 1.0
        q = (1 - f) * self.motion.q[a] + f * self.motion.q[b]
        return q, (1 - f) * self.motion.external[a] + f * self.motion.external[b]

    def _draw_part(self, one: ProcessOperation, rng: np.random.Generator) -> Array:
        covariance = self.cell.workpiece.pose_covariance
        if covariance is None or one.tolerance.reference != "absolute":
            return np.zeros((DRAWS, 6))
        return rng.multivariate_normal(np.zeros(6), covariance, size=DRAWS, method="svd")

    def _move_part(self, place: Array, R: Array, part: Array) -> Array:
        """Return (D, 6) the twist of the tool relative to the part that a displaced part makes."""
        moved = part[:, :3] + np.cross(part[:, 3:], place)
        return -np.hstack([moved @ R.T, part[:, 3:] @ R.T])

    def _draw_tilt(self, one: ProcessOperation, rng: np.random.Generator) -> Array:
        accuracy = self.cell.accuracy
        angle = 0.0 if accuracy is None or one.tolerance.reference != "absolute" else accuracy.absolute_angle
        return (angle if np.isfinite(angle) else 0.0) * rng.standard_normal((DRAWS, 2))

"""Predicted errors of holes and milled points, recomputed pose by pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.process import CutSide, ProcessOperation
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.tall_products import multiply_tall
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.process.contact_load import compute_contact_wall_force
from machopt.verification.motion.process.draws import (
    DRAWS,
    SEED,
    draw_compliances,
    draw_load_factors,
    get_position_std,
)
from machopt.verification.motion.process.hole_strokes import HoleVisit
from machopt.verification.motion.process.mill_load import compute_wall_force
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel
from machopt.verification.tables.exported_tables import ExportedMotion, ExportedPoints

_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True, kw_only=True)
class PredictedErrors:
    """Errors of N points, SI; NaN where there is none."""

    along: Array
    across: Array
    normal: Array
    axis: Array
    size: Array  # (N,) m, length of the displacement
    p_in: Array


@dataclass(frozen=True, kw_only=True)
class _Pose:
    """One pose with its joint part and the rest of the compliance."""

    axis: Array  # (3,)
    travel: Array  # (3,)
    R: Array  # (3, 3) CAM axes in base_link
    place: Array  # (3,) m, programmed position in the CAM frame
    J: Array  # (6, 6)
    joints: Array  # (6,) compliance of the joints, rad/(N·m)
    rest: Array  # (6, 6) compliance of everything else at the TCP
    offset: Array  # (3,) m, compensation in base_link


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

    def add_holes(self, out: PredictedErrors) -> None:
        holes = [
            hole
            for hole in self.loads.holes
            if self.process.operations[hole.operation].tolerance.is_given and self.points.ok[hole.deepest]
        ]
        entry = self._locate_poses(np.array([self._find_entry(hole) for hole in holes]))
        bottom = self._locate_poses(np.array([float(hole.deepest) for hole in holes]))
        for hole, *poses in zip(holes, entry, bottom, strict=True):
            self._add_hole(hole, poses, out)

    def _add_hole(self, hole: HoleVisit, poses: list[_Pose], out: PredictedErrors) -> None:
        one = self.process.operations[hole.operation]
        strongest = max((s.point for s in hole.strokes), key=lambda p: self.loads.force[p, 2], default=hole.deepest)
        thrust, torque = float(self.loads.force[strongest, 2]), float(self.loads.moment[strongest])
        sideways = self.loads.force[strongest, :2]
        least = one.clamp or -math.inf  # without a foot the arm bears the thrust
        nominal = [_deflect(p, self.cell, max(thrust, least), torque, None, sideways)[0] for p in poses]
        row, entry, bottom = hole.deepest, nominal[0], nominal[1]
        e, axis = entry[:3] + poses[0].offset, poses[0].axis
        out.across[row] = np.linalg.norm(e - (e @ axis) * axis)
        out.along[row] = (bottom[:3] + poses[1].offset) @ poses[1].axis
        out.axis[row] = max(float(np.linalg.norm(np.cross(t[3:], p.axis))) for t, p in zip(nominal, poses, strict=True))
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
        poses: list[_Pose],
        load: tuple[float, float, Array],
        sigma: float,
        draws: _HoleDraws,
    ) -> float:
        thrust, torque, sideways = load
        wear, limits = 0.5 * (one.wear[0] + one.wear[1]), one.tolerance
        T, M = np.maximum(thrust / wear * draws.thrust, one.clamp or -math.inf), torque / wear * draws.torque
        good = np.ones(DRAWS, bool)
        for n, pose in enumerate(poses):
            twist = _deflect(pose, self.cell, T, M, self.compliances, (draws.thrust / wear)[:, None] * sideways)
            twist[:, :3] += pose.offset + sigma * draws.noise
            if draws.part.any():
                twist += self._move_part(pose, draws.part)
            x, y = _sideways(pose.axis)
            angle = np.hypot(twist[:, 3:] @ x + draws.tilt[:, 0], twist[:, 3:] @ y + draws.tilt[:, 1])
            good &= angle <= limits.axis
            if n == 0:
                good &= np.hypot(twist[:, :3] @ x, twist[:, :3] @ y) <= limits.position
            else:
                good &= np.abs(twist[:, :3] @ pose.axis) <= limits.depth
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
            contact = rng.standard_normal(DRAWS)
            poses = self._locate_poses(rows.astype(float))
            for row, pose in zip(rows.tolist(), poses, strict=True):
                spread = self.loads.contact_sigma[row]
                own = factor * np.exp(spread * contact) if spread else factor
                self._add_surface(one, row, pose, (own, part, noise), out)

    def _add_surface(
        self,
        one: ProcessOperation,
        row: int,
        pose: _Pose,
        drawn: tuple[Array, Array, Array],
        out: PredictedErrors,
    ) -> None:
        factor, part, noise = drawn
        normal = self._find_normal(one, row, pose)
        f = self.loads.arm_force[row]
        force = f[0] * pose.travel + f[1] * np.cross(pose.axis, pose.travel) + f[2] * pose.axis
        wrench = np.r_[force, self.loads.moment[row] * pose.axis]
        twist = _apply(pose, self.cell, wrench[None], None)[0]
        tool = self._bend_tool(one, row) * float(normal @ np.cross(pose.axis, pose.travel))
        out.size[row] = np.linalg.norm(twist[:3]) + abs(tool)
        cutter = self.cell.tool.cutter
        rounded = cutter is not None and cutter.corner > 0
        sigma = get_position_std(self.cell, one.tolerance.reference)
        stated = self.toolpath.surface_normal is not None and np.isfinite(self.toolpath.surface_normal[row]).all()
        known = stated or not (rounded or one.surface == "table")
        if known:
            out.normal[row] = normal @ (twist[:3] + pose.offset) + tool
        if self.compliances is None or not np.isfinite(sigma) or not known:
            return
        by_joint = (normal @ pose.J[:3]) * (wrench @ pose.J) * pose.joints  # error by each joint at nominal
        rest = float(normal @ twist[:3] - by_joint.sum()) + tool
        error = (self.compliances @ by_joint + rest) * factor + normal @ pose.offset + sigma * noise
        if part.any():
            error = error + self._move_part(pose, part)[:, :3] @ normal
        out.p_in[row] = float(np.mean(np.abs(error) <= one.tolerance.surface))

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

    def _find_normal(self, one: ProcessOperation, row: int, pose: _Pose) -> Array:
        """Return the outward normal of the surface: away from the material."""
        given = None if self.toolpath.surface_normal is None else self.toolpath.surface_normal[row]
        if given is not None and np.isfinite(given).all():
            return np.asarray(pose.R @ given)
        if one.surface == "floor":
            return pose.axis
        side = self.loads.side[row] or {"up": 1, "down": -1}.get(one.cut or "", 0)
        hand = 1 if one.spindle == "cw" else -1
        left = np.cross(pose.axis, pose.travel)
        return left if side == 0 else -side * hand * left  # material left of travel: up milling with M3

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

    def _locate_poses(self, index: Array) -> list[_Pose]:
        """Return the poses at fractional toolpath indices (K,)."""
        if not len(index):
            return []
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
            shift = (1 - f) * self.points.shift[low] + f * self.points.shift[high]
        compliance = 1.0 / state.k
        by_joints = np.einsum("nij,nj,nkj->nik", state.J, compliance, state.J)
        return [
            _Pose(
                axis=R[n] @ axis[n],
                travel=R[n] @ self.side[low[n]],
                R=R[n],
                place=position[n],
                J=state.J[n],
                joints=compliance[n],
                rest=state.small_load_compliance[n] - by_joints[n],
                offset=R[n] @ shift[n],
            )
            for n in range(len(index))
        ]

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

    def _move_part(self, pose: _Pose, part: Array) -> Array:
        """Return (D, 6) the twist of the tool relative to the part that a displaced part makes."""
        if not part.any():
            return np.zeros((1, 6))
        moved = part[:, :3] + np.cross(part[:, 3:], pose.place)
        return -np.hstack([moved @ pose.R.T, part[:, 3:] @ pose.R.T])

    def _draw_tilt(self, one: ProcessOperation, rng: np.random.Generator) -> Array:
        accuracy = self.cell.accuracy
        angle = 0.0 if accuracy is None or one.tolerance.reference != "absolute" else accuracy.absolute_angle
        return (angle if np.isfinite(angle) else 0.0) * rng.standard_normal((DRAWS, 2))


def _deflect(
    pose: _Pose, cell: Cell, thrust: Array | float, torque: Array | float, drawn: Array | None, sideways: Array
) -> Array:
    """Return (D, 6) the twist under thrust, torque about the tool axis, and forces along travel and normal."""
    thrust, torque, sideways = np.atleast_1d(thrust), np.atleast_1d(torque), np.atleast_2d(sideways)
    force = thrust[:, None] * pose.axis + sideways @ np.stack([pose.travel, np.cross(pose.axis, pose.travel)])
    wrench = np.hstack([force, torque[:, None] * pose.axis])
    return _apply(pose, cell, wrench, drawn)


def _apply(pose: _Pose, cell: Cell, wrench: Array, drawn: Array | None) -> Array:
    """Return (D, 6) the twist of the tool relative to the part under wrenches, with drawn relative compliances."""
    bent = multiply_tall(wrench, pose.J)
    bent *= pose.joints
    if drawn is not None:
        bent = bent * drawn
    twist = multiply_tall(bent, pose.J.T) + multiply_tall(wrench, pose.rest.T)
    if cell.workpiece.stiffness is not None:
        twist[:, :3] += ((wrench[:, :3] @ pose.R) / cell.workpiece.stiffness) @ pose.R.T
    return np.asarray(twist)


def _sideways(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors across an axis."""
    x = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x)

"""Price of a tolerance in the choice: ``objective: tolerance``.

The objective is lexicographic: the fewest points whose probability p is below the quantile q, then the mean shortfall
max(q − p, 0), then J. It is one number, so that the search over the grid and its bound hold as for J:

    J + FAILED_POINT_PRICE · (number of points with p < q) + SHORTFALL_PRICE · (mean shortfall)

The weights are so large that a point counts more than any shortfall, and a shortfall of 1e-3 more than J usually
differs. p is that of the configuration at the hole's deepest point or at the milled point, from common draws.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import CuttingProcess
from machopt.data_types.tolerance_prices import FAILED_POINT_PRICE, SHORTFALL_PRICE
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.normal_interval_probability import compute_interval_shares
from machopt.numerics.tall_products import multiply_tall
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.planning.error_probability.random_draws import UncertaintyDraws, build_draws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.toleranced_points import (
    HoleTargets,
    SurfaceTargets,
    compute_tip_length,
    list_hole_targets,
    list_surface_targets,
)
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath
from machopt.process.binding.job_binding import compute_loads
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear
from machopt.stiffness.arm_stiffness import ArmElasticity

DRAWS = 512
DAMPING = 1e-9  # of the step to the entry pose, near a singularity
BLOCK = 1024  # configurations at a time


@dataclass(frozen=True, kw_only=True)
class TolerancePricing:
    """Everything that the price of a configuration follows from."""

    process: CuttingProcess
    path: PlanningPath
    arm: PlanningArm
    elasticity: ArmElasticity
    directions: LoadDirections
    spread: StiffnessSpread
    draws: UncertaintyDraws
    holes: HoleTargets
    surfaces: SurfaceTargets
    loads: PointLoads
    travel: Array  # (P, 3) sideways direction of travel, in base_link
    is_compensated: bool

    @classmethod
    def build(
        cls,
        cell: Cell,
        toolpath: Toolpath,
        path: PlanningPath,
        arm: PlanningArm,
        elasticity: ArmElasticity,
        directions: LoadDirections,
        options: PlanOptions,
    ) -> TolerancePricing | None:
        """Return the pricing; None where the options do not ask for it or nothing has a tolerance.

        Args:
            cell: The cell with the tool and the process.
            toolpath: Toolpath of one tool.
            path: Its planning points.
            arm: Arm model.
            elasticity: Compliance model.
            directions: Directions and force per planning point.
            options: Planning options.
        """
        loads = compute_loads(cell, toolpath, toolpath.feed) if options.objective == "tolerance" else None
        if loads is None or cell.process is None:
            return None
        cutter = cell.tool.cutter
        holes = list_hole_targets(cell.process, toolpath, loads, compute_tip_length(cutter))
        surfaces = list_surface_targets(cell.process, toolpath, loads, cutter)
        if not len(holes.row) and not len(surfaces.row):
            return None
        spread = StiffnessSpread.build(elasticity, (cell.limits.lower[:6], cell.limits.upper[:6]))
        return cls(
            process=cell.process,
            path=path,
            arm=arm,
            elasticity=elasticity,
            directions=directions,
            spread=spread,
            draws=build_draws(spread, DRAWS),
            holes=holes,
            surfaces=surfaces,
            loads=loads,
            travel=arm.directions(path.external, compute_sideways_directions(path)),
            is_compensated=options.compensate,
        )

    def with_path(self, path: PlanningPath, directions: LoadDirections) -> TolerancePricing:
        """Return the pricing for other planning points of the same toolpath.

        Args:
            path: Planning points.
            directions: Directions and force per planning point.
        """
        travel = self.arm.directions(path.external, compute_sideways_directions(path))
        return replace(self, path=path, directions=directions, travel=travel)

    @property
    def count(self) -> int:
        """Number of points with a tolerance."""
        return len(self.holes.row) + len(self.surfaces.row)

    def price_grid(self, cell: Cell, candidates: CandidateGrid) -> Array:
        """Return the (S, R, B) price of every candidate, zero where its station has no tolerance.

        Args:
            cell: The cell.
            candidates: Candidate grid of the search.
        """
        out = np.zeros(candidates.usable.shape)
        stations = self.path.stations
        for is_hole, rows in ((True, self.holes.row), (False, self.surfaces.row)):
            nearest, target, weight = self._assign_stations(rows)
            for station, n, count in zip(nearest.tolist(), target.tolist(), weight.tolist(), strict=True):
                r, b = np.nonzero(candidates.usable[station])
                if not len(r):
                    continue
                points = np.full(len(r), stations[station])
                p = self.compute_probability(cell, is_hole, np.full(len(r), n), points, candidates.q[station, r, b])
                out[station, r, b] += count * self._price(p)
        return out

    def price_assignment(self, cell: Cell, q: Array) -> float:
        """Return the price of an assignment; a point without a configuration fails.

        Args:
            cell: The cell.
            q: (P, 6) rad, NaN where there is none.
        """
        total = 0.0
        for is_hole, rows in ((True, self.holes.row), (False, self.surfaces.row)):
            points = np.searchsorted(self.path.index, rows - 1e-6)
            known = np.isfinite(q[points]).all(axis=1)
            p = np.zeros(len(rows))
            some = np.flatnonzero(known)
            p[some] = self.compute_probability(cell, is_hole, some, points[some], q[points[some]])
            total += float(np.sum(self._price(p)))
        return total

    def find_nearest_stations(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the stations nearest to some toolpath points.

        Args:
            rows: Toolpath points.
        """
        index = self.path.index[self.path.stations]
        after = np.clip(np.searchsorted(index, rows), 0, len(index) - 1)
        before = np.maximum(after - 1, 0)
        return np.where(np.abs(index[after] - rows) <= np.abs(rows - index[before]), after, before)

    def _assign_stations(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Return the stations nearest to some toolpath points: station, one of its targets, number of targets."""
        found = np.unique(self.find_nearest_stations(rows), return_index=True, return_counts=True)
        stations, first, count = found
        return stations.astype(np.intp), first.astype(np.intp), count.astype(np.intp)

    def _price(self, probability: Array) -> Array:
        short = np.maximum(self.process.quantile - probability, 0.0)
        return np.asarray(FAILED_POINT_PRICE * (short > 0) + SHORTFALL_PRICE / self.count * short)

    def compute_probability(
        self, cell: Cell, is_hole: bool, target: NDArray[np.intp], points: NDArray[np.intp], q: Array
    ) -> Array:
        """Return (M,) the probability that the tolerances of a target hold in a configuration.

        Args:
            cell: The cell.
            is_hole: Whether the targets are holes.
            target: (M,) index of the hole or milled point.
            points: (M,) planning point.
            q: (M, 6) rad.
        """
        out = np.empty(len(q))
        compute = self._compute_hole_probability if is_hole else self._compute_surface_probability
        for first in range(0, len(q), BLOCK):
            some = slice(first, first + BLOCK)
            out[some] = compute(cell, target[some], points[some], q[some])
        return out

    def _compute_columns(self, cell: Cell, points: NDArray[np.intp], q: Array, wrench: Array) -> Array:
        """Return (M, 6, 1 + R) twists of the tool relative to the part under a load."""
        external = None if self.directions.beside is None else self.directions.beside[points]
        elastic = self.directions.elastic(self.elasticity, q, points)
        out = self.spread.compute_columns(elastic, q, wrench, external)
        part = cell.workpiece.stiffness
        if part is not None:
            R = self._list_cam_axes(points)
            pressed = np.einsum("mij,mi->mj", R, wrench[:, :3]) / part
            out[:, :3, 0] += np.einsum("mij,mj->mi", R, pressed)
        return out

    def _list_cam_axes(self, points: NDArray[np.intp]) -> Array:
        """Return (M, 3, 3) the CAM axes in base_link as columns."""
        external = self.path.external[points]
        axes = [self.arm.directions(external, np.tile(e, (len(points), 1))) for e in np.eye(3)]
        return np.stack(axes, axis=-1)

    def _compute_hole_probability(
        self, cell: Cell, target: NDArray[np.intp], points: NDArray[np.intp], q: Array
    ) -> Array:
        """Return (M,) the share of draws in which a hole is in tolerance: position at entry, depth and axis at exit."""
        axis = self.directions.axial[points]
        sideways = _build_sideways(axis)
        limits = [self.process.operations[k].tolerance for k in self.holes.operation[target]]
        position, depth, angle = (
            np.array([[getattr(t, name)] for t in limits]) for name in ("position", "depth", "axis")
        )
        entry = bottom = None
        if np.isfinite(position).any():
            entry = self._compute_hole_columns(cell, points, self._shift_to_entry(target, points, q))
        if np.isfinite(depth).any() or np.isfinite(angle).any():
            bottom = self._compute_hole_columns(cell, points, q)
        std = self._find_position_std(cell, target, self.holes)[:, None]
        out = np.empty(len(q))
        loads = np.stack([self.holes.operation[target], self.holes.thrust[target], self.holes.torque[target]], axis=1)
        kinds, which = np.unique(loads, axis=0, return_inverse=True)
        for k, (operation, thrust, torque) in enumerate(kinds):
            mine = np.flatnonzero(which.reshape(-1) == k)
            factors, nominal = self._draw_hole_loads(int(operation), float(thrust), float(torque))
            good = np.ones((len(mine), len(self.draws)), bool)
            if entry is not None:
                rows = [_join_rows(entry, e, 0, mine) for e in sideways]
                drawn = (multiply_tall(row, factors) - row @ nominal for row in rows)
                x, y = (e + std[mine] * self.draws.position[:, n] for n, e in enumerate(drawn))
                good &= x * x + y * y <= position[mine] ** 2
            if bottom is not None:
                row = _join_rows(bottom, axis, 0, mine)
                along = multiply_tall(row, factors) + std[mine] * self.draws.position[:, 2] - row @ nominal
                good &= np.abs(along) <= depth[mine]
                x, y = (multiply_tall(_join_rows(bottom, e, 3, mine), factors) for e in sideways)
                good &= x * x + y * y <= angle[mine] ** 2
            out[mine] = np.mean(good, axis=1)
        return out

    def _compute_hole_columns(self, cell: Cell, points: NDArray[np.intp], q: Array) -> tuple[Array, Array]:
        """Return (M, 6, 1 + R) twists by a unit force along the axis and by a unit moment about it."""
        axis = self.directions.axial[points]
        zero = np.zeros_like(axis)
        return (
            self._compute_columns(cell, points, q, np.hstack([axis, zero])),
            self._compute_columns(cell, points, q, np.hstack([zero, axis])),
        )

    def _shift_to_entry(self, target: NDArray[np.intp], points: NDArray[np.intp], q: Array) -> Array:
        """Return (M, 6) the joints at the entry pose, to first order from those at the bottom of the hole."""
        back = (self.holes.exit - self.holes.entry)[target]
        rows = self.holes.row[target]
        length = np.linalg.norm(self.path.position[points] - self.path.position[np.maximum(points - 1, 0)], axis=1)
        span = self.path.index[points] - self.path.index[np.maximum(points - 1, 0)]
        per_index = np.where(span > 0, length / np.where(span > 0, span, 1.0), 0.0)
        distance = np.where(rows > 0, back * per_index, 0.0)
        J = self.directions.elastic(self.elasticity, q, points).state.J
        step = np.zeros((len(q), 6))
        step[:, :3] = distance[:, None] * self.directions.axial[points]
        damped = np.swapaxes(J, 1, 2) @ J + DAMPING * np.eye(6)
        return np.asarray(q + np.linalg.solve(damped, np.einsum("mci,mc->mi", J, step)[..., None])[..., 0])

    def _draw_hole_loads(self, operation: int, thrust: float, torque: float) -> tuple[Array, Array]:
        """Return (2 + 2R, D) factors of the columns by a unit thrust and a unit torque, and (2 + 2R, 1) of what is
        compensated.
        """
        one, g = self.process.operations[operation], self.draws.stiffness
        wear, clamp = compute_mean_wear(one), one.clamp or -np.inf
        thrusts = np.maximum(thrust / wear * self.draws.compute_load_factor(self.process, one), clamp)
        torques = torque / wear * self.draws.compute_load_factor(self.process, one, torque=True)
        nominal = np.zeros((2 * g.shape[1], 1))
        if self.is_compensated:
            nominal[0], nominal[g.shape[1]] = max(thrust, clamp), torque
        return np.concatenate([(thrusts[:, None] * g).T, (torques[:, None] * g).T]), nominal

    def _compute_surface_probability(
        self, cell: Cell, target: NDArray[np.intp], points: NDArray[np.intp], q: Array
    ) -> Array:
        axis, travel = self.directions.axial[points], self.travel[points]
        normal = np.cross(axis, travel)
        rows = self.surfaces.row[target]
        f = self.loads.arm_force[rows]
        force = f[:, :1] * travel + f[:, 1:2] * normal + f[:, 2:] * axis
        wrench = np.hstack([force, self.loads.moment[rows, None] * axis])
        columns = self._compute_columns(cell, points, q, wrench)
        outward = self.surfaces.choose_normal(target, self._list_cam_axes(points), axis, normal)
        row = np.einsum("mi,mir->mr", outward, columns[:, :3])
        factor = np.ones((len(target), len(self.draws)))
        for k in np.unique(self.surfaces.operation[target]):
            one = self.process.operations[k]
            factor[self.surfaces.operation[target] == k] = self.draws.compute_load_factor(
                self.process, one
            ) / compute_mean_wear(one)
        contact = self.loads.contact_sigma[rows, None]
        if contact.any():
            factor = factor * np.exp(contact * self.draws.scatter)
        error = factor * (multiply_tall(row, self.draws.stiffness.T))
        if self.is_compensated:
            error = error - row[:, :1]
        limit = np.array([self.process.operations[k].tolerance.surface for k in self.surfaces.operation[target]])
        std = np.maximum(self._find_position_std(cell, target, self.surfaces), 1e-9)
        return compute_interval_shares(error, limit, std)

    def _find_position_std(self, cell: Cell, target: NDArray[np.intp], targets: HoleTargets | SurfaceTargets) -> Array:
        """Return (M,) 1 sigma of a coordinate in m; zero where none is stated."""
        found = self.elasticity.stiffness.position
        absolute = 0.0 if cell.accuracy is None else float(np.nan_to_num(cell.accuracy.absolute))
        if found is not None:
            absolute = found.std if cell.kinematics is not None else found.plain
        relative = 0.0 if cell.accuracy is None else float(np.nan_to_num(cell.accuracy.repeatability))
        references = [self.process.operations[k].tolerance.reference for k in targets.operation[target]]
        return np.array([absolute if word == "absolute" else relative for word in references])


def _join_rows(columns: tuple[Array, Array], direction: Array, first: int, some: NDArray[np.intp]) -> Array:
    """Return (m, 2 + 2R) twists along a direction by a unit thrust and a unit torque.

    Args:
        columns: (M, 6, 1 + R) twists by either.
        direction: (M, 3) unit.
        first: 0 for displacement and 3 for rotation.
        some: (m,) which of them.
    """
    rows = [np.einsum("mi,mir->mr", direction[some], c[some, first : first + 3]) for c in columns]
    return np.concatenate(rows, axis=1)


def _build_sideways(axis: Array) -> tuple[Array, Array]:
    """Return two unit vectors across each axis, (M, 3) each."""
    helper = np.where(np.abs(axis[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    x = np.cross(axis, helper)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return x, np.cross(axis, x)

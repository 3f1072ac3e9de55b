"""Published heuristics for measurement poses, on the same robot with the same loads, for comparison.

- random: any pose that is reachable and can be loaded.
- dumas2011 (section 3): zones of joints 2 and 3 with good dexterity (joint 1 at zero, the wrist at 45°), the
half of their
  poses with the least influence of K_C, loads with a clearly measurable deflection.
- zhang2025 (section 3): any pose with KCI > 0.45.
- jiao2022 (sections 2.2, 5.1): the eight corners and the centre of a cube, with tool axes along its edges and
tilted by
  ±10° about the tool's y axis.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from machopt.kinematics.inverse.solver import build_solver, list_whole_turns
from machopt.measurement.design.design_problem import DesignProblem
from machopt.measurement.design.load_cases import LoadCases
from machopt.measurement.design.pose_candidates import PosePool, PoseScreen, screen_given_poses
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.rigid_transforms import build_transform, compute_axis_rotation, invert_transform
from machopt.stiffness.kinetostatic_indices import compute_conditioning_index

ZHANG = 0.45  # KCI above which zhang2025 measures
MAP = 41  # angles of joints 2 and 3 on the dexterity map
BEST = 1 / 3  # share of the map with good dexterity (light areas of dumas2011 fig. 3)
CUBES = (0.6, 0.3)  # m, edges of jiao2022's cubes, the larger one if reachable
TILT = np.radians(10.0)
CENTRES = 24  # poses of the pool tried as the centre of the cube


@dataclass(frozen=True)
class HeuristicPosePool:
    """Poses that a heuristic selects from, and its preference of loads."""

    name: str
    poses: Ints  # indices into its pool
    prefers_large_loads: bool = False  # only loads with at least the median deflection of the pose


def draw_heuristic_design(
    chooser: HeuristicPosePool,
    problem: DesignProblem,
    cases: LoadCases,
    poses: int,
    loads: int,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], ...]:
    """Draw a random design among the poses and loads that a heuristic admits.

    Args:
        chooser: Heuristic with the same pool as ``problem`` and ``cases``.
        problem: Design problem: candidate readings and models.
        cases: Admissible load cases.
        poses: Number of poses; all if there are fewer.
        loads: Number of different loads at each pose.
        rng: Random generator.

    Returns:
        Indices of readings, one tuple per pose.
    """
    start = np.searchsorted(cases.pose, chooser.poses)
    stop = np.searchsorted(cases.pose, chooser.poses, side="right")
    picked = rng.permutation(np.flatnonzero(stop > start))[:poses]
    blocks = []
    for i in picked:
        readings = np.arange(start[i], stop[i])
        if chooser.prefers_large_loads:
            size = np.linalg.norm(cases.twist[readings, :3], axis=1)
            readings = readings[size >= np.median(size)]
        blocks.append(tuple(int(n) for n in rng.permutation(readings)[:loads]))
    return tuple(blocks)


def build_random_heuristic(pool: PosePool) -> HeuristicPosePool:
    """Build the heuristic of random poses.

    Args:
        pool: Candidate poses.

    Returns:
        All accepted poses.
    """
    return HeuristicPosePool("random", np.arange(len(pool)))


def build_zhang2025_heuristic(pool: PosePool) -> HeuristicPosePool:
    """Build the heuristic of zhang2025: poses with KCI above 0.45.

    Args:
        pool: Candidate poses.

    Returns:
        The poses.
    """
    return HeuristicPosePool("zhang2025", np.flatnonzero(pool.kci > ZHANG))


def build_dumas2011_heuristic(
    pool: PosePool, cases: LoadCases, screen: PoseScreen, limits: tuple[Array, Array]
) -> HeuristicPosePool:
    """Build the heuristic of dumas2011: zones of good dexterity of joints 2 and 3, the half of their poses with least
    ν_p.

    Args:
        pool: Candidate poses.
        cases: Admissible load cases.
        screen: Screening of poses.
        limits: Lower and upper joint limits, each (6,) rad.

    Returns:
        The poses.
    """
    axes = [np.linspace(limits[0][j], limits[1][j], MAP) for j in (1, 2)]
    q = np.zeros((MAP, MAP, 6))
    q[..., 1], q[..., 2] = np.meshgrid(*axes, indexing="ij")
    q[..., 3:] = np.pi / 4
    zone_map = compute_conditioning_index(screen.robot.compute_fk_jacobian(q, screen.T_flange_tcp)[1], screen.length)
    good = zone_map >= np.quantile(zone_map, 1 - BEST)
    cell = [
        np.clip(np.rint((pool.q[:, j] - axes[n][0]) / (axes[n][1] - axes[n][0])).astype(int), 0, MAP - 1)
        for n, j in enumerate((1, 2))
    ]
    count = np.bincount(cases.pose, minlength=len(pool))
    nu_p = np.bincount(cases.pose, cases.nu_p, minlength=len(pool)) / np.maximum(count, 1)
    zone = np.flatnonzero(good[cell[0], cell[1]] & (count > 0))
    if not len(zone):
        return HeuristicPosePool("dumas2011", zone, prefers_large_loads=True)
    return HeuristicPosePool("dumas2011", zone[nu_p[zone] <= np.median(nu_p[zone])], prefers_large_loads=True)


def build_jiao2022_poses(
    screen: PoseScreen, pool: PosePool, limits: tuple[Array, Array], rng: np.random.Generator
) -> PosePool:
    """Build the 27 poses of the cube of jiao2022 at the position with most reachable poses.

    In the paper the cube is located at the job.

    Args:
        screen: Screening of poses.
        pool: Candidate poses.
        limits: Lower and upper joint limits, each (6,) rad.
        rng: Random generator.

    Returns:
        The accepted ones of the 27 poses.
    """
    best: PosePool | None = None
    for edge in CUBES:
        for n in rng.permutation(len(pool))[:CENTRES]:
            q = _find_reachable_configurations(screen, _build_cube_poses(pool.T_base_tcp[n], edge), limits, pool.q[n])
            if best is not None and len(q) <= len(best):
                continue
            found = screen_given_poses(screen, q)
            if best is None or len(found) > len(best):
                best = found
        if best is not None and len(best) == 27:
            break
    return best if best is not None else screen_given_poses(screen, np.zeros((0, 6)))


def _build_cube_poses(T_centre: Array, edge: float) -> Array:
    """Return nine positions with three orientations (27, 4, 4)."""
    nearest = _find_nearest_axis_rotation(T_centre[:3, :3])
    attitudes = nearest @ compute_axis_rotation(np.array([0.0, 1.0, 0.0]), np.array([0.0, TILT, -TILT]))
    corners = [np.array(c) * edge / 2 for c in itertools.product((-1, 1), repeat=3)]
    return np.stack([build_transform(R, T_centre[:3, 3] + c) for c in (np.zeros(3), *corners) for R in attitudes])


def _find_nearest_axis_rotation(R: Array) -> Array:
    """Return the closest to R of the 24 axis-aligned rotations."""
    best, out = -np.inf, np.eye(3)  # the score is the cosine of the angle between both, up to constants
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            S = np.eye(3)[:, order] * np.array(signs)
            if np.linalg.det(S) > 0 and (score := float(np.trace(S.T @ R))) > best:
                best, out = score, S
    return out


def _find_reachable_configurations(
    screen: PoseScreen, T_base_tcp: Array, limits: tuple[Array, Array], near: Array
) -> Array:
    """Return one configuration (M, 6) per reachable pose, the closest to ``near`` within the limits."""
    branches = build_solver(screen.robot).solve(T_base_tcp @ invert_transform(screen.T_flange_tcp)).q
    q = branches[:, :, None, :] + list_whole_turns(limits[0], limits[1])
    q = q.reshape(len(q), -1, 6)
    margin = screen.criteria.limit_margin
    with np.errstate(invalid="ignore"):
        inside = ((q >= limits[0] + margin) & (q <= limits[1] - margin)).all(axis=-1)
    way = np.where(inside, np.nan_to_num(np.abs(q - near).max(axis=-1), nan=np.inf), np.inf)
    pick = way.argmin(axis=1)
    reached = np.isfinite(way[np.arange(len(q)), pick])
    return np.asarray(q[np.arange(len(q)), pick][reached])

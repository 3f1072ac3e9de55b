"""Planning setup of a cell, and common types of the steps: stage timings, scored assignment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.collision.collision_model_cache import load_collision_model
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError
from machopt.kinematics.encoder_corrections import EncoderCorrection, build_encoder_correction
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.machine import Machine, load_machine
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain, load_masses
from machopt.numerics.array_types import Array
from machopt.planning.cost.lost_feed_time import ArmDrives
from machopt.planning.cost.objective import PlanObjective
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stability.stability_limit import StabilityLimit
from machopt.planning.stations.planning_path import PlanningPath
from machopt.stiffness.arm_stiffness import ArmElasticity

LENGTH = 0.5  # m of a sliding joint equivalent to one rad of travel: about an arm's link
UPRIGHT = np.cos(np.radians(0.1))  # tolerance of a joint axis to the vertical
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class PlanningSetup:
    """Models of a cell that the planning steps use.

    All configurations of a plan are true angles, the actual pose of the arm. The encoder angles differ where the cell
    has
    kinematic corrections. :mod:`machopt.planning.motion.trajectory_builder` converts to them, and exports contain
    encoder angles.
    """

    cell: Cell  # as written: home and limits are encoder angles
    robot: Robot
    arm: PlanningArm
    elasticity: ArmElasticity
    collision: CollisionModel | None
    correction: EncoderCorrection | None = None  # from encoder to true angles; None: they are the same

    @property
    def per_rad(self) -> Array:
        """(6 + E,) factor from each joint to equivalent rad of travel; :data:`LENGTH` of a sliding joint is one rad."""
        lengths = np.array(self.cell.external_prismatic, bool)
        return np.concatenate([np.ones(6), np.where(lengths, 1.0 / LENGTH, 1.0)])

    @property
    def velocity(self) -> Array:
        """(6 + E,) velocity limits of the machine in equivalent rad/s (:attr:`per_rad`)."""
        return np.asarray(self.cell.limits.velocity * self.per_rad)

    def in_rad(self, path: PlanningPath, q: Array) -> Array:
        """Return (P, 6 + E) machine joints along a path, in equivalent rad.

        Args:
            path: planning points with the external joints.
            q: (P, 6) rad, joints of the arm.
        """
        return np.asarray(path.whole(q) * self.per_rad)

    @property
    def ball_radius(self) -> float:
        """Radius of the cutter in m where it is a ball, which may tilt; else 0."""
        cutter = self.cell.tool.cutter
        return cutter.corner if cutter is not None and cutter.is_ball else 0.0

    @property
    def drives(self) -> ArmDrives:
        """The arm and the limits of its drives."""
        return ArmDrives(self.arm, self.robot, self.cell.limits)

    @property
    def driven(self) -> Cell:
        """The cell with home and position limits as true angles."""
        return convert_to_true_angles(self.cell, self.correction)


@dataclass(frozen=True)
class ScoredAssignment:
    """An assignment with its cost at every planning point and its objective."""

    assignment: JointAssignment
    cost: Array  # (P,) in the unit of the index, NaN where infeasible
    objective: PlanObjective


@dataclass
class StageTimings:
    """Seconds per stage, in the order of first use."""

    seconds: dict[str, float] = field(default_factory=dict)
    progress: Progress = lambda _: None
    _current: str | None = None
    _since: float = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the block as one stage.

        Args:
            name: name of the stage, passed to ``progress``.
        """
        self.progress(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def switch(self, name: str | None) -> None:
        """Start the next of several consecutive stages.

        Args:
            name: name of the stage; None ends the last one.
        """
        now = time.perf_counter()
        if self._current is not None:
            self.seconds[self._current] = self.seconds.get(self._current, 0.0) + now - self._since
        if name is not None and name != self._current:
            self.progress(name)
        self._current, self._since = name, now


def prepare_planning(cell: Cell, options: PlanOptions, toolpath: Toolpath | None = None) -> PlanningSetup:
    """Build robot, inverse kinematics, stiffness and collision model of a cell.

    Args:
        cell: robot cell.
        options: plan options.
        toolpath: toolpath of one tool, for ``min_stability_ratio``; None: no limit of stability.

    Raises:
        InputError: the cell lacks what planning needs (a stiffness), or uses what is not supported.
    """
    if cell.stiffness is None:
        raise CellError(
            "the cell names no stiffness file; optimise needs joint stiffness "
            "(cell key 'stiffness', e.g. from machopt identify)",
            file=cell.folder / "cell.yaml",
            where="stiffness",
        )
    robot, shapes = load_chain(cell)
    correction = build_encoder_correction(cell.kinematics)
    driven = convert_to_true_angles(cell, correction)
    machine = load_machine(cell, robot)
    _refuse_tilting(cell, machine)
    arm = PlanningArm.build(driven, build_solver(robot), machine, options)
    elasticity = ArmElasticity(
        robot,
        cell.tool.T_flange_tcp,
        cell.stiffness,
        (cell.limits.lower[:6], cell.limits.upper[:6]),
        load_masses(cell),
        counted=True,
    )
    if toolpath is not None:
        stability = StabilityLimit.build(cell, toolpath, arm, robot, elasticity, options)
        arm = replace(arm, stability=stability)
    collision = load_collision_model(driven, robot, shapes, options.clearance) if options.collision else None
    return PlanningSetup(
        cell=cell, robot=robot, arm=arm, elasticity=elasticity, collision=collision, correction=correction
    )


def _refuse_tilting(cell: Cell, machine: Machine) -> None:
    """Refuse a base that an external joint tilts: gravity is modelled for one attitude of the base."""
    up = cell.T_world_base[2, :3]  # in base_link
    for k in range(machine.positioner, machine.external_count):
        if not machine.slides[k] and abs(machine.axis[k] @ up) < UPRIGHT:
            raise CellError(
                f"joint {cell.external_joints[machine.column[k] - 6]!r} tilts the robot's base, and its weight is "
                "reckoned with in one attitude; a joint that slides or turns about the vertical would work",
                file=cell.folder / "cell.yaml",
                where="robot.external_joints",
            )


def fix_external_axes(path: PlanningPath, external: Array) -> PlanningPath:
    """Return the path with given external joints.

    Args:
        path: planning points.
        external: (E,) or (P, E) m or rad.
    """
    return replace(path, external=np.array(np.broadcast_to(external, (len(path.index), np.shape(external)[-1]))))


def convert_to_true_angles(cell: Cell, correction: EncoderCorrection | None) -> Cell:
    """Return the cell with home and position limits as true angles.

    Args:
        cell: cell with encoder angles.
        correction: from encoder to true angles; None: they are equal.
    """
    if correction is None:
        return cell
    return replace(
        cell, home=correction.compute_true_angles(cell.home), limits=correction.compute_true_limits(cell.limits)
    )

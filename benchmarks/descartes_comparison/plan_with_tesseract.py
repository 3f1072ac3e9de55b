"""Plan the runs of a job with Tesseract's Descartes planner: ``python plan_with_tesseract.py FOLDER VARIANT``.

FOLDER holds the scene that ``scene.py`` writes and ``job.npz``. VARIANT: ``shipped`` (the default profile of the
package, edges by joint travel), ``wrapped`` (the same through a sampler in Python, to know what that costs) or
``stiffness`` (this sampler adds machopt's index of each configuration as its cost). Writes ``VARIANT.npz``: the joints,
and the processor seconds of set-up and of planning.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tesseract_robotics.tesseract_command_language as language
import tesseract_robotics.tesseract_motion_planners_descartes as descartes
from scene import GROUP, IK, ROOT, TCP
from tesseract_robotics.tesseract_common import FilesystemPath, GeneralResourceLocator, Isometry3d, ManipulatorInfo
from tesseract_robotics.tesseract_environment import Environment
from tesseract_robotics.tesseract_motion_planners import PlannerRequest

from machopt.numerics.array_types import Array

NAMESPACE = "DescartesMotionPlannerTask"
Cost = Callable[[int, Array], Array]  # point, (M, 6) rad → (M,)


def load_environment(folder: Path) -> Any:
    """Return the environment of a scene."""
    environment = Environment()
    files = (FilesystemPath(str(folder / name)) for name in ("cell.urdf", "cell.srdf"))
    if not environment.init(*files, GeneralResourceLocator()):
        raise RuntimeError("Tesseract does not read the scene")
    return environment


def build_profile(step: float, clearance: float) -> Any:
    """Return the default profile with a free rotation about the tool axis.

    Args:
        step: rad between two rotations.
        clearance: m.
    """
    profile = descartes.DescartesDefaultMoveProfileD()
    profile.target_pose_fixed = False
    profile.target_pose_sample_axis = np.array([0.0, 0.0, 1.0])
    profile.target_pose_sample_resolution = step
    profile.target_pose_sample_min = -np.pi
    profile.target_pose_sample_max = np.pi - step
    profile.manipulator_ik_solver = IK
    profile.enable_collision = True
    profile.vertex_contact_manager_config.default_margin = clearance
    return profile


class _PricedSampler(descartes.DescartesWaypointSamplerD):  # type: ignore[misc]
    """Adds the cost of each sample of another sampler."""

    def __init__(self, inner: Any, price: Callable[[Array], Array] | None) -> None:
        super().__init__()
        self.inner, self.price = inner, price

    def sample(self) -> list[Any]:
        samples = self.inner.sample()
        if self.price is None:
            return list(samples)
        cost = self.price(np.array([s.state.values for s in samples]))
        for s, c in zip(samples, cost.tolist(), strict=True):
            s.cost = c
        return list(samples)


class _PricedProfile(descartes.DescartesMoveProfileD):  # type: ignore[misc]
    """The default profile with priced samples; points come in the order of the program."""

    def __init__(self, inner: Any, cost: Cost | None) -> None:
        super().__init__()
        self.inner, self.cost, self.point, self.kept = inner, cost, 0, []  # type: ignore[var-annotated]

    def createWaypointSampler(self, *move: Any) -> Any:
        at, cost = self.point, self.cost
        self.point += 1
        sampler = _PricedSampler(
            self.inner.createWaypointSampler(*move), None if cost is None else lambda q: cost(at, q)
        )
        self.kept.append(sampler)
        return sampler

    def createEdgeEvaluator(self, *move: Any) -> Any:
        return self.inner.createEdgeEvaluator(*move)

    def createStateEvaluator(self, *move: Any) -> Any:
        return self.inner.createStateEvaluator(*move)


def build_request(environment: Any, poses: Array, profile: Any) -> Any:
    """Return a request for one run.

    Args:
        environment: environment of the scene.
        poses: (N, 4, 4) TCP at each point, in the root of the arm.
        profile: move profile.
    """
    info = ManipulatorInfo()
    info.manipulator, info.working_frame, info.tcp_frame, info.manipulator_ik_solver = GROUP, ROOT, TCP, IK
    program = language.CompositeInstruction(language.DEFAULT_PROFILE_KEY, info)
    for T in poses:
        waypoint = language.CartesianWaypointPoly_wrap_CartesianWaypoint(language.CartesianWaypoint(Isometry3d(T)))
        move = language.MoveInstruction(waypoint, language.MoveInstructionType_LINEAR, language.DEFAULT_PROFILE_KEY)
        program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
    profiles = language.ProfileDictionary()
    profiles.addProfile(NAMESPACE, language.DEFAULT_PROFILE_KEY, descartes.cast_DescartesMoveProfileD(profile))
    request = PlannerRequest()
    request.instructions, request.env, request.profiles = program, environment, profiles
    return request


def read_joints(results: Any) -> Array:
    """Return the (N, 6) joints of a response in rad."""
    out = []
    for instruction in results:
        waypoint = language.InstructionPoly_as_MoveInstructionPoly(instruction).getWaypoint()
        if waypoint.isStateWaypoint():
            out.append(language.WaypointPoly_as_StateWaypointPoly(waypoint).getPosition().flatten())
        elif waypoint.isJointWaypoint():
            out.append(language.WaypointPoly_as_JointWaypointPoly(waypoint).getPosition().flatten())
        else:
            cartesian = language.WaypointPoly_as_CartesianWaypointPoly(waypoint)
            out.append(np.asarray(cartesian.getSeed().position).flatten())
    return np.array(out)


def build_cost(folder: Path, points: Array) -> Cost:
    """Return machopt's index of configurations, in units of its scale times the share of path length of a point.

    Args:
        folder: holds ``job.npz``.
        points: (N,) planning points of the toolpath.
    """
    from machopt.cell.cell_reader import load_cell
    from machopt.options.plan_option_reader import load_options
    from machopt.planning.cost.stiffness_index import compute_configuration_cost, compute_load_directions, resolve_index
    from machopt.planning.pipeline.planning_setup import prepare_planning
    from machopt.planning.stations.planning_path import build_planning_path
    from machopt.toolpath.toolpath_reader import read_toolpath

    job = np.load(folder / "job.npz")
    cell = load_cell(Path(str(job["cell"])))
    options = load_options(cell.plan, None, ["collision=false"])
    setup = prepare_planning(cell, options)
    path = build_planning_path(read_toolpath(Path(str(job["toolpath"]))))
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    index, scale = resolve_index(options), job["weight"] / float(job["scale"])

    def cost(s: int, q: Array) -> Array:
        if not len(q):
            return np.empty(0)
        at = np.full(len(q), points[s])
        return np.asarray(scale[s] * compute_configuration_cost(setup.elasticity, d, at, q, index))

    cost(0, np.zeros((8, 6)))  # compiled before it is timed
    return cost


def main() -> None:
    folder, variant = Path(sys.argv[1]).resolve(), sys.argv[2]
    job = np.load(folder / "job.npz")
    start = time.process_time()
    environment = load_environment(folder)
    prepared = time.process_time() - start
    profile = build_profile(float(job["step"]), 0.0)
    cost = build_cost(folder, job["points"]) if variant == "stiffness" else None
    if variant != "shipped":
        profile = _PricedProfile(profile, cost)
    seconds, joints, failed = 0.0, [], []
    for first, end in job["runs"]:
        start = time.process_time()
        request = build_request(environment, job["poses"][first:end], profile)
        response = descartes.DescartesMotionPlannerD(NAMESPACE).solve(request)
        seconds += time.process_time() - start
        if response.successful:
            joints.append(read_joints(response.results))
        else:
            failed.append(response.message)
            joints.append(np.full((end - first, 6), np.nan))
    np.savez(folder / f"{variant}.npz", q=np.concatenate(joints), seconds=seconds, prepared=prepared, failed=failed)


if __name__ == "__main__":
    main()

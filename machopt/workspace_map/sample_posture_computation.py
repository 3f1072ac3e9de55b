"""Postures of a map's samples from its options: arm, settings, criterion, collisions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.collision.collision_model_cache import load_collision_model
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.errors import OptionError
from machopt.kinematics.inverse.solver import SingularityMargins, build_solver
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import LinkShape, Robot
from machopt.kinematics.urdf_loading import load_masses
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.stiffness.kinetostatic_indices import compute_characteristic_length
from machopt.workspace_map.branch_tracking import track_branches
from machopt.workspace_map.postures import (
    CollisionCheck,
    GoodnessFunction,
    MapPostures,
    ReachingArm,
    build_tool_poses,
    check_given_postures,
    choose_postures,
)
from machopt.workspace_map.quantities import (
    QUANTITIES,
    MapQuantity,
    MapSettings,
    list_quantities,
    select_default_criterion,
)
from machopt.workspace_map.request import MapOptions
from machopt.workspace_map.sample_grid import MapSamples


def build_reaching_arm(cell: Cell, robot: Robot, options: PlanOptions) -> ReachingArm:
    """Return kinematics, limits and margins of a cell.

    Args:
        cell: robot cell.
        robot: kinematic model.
        options: plan options with the margins.
    """
    return ReachingArm(
        robot=robot,
        solver=build_solver(robot),
        T_flange_tcp=cell.tool.T_flange_tcp,
        lower=cell.limits.lower[:6] + options.limit_margin,
        upper=cell.limits.upper[:6] - options.limit_margin,
        home=cell.home,
        margins=SingularityMargins(
            options.singularity_wrist, options.singularity_elbow, options.singularity_shoulder, options.limit_margin
        ),
    )


def build_map_settings(cell: Cell, robot: Robot, options: MapOptions) -> MapSettings:
    """Return the constant inputs of the quantities.

    Args:
        cell: robot cell.
        robot: kinematic model.
        options: map options.
    """
    tool = cell.tool.T_flange_tcp
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    elasticity = None
    if cell.stiffness is not None:
        elasticity = ArmElasticity(robot, tool, cell.stiffness, (lower, upper), load_masses(cell), counted=True)
    length = options.length or compute_characteristic_length(robot, tool).length
    frame, springs = options.T_base_frame[:3, :3], () if cell.stiffness is None else cell.stiffness.external
    external_compliance = ExternalJointCompliance.build(load_machine(cell, robot), springs) if springs else None
    return MapSettings(
        robot=robot,
        T_flange_tcp=tool,
        elasticity=elasticity,
        length=length,
        lower=lower,
        upper=upper,
        R_base_frame=frame,
        load=options.load,
        external_compliance=external_compliance,
        external=cell.external_home,
    )


def select_criterion(options: MapOptions, setting: MapSettings) -> MapQuantity:
    """Return the quantity by which postures are selected.

    Args:
        options: map options.
        setting: constant inputs of the quantities.

    Raises:
        InputError: the quantity needs a load or a stiffness that is missing.
    """
    key = options.by or select_default_criterion(setting)
    field = next(f for f in QUANTITIES if f.key == key)
    if field not in list_quantities(setting):
        missing_input = "--load-N or --wrench" if setting.elasticity is not None else "a cell with stiffness"
        raise OptionError(
            f"{key} needs {missing_input}; {', '.join(f.key for f in list_quantities(setting))} would work",
            where="--by",
        )
    return field


def build_goodness_function(criterion: MapQuantity, setting: MapSettings) -> GoodnessFunction:
    """Return the function that rates postures by a quantity; larger is better.

    Args:
        criterion: quantity.
        setting: constant inputs of the quantities.
    """

    def goodness(q: Array) -> Array:
        return criterion.compute_goodness(setting.evaluate_states(q))

    return goodness


def build_collision_check(
    cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...], plan: PlanOptions, options: MapOptions
) -> CollisionCheck | None:
    """Return the requested collision check: of the arm and its tool with themselves, or with the whole cell too.

    Args:
        cell: robot cell.
        robot: kinematic model.
        shapes: the URDF's collision shapes.
        plan: plan options with the clearance.
        options: map options.
    """
    if options.collision == "none":
        return None
    if options.collision == "self":
        part = replace(cell.workpiece, link="world", geometry=())
        cell = replace(cell, obstacles=(), workpiece=part)
    model = load_collision_model(cell, robot, shapes, plan.clearance, still=True)
    return lambda q: (
        model.check_configurations(q, np.ones(len(q), bool)).hit
    )  # the cutter may touch the workpiece everywhere


def compute_posture_layers(
    samples: MapSamples,
    arm: ReachingArm,
    cell: Cell,
    options: MapOptions,
    goodness: GoodnessFunction,
    collides: CollisionCheck | None,
) -> dict[str, MapPostures]:
    """Return the layers by name: "given" rotation, and "free" where the rotation may be chosen.

    Args:
        samples: samples of the map.
        arm: kinematics, limits, margins.
        cell: robot cell.
        options: map options.
        goodness: rating of postures, larger is better.
        collides: collision check; None: none.

    Raises:
        ValueError: samples have neither places nor postures.
    """
    if samples.q is not None:
        return {"given": check_given_postures(samples.q, cell.limits.lower[:6], cell.limits.upper[:6], collides)}
    if samples.position is None:
        raise ValueError("samples are places or postures")
    place = samples.position

    def poses(gamma: Array) -> Callable[[slice], Array]:
        return lambda part: options.T_base_frame @ build_tool_poses(place[part], options.tool_axis, gamma)

    out = {}
    for name, gamma in (("given", options.gamma[:1]), ("free", options.gamma)):
        if name == "free" and len(gamma) == 1:
            continue
        if samples.kind == "line":
            out[name] = track_branches(arm, poses(gamma)(slice(None)), gamma, goodness, options.pick, collides)
        else:
            size = (len(samples), len(gamma))
            out[name] = choose_postures(arm, poses(gamma), size, gamma, goodness, options.pick, collides)
    return out

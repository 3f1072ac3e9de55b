"""From what was asked of a map to the postures of its samples: arm, setting, criterion, collisions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.errors import InputError
from machopt.model.beside import Beside
from machopt.model.collision import CollisionModel
from machopt.model.elastic import ArmElasticity
from machopt.model.ik import Margins, solver_for
from machopt.model.kinetostatic import characteristic_length
from machopt.model.machine import load_machine
from machopt.model.robot import LinkShape, Robot, load_masses
from machopt.workspace.along import follow
from machopt.workspace.asked import MapOptions
from machopt.workspace.fields import FIELDS, Field, Setting, default_criterion, offered
from machopt.workspace.postures import (
    Collides,
    Goodness,
    Postures,
    ReachingArm,
    choose_postures,
    given_postures,
    tool_poses,
)
from machopt.workspace.samples import Samples


def arm_of(cell: Cell, robot: Robot, options: PlanOptions) -> ReachingArm:
    return ReachingArm(
        robot=robot,
        solver=solver_for(robot),
        T_flange_tcp=cell.tool.T_flange_tcp,
        lower=cell.limits.lower[:6] + options.limit_margin,
        upper=cell.limits.upper[:6] - options.limit_margin,
        home=cell.home,
        margins=Margins(
            options.singularity_wrist, options.singularity_elbow, options.singularity_shoulder, options.limit_margin
        ),
    )


def setting_of(cell: Cell, robot: Robot, options: MapOptions) -> Setting:
    tool = cell.tool.T_flange_tcp
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    elasticity = None
    if cell.stiffness is not None:
        elasticity = ArmElasticity(robot, tool, cell.stiffness, (lower, upper), load_masses(cell), counted=True)
    length = options.length or characteristic_length(robot, tool).length
    frame, springs = options.T_base_frame[:3, :3], () if cell.stiffness is None else cell.stiffness.external
    beside = Beside.of(load_machine(cell, robot), springs) if springs else None
    return Setting(
        robot=robot,
        T_flange_tcp=tool,
        elasticity=elasticity,
        length=length,
        lower=lower,
        upper=upper,
        R_base_frame=frame,
        load=options.load,
        beside=beside,
        external=cell.external_home,
    )


def criterion_of(options: MapOptions, setting: Setting) -> Field:
    key = options.by or default_criterion(setting)
    field = next(f for f in FIELDS if f.key == key)
    if field not in offered(setting):
        lacks = "--load-N or --wrench" if setting.elasticity is not None else "a cell with stiffness"
        raise InputError(f"{key} needs {lacks}; {', '.join(f.key for f in offered(setting))} would work", where="--by")
    return field


def goodness_of(criterion: Field, setting: Setting) -> Goodness:
    def goodness(q: Array) -> Array:
        return criterion.goodness(setting.at(q))

    return goodness


def collides_of(
    cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...], plan: PlanOptions, options: MapOptions
) -> Collides | None:
    """The collision check asked for: of the arm and its tool with themselves, or with the whole cell too."""
    if options.collision == "none":
        return None
    if options.collision == "self":
        part = replace(cell.workpiece, link="world", geometry=())
        cell = replace(cell, obstacles=(), workpiece=part)
    model = CollisionModel(cell, robot, shapes, plan.clearance, still=True)
    return lambda q: model.check(q, np.ones(len(q), bool)).hit  # the cutter may touch the workpiece


def postures_of(
    samples: Samples, arm: ReachingArm, cell: Cell, options: MapOptions, goodness: Goodness, collides: Collides | None
) -> dict[str, Postures]:
    """Layers by name: "given" rotation, and "free" where the rotation may be chosen."""
    if samples.q is not None:
        return {"given": given_postures(samples.q, cell.limits.lower[:6], cell.limits.upper[:6], collides)}
    if samples.position is None:
        raise ValueError("samples are places or postures")
    place = samples.position

    def poses(gamma: Array) -> Callable[[slice], Array]:
        return lambda part: options.T_base_frame @ tool_poses(place[part], options.tool_axis, gamma)

    out = {}
    for name, gamma in (("given", options.gamma[:1]), ("free", options.gamma)):
        if name == "free" and len(gamma) == 1:
            continue
        if samples.kind == "line":
            out[name] = follow(arm, poses(gamma)(slice(None)), gamma, goodness, options.pick, collides)
        else:
            size = (len(samples), len(gamma))
            out[name] = choose_postures(arm, poses(gamma), size, gamma, goodness, options.pick, collides)
    return out

"""``machopt map``: from a cell to stiffness and dexterity over a slice, a volume, a line or a joint plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.manifest import with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.results.maps import MapResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.fields import read_measured_stiffness, write_map_csv
from machopt.formats.options import load_options
from machopt.model.collision import CollisionModel
from machopt.model.elastic import ArmElasticity
from machopt.model.ik import Margins, solver_for
from machopt.model.kinetostatic import characteristic_length
from machopt.model.linkage import refuse_linked
from machopt.model.robot import LinkShape, Robot, load_chain, load_masses
from machopt.output import output_folder, write_result
from machopt.report.map_page import write_map_page
from machopt.report.map_svg import write_map_svg
from machopt.services.inputs import single
from machopt.services.manifest import write_command_manifest
from machopt.services.map_measured import compare
from machopt.services.map_page import page_data
from machopt.services.map_request import MapOptions, Request, resolve
from machopt.services.map_result import Layer, map_columns, map_json, places
from machopt.services.map_samples import build_samples
from machopt.workspace.along import follow
from machopt.workspace.fields import FIELDS, Field, Setting, default_criterion, evaluate, offered
from machopt.workspace.postures import Arm, Collides, Goodness, Postures, choose_postures, given_postures, tool_poses
from machopt.workspace.samples import Samples

Array = NDArray[np.float64]
_UNCHECKED = {"none": ("collisions NOT checked",), "self": (), "cell": ()}  # "self" is what a map means, not less

__all__ = ["Outcome", "Request", "run_map"]


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` is 0, or 3 where no sample has a posture."""

    exit_code: int
    result: MapResult
    report: Path
    message: str  # one sentence for the user


def run_map(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Map a cell.

    Writes ``map.csv`` (and ``map_free.csv`` where the rotation about the tool axis is free), ``map.json``,
    ``map.svg`` and ``report.html``. The same input gives the same bytes.

    Raises:
        InputError: bad cell, options, measured table or output folder.
    """
    with in_use(with_effects(request.effects)):
        return _mapped(request, progress)


def _mapped(request: Request, progress: Callable[[str], None]) -> Outcome:
    progress("load")
    cell = load_cell(request.cell, allow_external=request.allow_external)
    plan_options = load_options(cell.plan, request.plan_file, list(request.overrides))
    options = resolve(request, cell)
    measured = read_measured_stiffness(request.measured) if request.measured is not None else None
    progress("prepare")
    refuse_linked(cell, "map")
    robot, shapes = load_chain(cell)
    arm = _arm(cell, robot, plan_options)
    setting = _setting(cell, robot, options)
    criterion = _criterion(options, setting)
    if isinstance(options.pick, int) and options.pick >= arm.solver.branches:
        raise InputError(f"found branch {options.pick}; the arm has 0 to {arm.solver.branches - 1}", where="--pick")
    collides = _collides(cell, robot, shapes, plan_options, options)
    unchecked = _UNCHECKED[request.collision]
    with output_folder(request.out) as folder:
        progress("samples")
        samples = build_samples(cell, arm, options)
        progress("postures")
        chosen = _postures(samples, arm, cell, options, _goodness(criterion, setting), collides)
        progress("fields")
        layers = [Layer(name, postures, evaluate(setting, postures.q)) for name, postures in chosen.items()]
        comparison = None
        if measured is not None:
            comparison = compare(
                measured, request, options, arm, setting, criterion, places(samples, layers[0], options)
            )
        result, message = map_json(
            request, cell, plan_options, options, setting, samples, arm, layers, criterion, comparison
        )
        progress("report")
        for layer in layers:
            name = "map.csv" if layer is layers[0] else f"map_{layer.name}.csv"
            write_map_csv(folder / name, map_columns(samples, layer, options, layers[0], comparison))
        data = page_data(cell, options, setting, samples, arm, layers, criterion, comparison, result)
        write_map_page(folder / "report.html", data)
        write_map_svg(folder / "map.svg", data)
        write_result(folder / "map.json", result)
        read = [single(f, role) for f, role in ((request.measured, "measured"), (request.plan_file, "plan")) if f]
        read += [single(f, "effects") for f in request.effects]
        write_command_manifest(
            folder, "map", request, cell, verdict=message, exit_code=result.exit_code, inputs=read, unchecked=unchecked
        )
    reached = any(layer.postures.ok.any() for layer in layers)
    return Outcome(0 if reached else 3, result, request.out / "report.html", with_scope(message, unchecked))


def _arm(cell: Cell, robot: Robot, options: PlanOptions) -> Arm:
    return Arm(
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


def _setting(cell: Cell, robot: Robot, options: MapOptions) -> Setting:
    tool = cell.tool.T_flange_tcp
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    elasticity = None
    if cell.stiffness is not None:
        elasticity = ArmElasticity(robot, tool, cell.stiffness, (lower, upper), load_masses(cell))
    length = options.length or characteristic_length(robot, tool).length
    return Setting(robot, tool, elasticity, length, lower, upper, options.T_base_frame[:3, :3], options.load)


def _criterion(options: MapOptions, setting: Setting) -> Field:
    key = options.by or default_criterion(setting)
    field = next(f for f in FIELDS if f.key == key)
    if field not in offered(setting):
        lacks = "--force or --wrench" if setting.elasticity is not None else "a cell with stiffness"
        raise InputError(f"{key} needs {lacks}; {', '.join(f.key for f in offered(setting))} would work", where="--by")
    return field


def _goodness(criterion: Field, setting: Setting) -> Goodness:
    def goodness(q: Array) -> Array:
        return criterion.goodness(setting.at(q))

    return goodness


def _collides(
    cell: Cell, robot: Robot, shapes: tuple[LinkShape, ...], plan: PlanOptions, options: MapOptions
) -> Collides | None:
    """The collision check asked for: of the arm and its tool with themselves, or with the whole cell too."""
    if options.collision == "none":
        return None
    if options.collision == "self":
        part = replace(cell.workpiece, link="world", geometry=())
        cell = replace(cell, obstacles=(), workpiece=part)
    model = CollisionModel(cell, robot, shapes, plan.clearance)
    return lambda q: model.check(q, np.ones(len(q), bool)).hit  # the cutter may touch the workpiece


def _postures(
    samples: Samples, arm: Arm, cell: Cell, options: MapOptions, goodness: Goodness, collides: Collides | None
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

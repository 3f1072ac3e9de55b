"""``machopt map``: from a cell to stiffness and dexterity over a slice, a volume, a line or a joint plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.domain.manifest import with_scope
from machopt.domain.results.maps import MapResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.fields import read_measured_stiffness, write_map_csv
from machopt.formats.options import load_options
from machopt.model.linkage import refuse_linked
from machopt.model.robot import load_chain
from machopt.output import output_folder, write_result
from machopt.output.hashes import sha256_of
from machopt.report.gather.map import page_data
from machopt.report.map_page import write_map_page
from machopt.report.map_svg import write_map_svg
from machopt.services.inputs import input_hashes, single
from machopt.services.manifest import write_command_manifest
from machopt.services.map_columns import map_columns
from machopt.workspace.asked import Request, resolve
from machopt.workspace.fields import evaluate
from machopt.workspace.mapping import arm_of, collides_of, criterion_of, goodness_of, postures_of, setting_of
from machopt.workspace.measured import compare
from machopt.workspace.sampling import build_samples
from machopt.workspace.told import Layer, map_json, places

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
    arm = arm_of(cell, robot, plan_options)
    setting = setting_of(cell, robot, options)
    criterion = criterion_of(options, setting)
    if isinstance(options.pick, int) and options.pick >= arm.solver.branches:
        raise InputError(f"found branch {options.pick}; the arm has 0 to {arm.solver.branches - 1}", where="--pick")
    collides = collides_of(cell, robot, shapes, plan_options, options)
    unchecked = _UNCHECKED[request.collision]
    with output_folder(request.out) as folder:
        progress("samples")
        samples = build_samples(cell, arm, options)
        progress("postures")
        chosen = postures_of(samples, arm, cell, options, goodness_of(criterion, setting), collides)
        progress("fields")
        layers = [Layer(name, postures, evaluate(setting, postures.q)) for name, postures in chosen.items()]
        comparison = None
        if measured is not None:
            comparison = compare(
                measured, request, options, arm, setting, criterion, places(samples, layers[0], options)
            )
        files = input_hashes(cell)
        if request.measured is not None:
            files[request.measured.name] = sha256_of(request.measured)
        result, message = map_json(
            files, cell, plan_options, options, setting, samples, arm, layers, criterion, comparison
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

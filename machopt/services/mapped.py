"""A map in memory: everything that ``machopt map`` computes before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from machopt.domain.cell import Cell
from machopt.domain.manifest import with_scope
from machopt.domain.results.maps import MapResult
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.fields import read_measured_stiffness
from machopt.formats.options import load_options
from machopt.model.linkage import refuse_linked
from machopt.model.robot import load_chain
from machopt.output.hashes import sha256_of
from machopt.report.gather.map import page_data
from machopt.report.gather.scene import bodies_of, scene_of
from machopt.report.map_data import MapData
from machopt.services.inputs import input_hashes
from machopt.workspace.asked import MapOptions, MapRequest, resolve
from machopt.workspace.fields import evaluate
from machopt.workspace.mapping import arm_of, collides_of, criterion_of, goodness_of, postures_of, setting_of
from machopt.workspace.measured import Comparison, compare
from machopt.workspace.samples import Samples
from machopt.workspace.sampling import build_samples
from machopt.workspace.told import Layer, map_json, places

_UNCHECKED = {"none": ("collisions NOT checked",), "self": (), "cell": ()}  # "self" is what a map means, not less


@dataclass(frozen=True, kw_only=True)
class Mapped:
    """A map in memory: nothing of it is written yet."""

    request: MapRequest
    cell: Cell
    samples: Samples
    options: MapOptions
    layers: tuple[Layer, ...]  # the given rotation first
    comparison: Comparison | None
    page: MapData
    result: MapResult
    verdict: str

    @property
    def exit_code(self) -> int:
        return 0 if any(layer.postures.ok.any() for layer in self.layers) else 3

    @property
    def message(self) -> str:
        """One sentence, with what was not checked."""
        return with_scope(self.verdict, self.unchecked)

    @property
    def unchecked(self) -> tuple[str, ...]:
        return _UNCHECKED[self.request.collision]


def mapped(request: MapRequest, progress: Callable[[str], None], cell: Cell | None = None) -> Mapped:
    """The map.

    Args:
        request: what was asked; its ``out`` is not looked at.
        cell: where it has been read already.
    """
    progress("load")
    cell = load_cell(request.cell, allow_external=request.allow_external) if cell is None else cell
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
    progress("samples")
    samples = build_samples(cell, arm, options)
    progress("postures")
    chosen = postures_of(samples, arm, cell, options, goodness_of(criterion, setting), collides)
    progress("fields")
    layers = [Layer(name, postures, evaluate(setting, postures.q)) for name, postures in chosen.items()]
    comparison = None
    if measured is not None:
        comparison = compare(measured, request, options, arm, setting, criterion, places(samples, layers[0], options))
    files = input_hashes(cell)
    if request.measured is not None:
        files[request.measured.name] = sha256_of(request.measured)
    result, message = map_json(files, cell, plan_options, options, setting, samples, arm, layers, criterion, comparison)
    scene = scene_of(cell, robot, bodies_of(cell, robot, shapes))
    data = page_data(cell, options, setting, samples, arm, layers, criterion, comparison, result, scene)
    return Mapped(
        request=request,
        cell=cell,
        samples=samples,
        options=options,
        layers=tuple(layers),
        comparison=comparison,
        page=data,
        result=result,
        verdict=message,
    )

"""Computation of ``machopt map`` in memory, before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from machopt.cell.cell_reader import load_cell
from machopt.commands.input_hashes import compute_input_hashes
from machopt.commands.map.job_loading import add_job_quantities, read_job
from machopt.data_types.cell import Cell
from machopt.data_types.documents.map_document import MapDocument
from machopt.data_types.manifest import add_scope_to_verdict
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.urdf_loading import load_chain
from machopt.options.plan_option_reader import load_options
from machopt.output.file_hashes import compute_sha256
from machopt.output.tables.map_table import read_measured_stiffness
from machopt.report.page_data.machine_scene import build_bodies, build_machine_scene
from machopt.report.page_data.workspace_map import build_map_page_data
from machopt.report.page_types.workspace_map_page_data import MapPageData
from machopt.workspace_map.document import EvaluatedMap, MapLayerResult, build_map_document, compute_sample_positions
from machopt.workspace_map.measured_stiffness import MeasuredComparison, compare_with_measured
from machopt.workspace_map.quantity_evaluation import evaluate_quantities
from machopt.workspace_map.request import MapOptions, MapRequest, check_picked_branch, resolve_request
from machopt.workspace_map.sample_grid import MapSamples
from machopt.workspace_map.sample_posture_computation import (
    build_collision_check,
    build_goodness_function,
    build_map_settings,
    build_reaching_arm,
    compute_posture_layers,
    select_criterion,
)
from machopt.workspace_map.sample_ranges import build_samples

_UNCHECKED = {"none": ("collisions NOT checked",), "self": (), "cell": ()}  # "self" is what a map means, not less


@dataclass(frozen=True, kw_only=True)
class MapComputation:
    """Result of a map in memory, not written yet."""

    request: MapRequest
    cell: Cell
    samples: MapSamples
    options: MapOptions
    layers: tuple[MapLayerResult, ...]  # the given rotation first
    comparison: MeasuredComparison | None
    page: MapPageData
    result: MapDocument
    verdict: str

    @property
    def exit_code(self) -> int:
        return 0 if any(layer.postures.ok.any() for layer in self.layers) else 3

    @property
    def message(self) -> str:
        """One sentence, with what was not checked."""
        return add_scope_to_verdict(self.verdict, self.unchecked)

    @property
    def unchecked(self) -> tuple[str, ...]:
        return _UNCHECKED[self.request.collision]


def _compute_hashes(request: MapRequest, cell: Cell) -> dict[str, str]:
    """Return SHA-256 of the input files by name."""
    files = compute_input_hashes(cell)
    if request.measured is not None:
        files[request.measured.name] = compute_sha256(request.measured)
    if request.toolpath is not None:
        files[request.toolpath.name] = compute_sha256(request.toolpath)
    return files


def compute_map(request: MapRequest, progress: Callable[[str], None], cell: Cell | None = None) -> MapComputation:
    """Return the map.

    Args:
        request: The validated request; its ``out`` is not used.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.
    """
    progress("load")
    if cell is None:
        cell = load_cell(request.cell, allow_external=request.allow_external, process=request.process)
    job = None if request.toolpath is None else read_job(request.toolpath, cell)
    cell = cell if job is None else job.cell
    plan_options = load_options(cell.plan, request.plan_file, list(request.overrides))
    options = resolve_request(request, cell)
    measured = read_measured_stiffness(request.measured) if request.measured is not None else None
    progress("prepare")
    check_no_mimic_joints(cell, "map")
    robot, shapes = load_chain(cell)
    arm = build_reaching_arm(cell, robot, plan_options)
    setting = add_job_quantities(build_map_settings(cell, robot, options), cell, job)
    criterion = select_criterion(options, setting)
    check_picked_branch(options, arm.solver.branches)
    collides = build_collision_check(cell, robot, shapes, plan_options, options)
    progress("samples")
    samples = build_samples(cell, arm, options)
    progress("postures")
    chosen = compute_posture_layers(samples, arm, cell, options, build_goodness_function(criterion, setting), collides)
    progress("fields")
    layers = [MapLayerResult(name, layer, evaluate_quantities(setting, layer.q)) for name, layer in chosen.items()]
    comparison = None
    if measured is not None:
        comparison = compare_with_measured(
            measured, request, options, arm, setting, criterion, compute_sample_positions(samples, layers[0], options)
        )
    evaluated = EvaluatedMap(
        cell=cell,
        options=options,
        setting=setting,
        samples=samples,
        arm=arm,
        layers=layers,
        criterion=criterion,
        comparison=comparison,
    )
    result, message = build_map_document(evaluated, _compute_hashes(request, cell), plan_options)
    scene = build_machine_scene(cell, robot, build_bodies(cell, robot, shapes))
    return MapComputation(
        request=request,
        cell=cell,
        samples=samples,
        options=options,
        layers=tuple(layers),
        comparison=comparison,
        page=build_map_page_data(evaluated, result, scene),
        result=result,
        verdict=message,
    )

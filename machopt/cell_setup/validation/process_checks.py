"""Checks of the process file of a cell that need no toolpath: tools that fit, and what tolerances need."""

from __future__ import annotations

from collections.abc import Iterator

from machopt.data_types.cell import Cell, CutterGeometry
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.errors import CuttingInputError
from machopt.process.binding.cutting_tools import build_drilling_layers, build_drilling_tool, build_milling_cutter
from machopt.process.drilling.stroke_phases import build_drilling_stroke
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import MillingCut, check_cutter


def list_process_problems(cell: Cell) -> Iterator[tuple[str, str]]:
    """List where the process file does not fit its cell.

    Args:
        cell: The cell.

    Returns:
        Key of the file and what is wrong, of each problem.
    """
    process = cell.process
    if process is None:
        return
    cutters = [tool.cutter for tool in (cell.tools or {"": cell.tool}).values()]
    for one in process.operations:
        problems = [_find_problem(process, one, cutter) for cutter in cutters]
        if all(problems):
            yield f"operations.{one.label}", f"no tool of the cell fits: {problems[0]}"
    if not any(one.tolerance.is_given for one in process.operations):
        return
    stiffness = cell.stiffness
    if cell.accuracy is None and (stiffness is None or stiffness.position is None):
        yield "tolerance", "every outcome will be unknown: accuracy of cell.yaml is not stated"
    if stiffness is not None and stiffness.estimated:
        yield "tolerance", "every outcome will be unknown: the stiffness is estimated, not measured"


def _find_problem(process: CuttingProcess, one: ProcessOperation, cutter: CutterGeometry | None) -> str:
    """Return why a cutter cannot do an operation; empty where it can."""
    try:
        if one.kind == "milling":
            coefficients = process.materials[one.material].milling
            assert coefficients is not None
            tool = build_milling_cutter(cutter)
            if one.takes_stock:
                check_cutter(tool, coefficients)
                return ""
            assert one.cut is not None
            assert one.ap is not None
            compute_mean_load(coefficients, tool, MillingCut(one.cut, one.spindle), one.ae or tool.diameter, one.ap)
        elif one.kind != "force":
            build_drilling_stroke(build_drilling_tool(cutter, one), build_drilling_layers(process, one))
    except CuttingInputError as problem:
        return problem.reason
    return ""

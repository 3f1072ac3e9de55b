"""Cutter of the cell and operation of process.yaml as the tools of the force models."""

from __future__ import annotations

from math import inf, pi

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.errors import CuttingInputError
from machopt.process.drilling.drilling_tools import DrillingTool, MaterialLayer, build_countersink, build_reamer
from machopt.process.milling.milling_cut import MillingCutter

REAMER_CHAMFER = 0.25 * pi  # rad, between axis and chamfer of a machine reamer
COUNTERSINK_LIPS, REAMER_LIPS = 3, 6


def build_milling_cutter(cutter: CutterGeometry | None) -> MillingCutter:
    """Return the end mill of a cell's tool.

    Args:
        cutter: The cutter; None where the cell states none.

    Raises:
        CuttingInputError: no cutter, or its teeth are not stated.
    """
    if cutter is None:
        raise CuttingInputError("the tool has no cutter: tool.cutter in cell.yaml would work", key="cutter")
    if cutter.teeth is None:
        raise CuttingInputError("the number of teeth is missing: cutter.teeth in cell.yaml would work", key="teeth")
    return MillingCutter(
        diameter=cutter.diameter,
        teeth=cutter.teeth,
        helix=cutter.helix or 0.0,
        length=cutter.length,
        corner_radius=cutter.corner,
        runout=cutter.runout,
    )


def build_drilling_tool(cutter: CutterGeometry | None, one: ProcessOperation) -> DrillingTool:
    """Return the drill, countersink or reamer of an operation.

    Args:
        cutter: The cutter; None where the cell states none.
        one: The operation, of a kind that makes holes.

    Raises:
        CuttingInputError: no cutter, or a value is missing.
    """
    if cutter is None:
        raise CuttingInputError("the tool has no cutter: tool.cutter in cell.yaml would work", key="cutter")
    if one.kind == "countersinking":
        assert one.countersink is not None
        assert one.countersink_angle is not None
        hole = one.pilot or cutter.diameter
        return build_countersink(one.countersink, hole, one.countersink_angle, cutter.teeth or COUNTERSINK_LIPS)
    if one.kind == "reaming":
        assert one.reaming_stock is not None
        return build_reamer(cutter.diameter, one.reaming_stock, REAMER_CHAMFER, cutter.teeth or REAMER_LIPS)
    if cutter.point_angle is None:
        raise CuttingInputError(
            "the point angle of the drill is missing: tool.cutter.point_deg in cell.yaml would work", key="point_deg"
        )
    return DrillingTool(
        diameter=cutter.diameter,
        inner_diameter=one.pilot,
        half_point_angle=0.5 * cutter.point_angle,
        lips=cutter.teeth or 2,
        web=cutter.web,
        rake=one.rake * pi / 180.0,
    )


def build_drilling_layers(process: CuttingProcess, one: ProcessOperation) -> tuple[MaterialLayer, ...]:
    """Return the layers that the holes of an operation go through.

    Args:
        process: Content of process.yaml.
        one: The operation.
    """
    out = []
    for layer in one.layers:
        coefficients = process.materials[layer.material].drilling
        assert coefficients is not None  # the reader refuses a material without them
        out.append(MaterialLayer(coefficients, layer.thickness if layer.thickness < inf else inf))
    return tuple(out)

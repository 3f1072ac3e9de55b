"""Force across the wall at the moment the surface is made, which bends the tool."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.data_types.process import ProcessOperation
from machopt.numerics.array_types import Array
from machopt.process.binding.cutting_tools import build_milling_cutter
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear
from machopt.process.milling.instantaneous_force import compute_surface_generation_load
from machopt.process.milling.milling_cut import CutSide, MillingCut
from machopt.process.stock.contact_waveform import compute_contact_wall_forces

FEEDS = 9  # feeds per tooth at which a force within the revolution is computed; linear between them
HEIGHTS = 33  # heights of the wall at which the force is computed that makes it
SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


def compute_wall_forces(
    one: ProcessOperation,
    geometry: CutterGeometry | None,
    coefficients: MillingCoefficients,
    loads: PointLoads,
    rows: NDArray[np.intp],
    bite: Array,
) -> Array:
    """Return (n,) N along axis × travel, in the middle of the range of wear; zero where the tool counts as rigid.

    Args:
        one: Milling operation.
        geometry: The cutter.
        coefficients: Of the material.
        loads: Loads of the toolpath.
        rows: (n,) toolpath points of that operation; with given depths of cut all on one side.
        bite: (n,) m, feed per tooth.
    """
    if geometry is None or geometry.side_stiffness is None or one.surface != "side" or not len(rows):
        return np.zeros(len(rows))
    cutter, wear = build_milling_cutter(geometry), compute_mean_wear(one)
    if one.takes_stock:
        assert loads.engagement is not None
        wanted, every = np.zeros(len(loads.bite), bool), loads.bite.copy()
        wanted[rows], every[rows] = True, bite
        found = loads.engagement.select_points(wanted)
        return wear * compute_contact_wall_forces(coefficients, cutter, one.spindle, found, loads.side, every)[rows]
    cut = MillingCut(SIDES[int(loads.side[rows[0]])], one.spindle)
    depths = (float(loads.ae[rows[0]]), float(loads.ap[rows[0]]))
    heights = np.linspace(0.0, depths[1], HEIGHTS)
    feeds = np.unique(np.linspace(bite.min(), bite.max(), FEEDS))
    walls = []
    for f in feeds:
        load = compute_surface_generation_load(coefficients, cutter, cut, depths, float(f), heights)[:, 1]
        walls.append(load[np.argmax(np.abs(load))])
    return np.asarray(wear * np.interp(bite, feeds, walls))

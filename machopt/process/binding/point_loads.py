"""Load of the cut at each toolpath point, from the process, the tool and the feed of each move.

A row's load is that of the move that ends there. The arm carries the same load, but for a pressure foot: while the foot
presses, the arm carries the clamp force instead of a smaller thrust. Nothing acts on rapid, approach, retract and link
moves, above the material, and on the way out of a hole.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.data_types.stock import StockEngagement
from machopt.data_types.toolpath import Toolpath
from machopt.errors import ConfigurationKeyError, CuttingInputError
from machopt.numerics.array_types import Array
from machopt.process.binding.cutting_tools import build_drilling_layers, build_drilling_tool, build_milling_cutter
from machopt.process.binding.holes import DrilledHole, find_holes
from machopt.process.binding.operation_matching import NO_OPERATION, compute_spindle_speeds
from machopt.process.binding.pass_sides import find_reversed_moves
from machopt.process.binding.validity_notes import list_hole_notes
from machopt.process.drilling.stroke_phases import build_drilling_stroke, compute_stroke_maximum
from machopt.process.milling.engagement_angles import compute_contact_arc
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import CutSide, MillingCut
from machopt.process.stock.contact_load import compute_contact_load, summarise_contact

OPPOSITE: dict[CutSide, CutSide] = {"up": "down", "down": "up", "slot": "slot"}
SAME_DEPTH = 12  # decimals of a depth in m: picometres
_SIGNS: dict[CutSide, int] = {"up": 1, "down": -1, "slot": 0}


@dataclass(frozen=True, kw_only=True)
class PointLoads:
    """Nominal load on the tool at N toolpath points; zero where nothing is cut, NaN where no operation is stated.

    Nominal is the middle of the range of wear.
    """

    force: Array  # (N, 3) N on the tool along travel, normal, axis
    moment: Array  # (N,) N·m about the axis, tip to shank
    arm_force: Array  # (N, 3) N on the arm
    ae: Array  # (N,) m, NaN where there is none
    ap: Array  # (N,) m
    entry_angle: Array  # (N,) rad
    exit_angle: Array  # (N,) rad
    spindle_speed: Array  # (N,) rev/s
    bite: Array  # (N,) m, feed per tooth of milling, feed per revolution of drilling
    side: NDArray[np.int8]  # (N,) 1 up, −1 down, 0 slot or no milling
    contact_sigma: Array  # (N,) 1 sigma of the logarithm of the force from the stock's cells; 0 where ae is given
    holes: tuple[DrilledHole, ...]
    is_unknown: NDArray[
        np.bool_
    ]  # (N,) plunges and ramps: forces count the side of the cutter alone, and are no result
    engagement: StockEngagement | None = None  # contact that comes from the stock
    notes: tuple[str, ...] = ()  # limits of validity


def compute_point_loads(
    process: CuttingProcess, toolpath: Toolpath, cutter: CutterGeometry | None, feed: Array
) -> PointLoads:
    """Return the loads of a toolpath of one tool.

    Args:
        process: Content of process.yaml.
        toolpath: Toolpath with its process operations, of one tool.
        cutter: The cutter of the tool; None where the cell states none.
        feed: (N,) m/s, of the move that ends at each point.

    Raises:
        ConfigurationKeyError: an operation lacks a value, or has one that its force model does not accept.
    """
    return _LoadBuilder(process, toolpath, cutter, feed).build()


def compute_mean_wear(one: ProcessOperation) -> float:
    """Return the factor of the force in the middle of the range of wear.

    Args:
        one: The operation.
    """
    return 0.5 * (one.wear[0] + one.wear[1])


class _LoadBuilder:
    """Loads of one toolpath, operation after operation."""

    def __init__(self, process: CuttingProcess, toolpath: Toolpath, cutter: CutterGeometry | None, feed: Array) -> None:
        n = len(toolpath)
        self.process, self.toolpath, self.cutter, self.feed = process, toolpath, cutter, feed
        assert toolpath.process_operation is not None
        self.operation = toolpath.process_operation
        self.speed = compute_spindle_speeds(process, toolpath)
        given = self.operation != NO_OPERATION
        self.force = np.where(given[:, None], 0.0, np.full((n, 3), np.nan))
        self.moment = np.where(given, 0.0, np.nan)
        self.clamp = np.zeros(n)
        self.ae, self.ap, self.entry, self.exit, self.bite = (np.full(n, np.nan) for _ in range(5))
        self.side, self.contact_sigma = np.zeros(n, np.int8), np.zeros(n)
        self.is_unknown = np.zeros(n, bool)
        self.notes: list[str] = []

    def build(self) -> PointLoads:
        holes = find_holes(self.process, self.toolpath)
        for k, one in enumerate(self.process.operations):
            try:
                self._add_operation(k, one, holes)
            except CuttingInputError as error:
                raise ConfigurationKeyError(
                    error.reason, file=self.process.file, where=f"operations.{one.label}", key=error.key
                ) from None
        arm = self.force.copy()
        arm[:, 2] = np.where(self.clamp > 0, np.maximum(arm[:, 2], self.clamp), arm[:, 2])
        return PointLoads(
            force=self.force,
            moment=self.moment,
            arm_force=arm,
            ae=self.ae,
            ap=self.ap,
            entry_angle=self.entry,
            exit_angle=self.exit,
            spindle_speed=self.speed,
            bite=self.bite,
            side=self.side,
            contact_sigma=self.contact_sigma,
            holes=holes,
            is_unknown=self.is_unknown,
            engagement=self.toolpath.engagement,
            notes=tuple(dict.fromkeys(self.notes)),
        )

    def _add_operation(self, k: int, one: ProcessOperation, holes: tuple[DrilledHole, ...]) -> None:
        rows = np.flatnonzero(self.toolpath.cutting & (self.operation == k))
        if not len(rows):
            return
        mine = [hole for hole in holes if hole.operation == k]
        if one.kind == "force" and one.is_hole:
            self._add_given_force(one, np.concatenate([hole.rows[hole.is_cutting] for hole in mine]))
        elif one.is_hole:
            self._add_holes(one, mine)
        elif one.kind == "force":
            self._add_given_force(one, rows)
        elif one.takes_stock:
            self._add_stock_milling(one, rows)
        else:
            self._add_milling(one, rows)

    def _add_given_force(self, one: ProcessOperation, rows: NDArray[np.intp]) -> None:
        assert one.force is not None
        wear = compute_mean_wear(one)
        self.force[rows] = wear * np.array([one.force.travel, one.force.normal, one.force.axial])
        self.clamp[rows] = one.clamp

    def _add_holes(self, one: ProcessOperation, holes: list[DrilledHole]) -> None:
        stroke = build_drilling_stroke(build_drilling_tool(self.cutter, one), build_drilling_layers(self.process, one))
        wear = compute_mean_wear(one)
        alike: dict[tuple[float, float], list[tuple[int, float, float]]] = {}  # strokes between the same depths
        for hole in holes:
            for n in np.flatnonzero(hole.is_cutting):
                row = int(hole.rows[n])
                self._check_speed(one, row)
                self.bite[row] = self.feed[row] / self.speed[row]
                first, last = float(hole.cut_depth[n]), float(hole.end_depth[n])
                if first >= stroke.through_depth:  # below the stack
                    continue
                alike.setdefault((round(first, SAME_DEPTH), round(last, SAME_DEPTH)), []).append((row, first, last))
        for found in alike.values():
            rows, (_, first, last) = np.array([row for row, _, _ in found], np.intp), found[0]
            load = compute_stroke_maximum(stroke, self.bite[rows], last, first)
            self.force[rows, 2] = wear * load.thrust
            self.moment[rows] = wear * load.torque * (1.0 if one.spindle == "cw" else -1.0)
            self.clamp[rows] = one.clamp
        if one.clamp > 0 and any((self.force[hole.rows, 2] > one.clamp).any() for hole in holes):
            self.notes.append(
                f"{one.label}: the thrust is more than the clamp force of {one.clamp:g} N, so that the foot lifts"
            )
        self.notes += list_hole_notes(one, stroke, holes, self.bite)

    def _add_milling(self, one: ProcessOperation, rows: NDArray[np.intp]) -> None:
        coefficients = self.process.materials[one.material].milling
        assert coefficients is not None
        assert one.cut is not None
        assert one.ap is not None
        cutter = build_milling_cutter(self.cutter)
        ae = cutter.diameter if one.ae is None else one.ae
        turned = find_reversed_moves(one, self.toolpath, rows)
        for side, mine in ((one.cut, rows[~turned]), (OPPOSITE[one.cut], rows[turned])):
            if not len(mine):
                continue
            self._check_speed(one, int(mine[np.argmin(np.nan_to_num(self.speed[mine]))]))
            cut = MillingCut(side, one.spindle)
            bite = self.feed[mine] / (self.speed[mine] * cutter.teeth)
            arc = compute_contact_arc(cutter, cut, np.array([ae]), cutter.radius)
            load = compute_mean_wear(one) * compute_mean_load(coefficients, cutter, cut, ae, one.ap).compute_load(bite)
            self.force[mine], self.moment[mine] = load[:, :3], load[:, 3]
            self.ae[mine], self.ap[mine], self.bite[mine] = ae, one.ap, bite
            self.entry[mine], self.exit[mine], self.side[mine] = arc.start[0], arc.end[0], _SIGNS[side]
        self._note_chip_range(one, rows, coefficients.h_range_m)

    def _add_stock_milling(self, one: ProcessOperation, rows: NDArray[np.intp]) -> None:
        coefficients = self.process.materials[one.material].milling
        found = self.toolpath.engagement
        assert coefficients is not None
        assert found is not None
        cutter = build_milling_cutter(self.cutter)
        self._check_speed(one, int(rows[np.argmin(np.nan_to_num(self.speed[rows]))]))
        self._check_speed(one, int(rows[np.argmin(np.nan_to_num(self.feed[rows]))]))
        self.bite[rows] = self.feed[rows] / (self.speed[rows] * cutter.teeth)
        edge, slope = compute_contact_load(coefficients, cutter, MillingCut("slot", one.spindle), found)
        load = compute_mean_wear(one) * (edge[rows] + slope[rows] * self.bite[rows, None])
        self.force[rows], self.moment[rows] = load[:, :3], load[:, 3]
        contact = summarise_contact(cutter, found)
        self.ae[rows], self.ap[rows] = contact.ae[rows], contact.ap[rows]
        self.entry[rows], self.exit[rows] = contact.entry[rows], contact.exit[rows]
        self.side[rows], self.contact_sigma[rows] = contact.side[rows], contact.sigma[rows]
        self.is_unknown[rows] = found.is_end_cut[rows]
        cuts = rows[np.isfinite(contact.ae[rows])]
        if len(cuts):
            self._note_chip_range(one, cuts, coefficients.h_range_m)
        self.notes += found.notes

    def _note_chip_range(self, one: ProcessOperation, rows: NDArray[np.intp], h_range: tuple[float, float]) -> None:
        least, largest = h_range
        if largest == inf and least == 0.0:
            return
        outside = (self.bite[rows] < least) | (self.bite[rows] > largest)
        if outside.any():
            self.notes.append(
                f"{one.label}: the feed per tooth of {int(outside.sum())} of {len(rows)} moves "
                f"({1e3 * self.bite[rows].min():.3g} … {1e3 * self.bite[rows].max():.3g} mm) lies outside the chip "
                f"thickness of the coefficients ({1e3 * least:.3g} … {1e3 * largest:.3g} mm)"
            )

    def _check_speed(self, one: ProcessOperation, row: int) -> None:
        if not self.speed[row] > 0:
            raise CuttingInputError(
                f"spindle_rpm is missing, and the toolpath states no spindle speed at point {row}; the speed in 1/min "
                "would work",
                key="spindle_rpm",
            )
        if not self.feed[row] > 0:
            raise CuttingInputError(
                f"the move to point {row} has no feed; a feed in the toolpath (or --feed) would work", key="feed"
            )

"""Check of f1_Hz, a_lim_mm and chatter of points.csv, and of ``min_stability_ratio``, by a second law.

========================  ==========================================================================================
check                     condition
========================  ==========================================================================================
chatter                   the word follows from a_lim_mm and ap_mm; unknown only where it cannot be computed
f1_Hz is stated           at every cut that is driven, where the modes can be computed
f1_Hz                     is that of :mod:`machopt.verification.motion.process.stability`, at 40 points
a_lim_mm                  is not above the limit of the second law below ωT = 1, nor of the whole delay, at 40 points
a_lim_mm is reached       one of these laws is unstable little above it, at these points without modes of the tool
min_stability_ratio       a_lim_mm over ap_mm is not below it, at all milled points
second law                the cut stays stable up to that ratio, at 40 points with the least a_lim_mm and 160 others
========================  ==========================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.process import ProcessOperation
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import (
    VerificationCheck,
    build_count_check,
    build_skipped_check,
    build_worst_value_check,
)
from machopt.verification.motion.checks.contact_columns import SIDES
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.process.delay_stability_sweep import DelaySweep
from machopt.verification.motion.process.point_loads import RecomputedLoads
from machopt.verification.motion.process.stability import (
    DEPTHS,
    DelayLaw,
    ModeModel,
    PointModes,
    find_contact_arcs,
    find_given_arc,
)
from machopt.verification.motion.stiffness import arm_compliance
from machopt.verification.tables.exported_tables import ExportedPoints

STABILITY_POINTS, LEAST_POINTS, SPREAD_POINTS = 40, 40, 160
MODE_HZ, MODE_SHARE, LIMIT_SHARE = (
    1e-3,
    1e-5,
    5e-3,
)  # three decimals; of the frequency; by which a limit may be above that of the second law
WIDEST_DEPTH = 10.0  # times the planned depth: a larger limit is not stated
REACHED = (1.01, 1.03, 1.06, 1.1, 1.2, 1.35)  # of a limit: the law of second order is up to 15 % below the whole delay
BELOW, LOWEST = 24, 0.03  # depths up to a limit at which nothing may grow; the lowest as a share of it
PRINTED_MM = 5e-5  # half of the last decimal
RATIO_SHARE = 1e-3  # four decimals of a_lim_mm; joints are interpolated between planning points
Rows = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class StabilityTables:
    """What the stability of the points follows from."""

    cell: Cell  # with the tool of this part of the job
    toolpath: Toolpath
    loads: RecomputedLoads
    points: ExportedPoints  # true angles
    arm: UrdfKinematics
    law: arm_compliance.ComplianceModel

    def find_milled_rows(self) -> Rows:
        """Return the rows that state a verdict on stability other than unknown."""
        words = np.array(self.points.words["chatter"], dtype=object)
        return np.flatnonzero((words != "") & (words != "unknown") & self.points.ok)

    def compute_ratios(self, rows: Rows) -> Array:
        """Return (n,) the stated limit over the stated depth; inf where no limit is stated, NaN where no depth is.

        Args:
            rows: Milled rows.
        """
        limit, depth = (self.points.numbers[name][rows] for name in ("a_lim_mm", "ap_mm"))
        ratio = np.divide(limit, depth, out=np.full(len(rows), np.nan), where=depth > 0.0)
        return np.where(np.isfinite(limit), ratio, np.inf)

    def list_least_limits(self) -> Array:
        """Return (N,) mm the stated limits; of a stable point without one, the depth above which none is stated."""
        limit, depth = (self.points.numbers[name] for name in ("a_lim_mm", "ap_mm"))
        is_stable = np.array([word == "stable" for word in self.points.words["chatter"]], bool)
        return np.where(np.isnan(limit) & is_stable, WIDEST_DEPTH * depth, limit)

    def compute_modes(self, model: ModeModel, rows: Rows) -> list[PointModes]:
        """Return the modes at some rows.

        Args:
            model: Mass matrix of the arm.
            rows: (n,) rows.
        """
        points, toolpath, arm = self.points, self.toolpath, self.arm
        external = points.external[rows]
        T = arm.T_base_workpiece(external)
        place = np.einsum("nij,nj->ni", T[:, :3, :3], toolpath.position[rows]) + T[:, :3, 3]
        state = self.law.evaluate(arm.compute_configuration(points.q[rows], external), place)
        travel = compute_sideways_directions(toolpath)[rows]
        out = []
        for n, row in enumerate(rows.tolist()):
            axis = toolpath.axis[row]
            frame = np.stack([travel[n], np.cross(axis, travel[n]), axis]) @ T[n, :3, :3].T
            out.append(model.compute_modes(points.q[row], external[n], state.gear[n], state.J[n], frame))
        return out

    def build_law(self, row: int, modes: PointModes) -> DelayLaw:
        """Return the second law at a milled row.

        Args:
            row: The row.
            modes: Modes there.
        """
        return DelayLaw.build(self.cell, self.find_operation(row), self._list_arcs(row), modes, self.loads.speed[row])

    def find_operation(self, row: int) -> ProcessOperation:
        """Return the operation of process.yaml of a row.

        Args:
            row: The row.
        """
        assert self.cell.process is not None
        return self.cell.process.operations[int(self.loads.operation[row])]

    def _list_arcs(self, row: int) -> list[tuple[float, float, float]]:
        """Return share of the height, start and end of each arc of contact of a milled point."""
        engagement = self.toolpath.engagement
        if engagement is not None and engagement.is_computed[row]:
            own = engagement.take_range(row, row + 1)
            return find_contact_arcs(own, float(np.max(own.high, initial=0.0) - np.min(own.low, initial=np.inf)))
        cutter, ae = self.cell.tool.cutter, self.find_operation(row).ae
        assert cutter is not None
        side = SIDES[int(self.loads.side[row])]
        return [find_given_arc(self.cell, side, cutter.diameter if ae is None else ae)]


def check_stability(tables: StabilityTables, least: float | None) -> list[VerificationCheck]:
    """Return the checks of the stability columns, and of the least ratio where one is requested.

    Args:
        tables: What the stability of the points follows from.
        least: ``min_stability_ratio``; None: none is requested.
    """
    points, cell = tables.points, tables.cell
    model = ModeModel(cell, tables.arm)
    is_computable = model.has_inertia and not cell.mimics
    checks = [_check_words(tables, is_computable=is_computable), _check_modes(tables, is_computable=is_computable)]
    if least is not None:
        checks += [*_check_stated_ratios(tables, least), *_list_unknown(points)]
    rows = np.flatnonzero(np.isfinite(points.numbers["f1_Hz"]) & points.ok)
    if not len(rows) or not is_computable:
        return checks
    checks += _check_limits(tables, model, _spread(rows, STABILITY_POINTS))
    if least is not None:
        checks.append(_check_second_law(tables, model, least))
    return checks


def _check_words(tables: StabilityTables, *, is_computable: bool) -> VerificationCheck:
    """Compare the words with limit and depth; ``unknown`` is wrong where modes, damping and a flat cutter are there."""
    points, cutter = tables.points, tables.cell.tool.cutter
    damping = None if tables.cell.process is None else tables.cell.process.damping
    is_damped = damping is not None and all(damping.get_ratio(n) is not None for n in range(6))
    is_computable &= is_damped and cutter is not None and cutter.corner == 0
    columns = (points.numbers["a_lim_mm"], points.numbers["ap_mm"])
    wrong = [
        f"point {p}: {word}, limit {a:.4g} mm at {ap:.4g} mm"
        for p, word, a, ap, ok in zip(points.point, points.words["chatter"], *columns, points.ok, strict=True)
        if (word and np.isfinite(a) and (word == "stable") != (ap < a))
        or (word not in ("", "stable", "unknown") and np.isnan(a))
        or (word == "unknown" and ok and is_computable)
    ]
    return build_count_check("points.csv chatter", wrong, "rows")


def _check_modes(tables: StabilityTables, *, is_computable: bool) -> VerificationCheck:
    """Find points that lack their lowest mode, or state one where nothing is cut or no posture is known."""
    points, operation = tables.points, tables.loads.operation
    cuts = (tables.toolpath.move == MoveKind.CUT) & (operation >= 0) & is_computable
    stated = np.isfinite(points.numbers["f1_Hz"])
    lacks, extra = cuts & points.ok & ~stated, stated & ~cuts
    wrong = [f"point {points.point[n]}: {'lacks' if lacks[n] else 'has'} one" for n in np.flatnonzero(lacks | extra)]
    return build_count_check("points.csv f1_Hz is stated", wrong, "points")


def _check_stated_ratios(tables: StabilityTables, least: float) -> list[VerificationCheck]:
    """Return the check of the stated ratios; none where this tool has no point of known stability."""
    rows = tables.find_milled_rows()
    if not len(rows):
        return []
    ratio, at = tables.compute_ratios(rows), tables.points.point[rows]
    short, limit = np.maximum(least - ratio, 0.0), RATIO_SHARE * least
    name = "requested: min_stability_ratio"
    return [build_worst_value_check(name, "1 below", short, limit, lambda n: f"point {at[n]}")]


def _list_unknown(points: ExportedPoints) -> list[VerificationCheck]:
    """Return a check that could not be made at the points whose limit is stated as unknown."""
    unknown = points.point[np.array([word == "unknown" for word in points.words["chatter"]], bool)]
    if not len(unknown):
        return []
    why = f"{len(unknown)} points state no limit of the depth of cut, the first is point {unknown[0]}"
    return [build_skipped_check("min_stability_ratio at points of unknown stability", why)]


def _check_limits(tables: StabilityTables, model: ModeModel, rows: Rows) -> list[VerificationCheck]:
    """Check f1_Hz and a_lim_mm at some rows."""
    f1, limit, stated = tables.points.numbers["f1_Hz"], tables.list_least_limits(), tables.points.numbers["a_lim_mm"]
    cutter, early = tables.cell.tool.cutter, []
    has_tool_modes = cutter is not None and bool(cutter.modes)
    off, above, at = np.zeros(len(rows)), np.zeros(len(rows)), tables.points.point[rows]
    for n, (row, modes) in enumerate(zip(rows.tolist(), tables.compute_modes(model, rows), strict=True)):
        off[n] = abs(f1[row] - modes.lowest_hz) / (MODE_HZ + MODE_SHARE * modes.lowest_hz)
        if tables.find_operation(row).kind == "milling" and limit[row] > 0.0:
            law = tables.build_law(row, modes)
            above[n] = compute_excess(law, 1e-3 * max(float(limit[row]) - PRINTED_MM, 0.5 * float(limit[row])))
            if not (has_tool_modes or np.isnan(stated[row]) or is_limit_reached(law, 1e-3 * float(limit[row]))):
                early.append(f"point {at[n]}: {limit[row]:.4g} mm")
    return [
        build_worst_value_check("points.csv f1_Hz", "of its limit", off, 1.0, lambda n: f"point {at[n]}"),
        build_worst_value_check("points.csv a_lim_mm", "1 above", above, LIMIT_SHARE, lambda n: f"point {at[n]}"),
        build_count_check("points.csv a_lim_mm is reached", early, "points"),
    ]


def compute_excess(law: DelayLaw, stated: float) -> float:
    """Return by which share a stated limit is above that of either law; inf where one is unstable at every depth.

    Args:
        law: Modes, directions and delay at the point.
        stated: m, the limit.
    """
    if np.isnan(law.zeta).any():
        return float("inf")
    depths, own = stated * (1.0 - LIMIT_SHARE) * np.geomspace(LOWEST, 1.0, BELOW), float("inf")
    if (law.find_eigenvalues(depths).real >= 0.0).any():
        own = law.find_limit()
    sweep = DelaySweep(law, stated)
    if sweep.find_unstable(depths[-DEPTHS:]).any():
        own = min(own, sweep.find_limit())
    return max(stated / own - 1.0, 0.0) if own > 0 else float("inf")


def is_limit_reached(law: DelayLaw, stated: float) -> bool:
    """Return whether either law is unstable at one of some depths above a stated limit; never with unknown damping.

    Args:
        law: Modes, directions and delay at the point.
        stated: m, the limit.
    """
    if np.isnan(law.zeta).any():
        return False
    depths = stated * np.array(REACHED)
    if DelaySweep(law, float(depths[-1])).find_unstable(depths).any():
        return True
    return law.find_limit() <= float(depths[-1])


def _check_second_law(tables: StabilityTables, model: ModeModel, least: float) -> VerificationCheck:
    """Find points that the second law calls unstable at or below the requested ratio."""
    milled = tables.find_milled_rows()
    order = np.argsort(tables.compute_ratios(milled), kind="stable")
    rows = np.union1d(milled[order[:LEAST_POINTS]], _spread(milled, SPREAD_POINTS)).astype(np.intp)
    wrong = []
    for row, modes in zip(rows.tolist(), tables.compute_modes(model, rows), strict=True):
        depth = 1e-3 * float(tables.points.numbers["ap_mm"][row])
        if not (depth > 0.0 and _is_stable_to(tables.build_law(row, modes), least * depth * (1.0 - LIMIT_SHARE))):
            wrong.append(f"point {tables.points.point[row]}: unstable below {least:g} times its depth")
    return build_count_check("points.csv stability at min_stability_ratio", wrong, "points")


def _is_stable_to(law: DelayLaw, depth: float) -> bool:
    """Return whether neither law is unstable at any of DEPTHS depths up to one, m."""
    depths = depth * np.arange(1, DEPTHS + 1) / DEPTHS
    return law.is_stable_to(depth) and not DelaySweep(law, depth).find_unstable(depths).any()


def _spread(rows: Rows, most: int) -> Rows:
    picked = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(int))
    return np.asarray(rows[picked])

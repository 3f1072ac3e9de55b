"""Outcomes of single points of a shown plan at other rotations, for handles that are dragged on the page."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, isfinite, nan, radians
from typing import Any

import numpy as np

from machopt.commands.optimize.job_result import OptimizeJobResult
from machopt.data_types.cell import Cell
from machopt.data_types.documents.view_document import ViewOutcomeSection
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.plan_output.collision_map import find_cut_stations
from machopt.planning.tolerance.outcome_at_other_rotation import LiveOutcome, LiveOutcomes


def has_tolerances(cell: Cell) -> bool:
    """Return whether any operation of a cell's process states a tolerance.

    Args:
        cell: The cell.
    """
    return cell.process is not None and any(one.tolerance.is_given for one in cell.process.operations)


@dataclass(frozen=True, eq=False)
class LiveJob:
    """A plan with what no rotation changes."""

    made: OptimizeJobResult
    parts: tuple[tuple[int, LiveOutcomes | None], ...]  # of each tool: first point, and its part of the plan

    @classmethod
    def build(cls, job_result: OptimizeJobResult) -> LiveJob:
        """Prepare a plan.

        Args:
            job_result: The shown plan.
        """
        parts = tuple(
            (one.segment.first, LiveOutcomes.build(one.plan, one.segment.toolpath, one.timeline))
            for one in job_result.segments
        )
        return cls(job_result, parts)

    def find_outcome(self, body: dict[str, Any]) -> ViewOutcomeSection | None:
        """Return the outcome of a point at a rotation; None where it has no tolerance.

        Args:
            body: ``point``, a toolpath point, and ``phi_deg``, the rotation about the transported reference.

        Raises:
            InputError: a value is missing or out of range.
        """
        point, angle = body.get("point"), body.get("phi_deg")
        last = len(self.made.toolpath) - 1
        if isinstance(point, bool) or not isinstance(point, int) or not 0 <= point <= last:
            raise InputError(f"found {point!r}; a toolpath point from 0 to {last} would work", where="point")
        if isinstance(angle, bool) or not isinstance(angle, int | float) or not isfinite(angle):
            raise InputError(f"found {angle!r}; an angle in degrees would work", where="phi_deg")
        first, part = next(p for p in reversed(self.parts) if p[0] <= point)
        phi = radians(angle)
        found = None if part is None else part.evaluate(point - first, phi, self._find_seed(point, phi))
        return None if found is None else _build_section(found, first)

    def _find_seed(self, point: int, phi: float) -> Array:
        """Return the posture of the page's map that is nearest to a point and a rotation, (6,) rad."""
        shown, plan = self.made.shown, self.made.plan
        cut = find_cut_stations(plan)
        if shown.postures is None or not len(cut):
            return np.full(6, np.nan)
        station = int(np.abs(plan.path.index[plan.path.stations[cut]] - point).argmin())
        postures = np.asarray(shown.postures[station], float)
        apart = np.abs(wrap_angle(shown.candidates.phi - phi))
        apart = np.where(np.isfinite(postures).all(axis=1), apart, np.inf)
        return np.asarray(postures[int(apart.argmin())], float)


def _build_section(live_outcome: LiveOutcome, first: int) -> ViewOutcomeSection:
    is_angle = live_outcome.error_name == "axis"
    return ViewOutcomeSection(
        point=live_outcome.point + first,
        outcome=live_outcome.outcome,
        error_name=live_outcome.error_name,
        error_mm=nan if is_angle else 1e3 * live_outcome.error,
        error_deg=degrees(live_outcome.error) if is_angle else nan,
        tolerance_mm=1e3 * live_outcome.tolerance,
        p_in=live_outcome.p_in,
        reason=live_outcome.reason,
    )

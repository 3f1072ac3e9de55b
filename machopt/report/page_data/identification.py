"""Data of the identification page from the identification result."""

from __future__ import annotations

from math import isfinite

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.measurement.identification.identification_result import IdentificationResult, JointResult, TermResult
from machopt.numerics.array_types import Array
from machopt.report.page_types.identification_page_data import (
    IdentificationPageData,
    IdentifiedCoefficient,
    ModelComparisonRow,
    StiffnessGridView,
    SubsetSpread,
)
from machopt.version import __version__

MAJORITY_SHARE = 0.5  # share of the displacements' power; real arms show 0.8 and more (dumas2011 section 5.3)


def _select_badge(result: IdentificationResult) -> tuple[str, str]:
    """Return tone and text of the badge."""
    if result.errors.explained < MAJORITY_SHARE:  # whatever the intervals say: this arm is not what was measured
        return "bad", "NOT EXPLAINED"
    known = sum(j.identified for j in result.joints)
    if known == len(result.joints):
        return "warn" if result.warnings else "good", "IDENTIFIED"
    return ("warn", "IN PART") if known else ("bad", "NOT SEEN")


def build_identification_page_data(
    cell: Cell,
    recording: Recording,
    tests: LoadTestExperiment,
    result: IdentificationResult,
    facts: tuple[tuple[str, str], ...],
) -> IdentificationPageData:
    """Return everything that the page shows.

    Args:
        cell: The robot cell.
        recording: The recording, or the joined recordings.
        tests: Load tests of the recording.
        result: Result of the identification.
        facts: Label and text of each fact in the page's table.
    """
    t = result.table
    sigma = np.empty(t.measured.shape)
    for c, scatter in enumerate(result.scatter):
        sigma[:, 3 * c : 3 * c + 3] = scatter.total
    tone, badge = _select_badge(result)
    heldout_rmse = result.heldout.rmse if result.heldout is not None else np.nan
    prior = None if cell.stiffness is None else cell.stiffness.joints
    return IdentificationPageData(
        title=f"Stiffness of {cell.name}",
        cell=cell.name,
        recording=recording.source,
        version=__version__,
        tone=tone,
        badge=badge,
        sentence=_format_verdict(result, heldout_rmse),
        cautions=(*cell.warnings, *recording.warnings, *result.warnings, *result.combinations),
        joints=tuple(_build_joint_coefficient(j, prior) for j in result.joints),
        terms=tuple(_build_term_coefficient(x) for x in result.terms),
        measured=t.measured,
        predicted=t.predicted,
        heldout=t.measured - t.heldout,
        sigma=sigma,
        pose=tests.pose,
        line=tests.line,
        load=np.linalg.norm(tests.wrench[:, :3], axis=1),
        outlier=np.asarray((t.weight < 0.5).any(axis=1)),
        leverage=result.influence.leverage,
        compliances=1.0 / result.stiffness.joints,
        covariance=np.zeros((6, 6)) if result.stiffness.covariance is None else result.stiffness.covariance,
        rmse=result.errors.rmse,
        heldout_rmse=heldout_rmse,
        explained=result.errors.explained,
        displacement=float(np.sqrt(np.mean(t.measured[:, :3] ** 2))),
        condition_number=result.condition_number,
        level=result.uncertainty.level,
        comparisons=_list_model_comparisons(result),
        subset=_build_subset_study(result),
        monte_carlo=None if result.monte_carlo is None else result.monte_carlo.spread,
        grid=_build_grid_view(result),
        facts=facts,
    )


def _format_verdict(result: IdentificationResult, heldout: float) -> str:
    known = [j for j in result.joints if j.identified]
    blind = [j for j in result.joints if not j.identified]
    if result.errors.explained < MAJORITY_SHARE:
        return (
            "These readings do not follow an arm of elastic joints: the fit explains "
            f"{max(100 * result.errors.explained, 0.0):.0f} % of the squared displacements. Do not plan with this "
            "stiffness; check loads, frames and units first."
        )
    if not known:
        return "These readings identify no joint by itself; the reason is given for each joint."
    halves = [50.0 * (j.interval[1] - j.interval[0]) / j.k for j in known if isfinite(j.interval[1])]
    text = f"{_format_joints(known)} identified"
    if halves:
        text += f" to ± {min(halves):.1f} … {max(halves):.1f} %" if len(halves) > 1 else f" to ± {halves[0]:.1f} %"
    if blind:
        text += f"; {_format_joints(blind)} not seen by these readings"
    if isfinite(heldout):
        size = float(np.sqrt(np.mean(result.table.measured[:, :3] ** 2)))
        text += (
            f". On poses the fit did not see it errs by {1e3 * heldout:.3f} mm where {1e3 * size:.3f} mm were measured"
        )
    return text + (" (a stiffness for each grid cell)." if result.grid is not None else ".")


def _format_joints(joints: list[JointResult]) -> str:
    numbers = [str(j.joint) for j in joints]
    if len(numbers) == 1:
        return f"Joint {numbers[0]}"
    return f"Joints {', '.join(numbers[:-1])} and {numbers[-1]}"


def _build_joint_coefficient(j: JointResult, prior: Array | None) -> IdentifiedCoefficient:
    before = np.nan if prior is None else float(prior[j.joint - 1])
    low, high = j.interval
    return IdentifiedCoefficient(
        name=f"joint {j.joint}",
        unit="N·m/rad",
        value=j.k,
        low=low,
        high=high,
        prior=before,
        identified=j.identified,
        reason=j.reason,
    )


def _build_term_coefficient(t: TermResult) -> IdentifiedCoefficient:
    low, high = t.interval
    return IdentifiedCoefficient(
        name=f"{t.effect} {t.location}, {t.name}",
        unit=t.unit,
        value=t.value,
        low=low,
        high=high,
        prior=np.nan,
        identified=t.identified,
        reason=t.reason,
    )


def _list_model_comparisons(result: IdentificationResult) -> tuple[ModelComparisonRow, ...]:
    if result.grid is None or result.heldout is None:
        return ()
    grid, constant = result.grid.heldout.rmse
    cells = len(result.grid.readings)
    inside = result.grid.heldout.counts
    count = int(inside.sum())
    return (
        ModelComparisonRow("one stiffness for the whole space", 6, result.errors.rmse, constant, False),
        ModelComparisonRow(f"a stiffness for each of {cells} cells ({count} readings)", 6 * cells, np.nan, grid, True),
    )


def _build_subset_study(result: IdentificationResult) -> SubsetSpread | None:
    s = result.subsets
    if s is None:
        return None
    seen = np.isfinite(s.k).mean(axis=1) > 0.5  # a median of a few lucky subsets is meaningless
    k = np.where(seen[:, None, :], s.k, np.nan)
    known = np.isfinite(k).any(axis=(1, 2))
    if known.sum() < 2:
        return None
    with np.errstate(all="ignore"):
        low, median, high = (_compute_quantile(k[known], p) for p in (5, 50, 95))
    return SubsetSpread(s.tests[known], low, median, high)


def _compute_quantile(k: Array, percent: float) -> Array:
    """(S, n) percentile over the subsets that determine the joint; NaN where none does."""
    out = np.full((len(k), k.shape[2]), np.nan)
    for s, part in enumerate(k):
        for j in range(part.shape[1]):
            column = part[np.isfinite(part[:, j]), j]
            if len(column):
                out[s, j] = np.percentile(column, percent)
    return out


def _build_grid_view(result: IdentificationResult) -> StiffnessGridView | None:
    if result.grid is None:
        return None
    g = result.grid.grid
    index = np.stack(np.unravel_index(np.arange(int(np.prod(g.shape))), g.shape, order="F"), axis=1)
    std = np.zeros_like(g.joints) if g.std is None else g.std
    centre = g.origin + g.cell * (index + 0.5)
    return StiffnessGridView(
        shape=g.shape, centre=centre, k=g.joints, std=std, readings=result.grid.readings, constant=result.grid.centre
    )

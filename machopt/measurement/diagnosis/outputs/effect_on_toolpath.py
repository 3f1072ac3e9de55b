"""Effect of the findings on one toolpath: the plan with the previous model, its deflection with the new model, and a
new plan.

::

    cell as stated            ──plan──► old plan ──┬─► deflection with the old model    (before)
                                                   └─► deflection with the new model    (unchanged)
    refitted, with findings   ──plan──► new plan ────► deflection with the new model    (after)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import (
    CasePointsSection,
    FindingAtJobEntry,
    JobEffectSection,
    MeanAndWorstSection,
    ModelCasesSection,
    QuantityChangeEntry,
    RotationChangeSection,
)
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma, explain_points
from machopt.stiffness.arm_stiffness import ArmElasticity

TEST_FORCE = 1000.0  # N along the tool axis, if the cell states no process force


def compare_toolpath_plans(
    cell: Cell, stiffness_before: ArmStiffness, stiffness_after: ArmStiffness, toolpath: Toolpath, options: PlanOptions
) -> JobEffectSection:
    """Plan a toolpath with the model before and after the diagnosis, and compare.

    Deflections refer to the programmed path without compensation. Means are weighted by cut length. Without a stated
    process force, 1 kN along the tool axis is used, and ``force`` states this.

    Args:
        cell: Robot cell; its own stiffness is not used.
        stiffness_before: Stiffness of the cell; if it has none, the refitted joint springs alone.
        stiffness_after: Joint springs refitted together with the found terms.
        toolpath: Toolpath to plan.
        options: Planning options.

    Returns:
        The section of diagnosis.json.
    """
    try:
        old, new = (
            plan_path(replace(cell, stiffness=s), toolpath, options) for s in (stiffness_before, stiffness_after)
        )
    except InputError as error:  # planning is not possible, or the springs are unstable: nothing to compare
        return _build_empty_effect(toolpath.source, str(error))
    found = _compare_plans(old, new)
    if found is None:
        return _build_empty_effect(
            toolpath.source,
            _explain_unreached_point(old) or _explain_unreached_point(new) or "no point that both models hold",
        )
    return _build_effect_entry(cell, toolpath.source, found, old, new)


@dataclass(frozen=True, kw_only=True)
class _ComparedPlans:
    """Both plans at the planning points that both reach."""

    both: NDArray[np.bool_]  # (P,) cutting points reached by both plans
    is_point: NDArray[np.bool_]  # (P,) original points of the toolpath
    weight: Array  # (P,) share of the cut length, sum 1
    rotation_change: Array  # (P,) rad, new minus old rotation about the tool axis
    deflection_before: Array  # (P,) m, old plan, old model
    unchanged: Array  # (P,) m, old plan, new model
    deflection_after: Array  # (P,) m, new plan, new model

    def mean(self, deflection: Array) -> float:
        """Return the mean over the cut length.

        Args:
            deflection: (P,) deflections, m.

        Returns:
            Mean, m.
        """
        return float(self.weight[self.both] @ deflection[self.both])

    def worst(self, deflection: Array) -> int:
        """Return the row of the toolpath point with the largest deflection, or of any planning point if none is
        compared.

        Args:
            deflection: (P,) deflections, m.

        Returns:
            Row index.
        """
        named = self.both & self.is_point
        return int(np.where(named if named.any() else self.both, deflection, -np.inf).argmax())


def _compare_plans(old: Plan, new: Plan) -> _ComparedPlans | None:
    """Return the comparison; None if no cutting point is reached with both models."""
    path = old.path
    before, unchanged, after = (
        _compute_deflection(old, old),
        _compute_deflection(old, new),
        _compute_deflection(new, new),
    )
    both = path.counted & np.isfinite(before) & np.isfinite(unchanged) & np.isfinite(after)
    if not both.any():
        return None
    weight = np.where(both, path.weight, 0.0)
    weight = weight / weight.sum() if weight.sum() > 0.0 else both / both.sum()
    return _ComparedPlans(
        both=both,
        is_point=path.is_point,
        weight=weight,
        rotation_change=np.asarray(wrap_angle(compute_gamma(new) - compute_gamma(old))),
        deflection_before=before,
        unchanged=unchanged,
        deflection_after=after,
    )


def _compute_changes_by_finding(cell: Cell, old: Plan, plan: Plan, c: _ComparedPlans) -> tuple[FindingAtJobEntry, ...]:
    """Return what each term that the old model lacks changes at the new plan, the largest first."""
    known = {(term.effect, term.location) for term in old.setup.elasticity.stiffness.terms}
    elasticity, stiffness = plan.setup.elasticity, plan.setup.elasticity.stiffness
    whole = _compute_deflection_vectors(plan, elasticity)
    out: list[tuple[float, str, str]] = []
    for n, term in enumerate(stiffness.terms):
        if (term.effect, term.location) in known:
            continue
        others = tuple(t for k, t in enumerate(stiffness.terms) if k != n)
        without = replace(stiffness, terms=others)  # and the same discrepancy
        try:
            rest = ArmElasticity(
                elasticity.robot, elasticity.T_flange_tcp, without, cell.arm_limits, elasticity.masses, counted=True
            )
        except InputError:  # the springs alone are unstable
            continue
        change = np.linalg.norm(whole - _compute_deflection_vectors(plan, rest), axis=1)
        out.append((1e3 * c.mean(change), term.effect, term.location))
    out.sort(key=lambda e: -e[0])
    return tuple(FindingAtJobEntry(effect=e, location=w, deflection_mm=size) for size, e, w in out)


def rank_findings(findings: Sequence[Finding], effect: JobEffectSection | None) -> tuple[Finding, ...]:
    """Rank findings by what they change at the job; those that change no plan keep their order behind the others.

    Args:
        findings: Findings of a diagnosis.
        effect: Effect on the job; None without one.
    """
    if effect is None:
        return tuple(findings)
    size = {(e.effect, e.location): float(e.deflection_mm or 0.0) for e in effect.by_finding}
    return tuple(sorted(findings, key=lambda f: -size.get((f.effect, f.location), 0.0)))


def _compute_deflection_vectors(plan: Plan, elasticity: ArmElasticity) -> Array:
    """Return the deflections (P, 3) m of a plan's configurations; NaN for unreached points."""
    out = np.full((len(plan.path.index), 3), np.nan)
    a, d = plan.chosen.assignment, plan.directions
    ok = np.flatnonzero(a.reason == InfeasibilityReason.OK)
    force = d.force[ok] if plan.options.force.given else TEST_FORCE * d.axial[ok]
    out[ok] = d.elastic(elasticity, a.q[ok], ok).compute_deflection(force)
    return out


def _compute_deflection(choice: Plan, model: Plan) -> Array:
    """Return |d| (P,) m of one plan's configurations with another's model; NaN for unreached points."""
    out = np.full(len(choice.path.index), np.nan)
    a, d = choice.chosen.assignment, model.directions
    ok = np.flatnonzero(a.reason == InfeasibilityReason.OK)
    force = d.force[ok] if model.options.force.given else TEST_FORCE * d.axial[ok]
    out[ok] = np.linalg.norm(d.elastic(model.setup.elasticity, a.q[ok], ok).compute_deflection(force), axis=-1)
    return out


def _build_effect_entry(cell: Cell, name: str, c: _ComparedPlans, old: Plan, new: Plan) -> JobEffectSection:
    path, rows = old.path, np.flatnonzero(old.path.is_point)
    angle = np.degrees(np.abs(c.rotation_change[c.both]))
    share = float((angle > np.degrees(thresholds.LIMITS.small_rotation)).mean())
    cases = {"before": c.deflection_before, "unchanged": c.unchanged, "after": c.deflection_after}
    mean = {case: 1e3 * c.mean(value) for case, value in cases.items()}
    place = {case: c.worst(value) for case, value in cases.items()}
    worst = {case: 1e3 * float(value[place[case]]) for case, value in cases.items()}
    point = {case: float(path.index[row]) for case, row in place.items()}
    lost = int((path.counted & ~c.both).sum())
    force = "process force" if new.options.force.given else f"{TEST_FORCE:g} N along the tool axis"
    reached = [
        np.where(p.chosen.assignment.reason == InfeasibilityReason.OK, np.degrees(compute_gamma(p)), np.nan)[rows]
        for p in (old, new)
    ]
    return JobEffectSection(
        toolpath=name,
        sentence=_format_effect_sentence(
            mean, worst, point, float(angle.mean()), share, force, lost, int(path.counted.sum())
        ),
        reason=None,
        force=force,
        points_compared=int(c.both.sum()),
        points_not_reached=lost,
        not_reached_because=(_explain_unreached_point(old) or _explain_unreached_point(new)) if lost else None,
        rotation=RotationChangeSection(
            mean_change_deg=float(angle.mean()), max_change_deg=float(angle.max()), changed_share=share
        ),
        deflection_mm=ModelCasesSection(
            **{case: MeanAndWorstSection(mean=mean[case], worst=worst[case]) for case in cases}
        ),
        worst_point=CasePointsSection(**point),
        changes=(
            _build_change_entry("deflection of the choice so far, mean", mean["before"], mean["unchanged"], "mm"),
            _build_change_entry("deflection of the choice so far, worst", worst["before"], worst["unchanged"], "mm"),
            _build_change_entry("deflection under the new model, mean", mean["unchanged"], mean["after"], "mm"),
            _build_change_entry("deflection under the new model, worst", worst["unchanged"], worst["after"], "mm"),
        ),
        by_finding=_compute_changes_by_finding(cell, old, new, c),
        warnings=tuple(new.setup.elasticity.warnings),
        point=tuple(path.index[rows].tolist()),
        gamma_before_deg=tuple(reached[0].tolist()),
        gamma_after_deg=tuple(reached[1].tolist()),
        deflection_before_mm=tuple((1e3 * c.deflection_before[rows]).tolist()),
        deflection_unchanged_mm=tuple((1e3 * c.unchanged[rows]).tolist()),
        deflection_after_mm=tuple((1e3 * c.deflection_after[rows]).tolist()),
    )


def _format_effect_sentence(
    mean: Mapping[str, float],
    worst: Mapping[str, float],
    point: Mapping[str, float],
    turned: float,
    share: float,
    force: str,
    lost: int,
    cut: int,
) -> str:
    out = (
        f"Under the {force} the rotation chosen so far bends by {mean['unchanged']:.3f} mm in the mean (believed: "
        f"{mean['before']:.3f}), at worst {worst['unchanged']:.3f} mm at point {point['unchanged']:g} (believed: "
        f"{worst['before']:.3f} at point {point['before']:g})"
    )
    if share > 0.0:
        out += (
            f"; chosen anew, the rotation differs at {100.0 * share:.0f} % of the points (by {turned:.0f}° in the mean "
            f"over all) and leaves {mean['after']:.3f} mm in the mean and {worst['after']:.3f} mm at worst"
        )
        unchanged_points = 1.0 - thresholds.SHARES.negligible
        if (
            mean["after"] > unchanged_points * mean["unchanged"]
            and worst["after"] > unchanged_points * worst["unchanged"]
        ):
            out += ", hardly less" if mean["after"] < mean["unchanged"] else ", no less in the mean"
    else:
        out += "; the rotation stays as it is"
    return out + (f". {lost} of {cut} planning points that are cut cannot be compared." if lost else ".")


def _build_empty_effect(name: str, reason: str) -> JobEffectSection:
    message = f"The effect on the toolpath cannot be computed: {reason}"
    return JobEffectSection(toolpath=name, sentence=message, reason=reason, changes=())


def _explain_unreached_point(of: Plan) -> str:
    """Return why the first unreached cutting point is not reached; empty if all are reached."""
    a, path = of.chosen.assignment, of.path
    missing = np.flatnonzero(path.counted & (a.reason != InfeasibilityReason.OK))
    if not len(missing):
        return ""
    row = int(missing[0])
    explanation = explain_points(of).get(row) or InfeasibilityReason(int(a.reason[row])).word
    return f"point {path.index[row]:g}: {explanation}"


def _build_change_entry(what: str, before: float, after: float, unit: str) -> QuantityChangeEntry:
    return QuantityChangeEntry(what=what, before=before, after=after, unit=unit)

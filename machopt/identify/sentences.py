"""Warnings and notes of an identification, as sentences for people."""

from __future__ import annotations

import numpy as np

from machopt.domain.results.identification import not_identified
from machopt.domain.stiffness import spring_text
from machopt.identify import calibrated
from machopt.identify.fit import Fit
from machopt.identify.heldout import Errors
from machopt.identify.identifiability import Settled
from machopt.identify.influence import Outlier
from machopt.identify.uncertainty import Uncertainty

SHOWN = 5


def warnings(
    fit: Fit, sure: Uncertainty, settled: Settled, own: Errors, unseen: Errors, aside: tuple[Outlier, ...]
) -> list[str]:
    """What a user has to know before using the result."""
    out = []
    if sure.unseen.shape[1]:
        names = [
            u.name
            for u, row in zip(fit.unknowns, sure.unseen, strict=True)
            if np.abs(row).max() > calibrated.IDENTIFIED.moves_together
        ]
        out.append(
            f"singular design: no reading tells {', '.join(names)} apart, or shows them at all; other poses and loads "
            "are needed"
        )
    out += [not_identified(j + 1, s.reason) for j, s in enumerate(settled.standing[:6]) if not s.identified]
    for t, term in enumerate(fit.terms):
        own_ones = [s for u, s in zip(fit.unknowns, settled.standing, strict=True) if u.term == t]
        if not any(s.identified for s in own_ones):
            reasons = dict.fromkeys(s.reason for s in own_ones)
            out.append(f"{term.effect} at {term.location} is not found and left out: {'; '.join(reasons)}")
    for p, u in enumerate(fit.unknowns):
        if np.isfinite(u.lower) and fit.free[p] + calibrated.IDENTIFIED.below_bound * sure.sigma[p] < u.lower:
            out.append(
                f"without its bound, the compliance of {u.name} would be negative by "
                f"{abs(fit.free[p]) / sure.sigma[p]:.1f} standard errors: the model lacks something, or the record is "
                "wrong"
            )
    for t in settled.mended:
        term = fit.terms[t]
        out.append(
            f"{term.effect} at {term.location}: as fitted it would move against a load in some direction, which no "
            "structure does; the best fit that does not is given instead, fewer coefficients (form: diagonal) would be "
            "surer"
        )
    if own.explained < calibrated.IDENTIFIED.explains_little:
        out.append(
            f"the model explains only {100 * own.explained:.0f} % of the squared displacements"
            if own.explained > 0
            else "the model explains none of the displacements"
        )
    if unseen.rmse > calibrated.IDENTIFIED.overfitted * own.rmse:
        out.append(
            f"poses that the fit has not seen err by {1e3 * unseen.rmse:.3g} mm, seen ones by {1e3 * own.rmse:.3g} mm: "
            "too few poses for the unknowns, or stiffness that changes with the pose"
        )
    stated = fit.experiment.uncertainty
    for value, scatter, unit, factor in zip(
        (stated.displacement, stated.rotation),
        fit.weighting.scatter(fit.clusters),
        ("mm", "mrad"),
        (1e3, 1e3),
        strict=False,
    ):
        if value is not None and fit.weighted and scatter.reading > calibrated.IDENTIFIED.stated_off * value:
            out.append(
                f"readings scatter by {factor * scatter.reading:.3g} {unit} about the model, {factor * value:.3g} "
                f"{unit} are stated: physics that the model lacks, or a measurement that is worse than stated"
            )
    if aside:
        places = list(dict.fromkeys(o.place for o in aside))
        more = f" and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        out.append(f"put aside as outliers: {', '.join(places[:SHOWN])}{more}")
    return out


def notes(fit: Fit, sure: Uncertainty, settled: Settled) -> tuple[str, ...]:
    """How noise and values came about."""
    stated = fit.experiment.uncertainty
    out = []
    if fit.weighted:
        for name, scatter, factor, unit, own in zip(
            ("displacement", "rotation"),
            fit.weighting.scatter(fit.clusters),
            (1e6, 1e6),
            ("µm", "µrad"),
            (stated.displacement, stated.rotation),
            strict=False,
        ):
            shared = [
                f"{factor * v:.3g} {unit} shared by a {level}"
                for v, level in ((scatter.cycle, "load cycle"), (scatter.visit, "visit to a pose"))
                if v is not None
            ]
            said = (
                "stated and checked against the residuals"
                if own is not None
                else "not stated, taken from the residuals"
            )
            out.append(
                f"{name} errors, 1 sigma of a coordinate: {factor * scatter.reading:.3g} {unit} a reading"
                + "".join(f", {s}" for s in shared)
                + ("" if shared else " (no replicates: what readings of a pose share cannot be told apart)")
                + f"; {said}"
            )
    else:
        out.append("unweighted: every coordinate counts alike")
    out.append(
        f"{100 * sure.level:.0f} % intervals: cluster-robust, errors within a pose taken as dependent "
        f"({fit.clusters.poses} pose{'s' if fit.clusters.poses > 1 else ''})"
    )
    for j, s in enumerate(settled.standing[:6]):
        if not s.identified:
            held = "at a bound" if settled.replaced[j] else "drawn to the cell's value or to a bound"
            stiffness = 1 / settled.x[j] if settled.x[j] else np.inf
            out.append(f"joint {j + 1} stands at {spring_text(stiffness)}, {held}; that is not a measurement")
    return tuple(out)

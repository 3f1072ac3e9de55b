"""Section of the diagnosis page with residual vectors on the arm, before and after, at the measured poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from machopt.report.charts.scene_json import Spec, build_posture_view
from machopt.report.page_shell import build_section
from machopt.report.page_types.diagnosis_page_data import DiagnosisPageData
from machopt.report.page_types.display_units import FINE_LENGTH
from machopt.report.scene.scene_types import PostureNeedles, PostureVectors, ScenePostures
from machopt.report.template_rendering import render_macro, render_part
from machopt.report.wording.diagnosis_terms import has_machine_finding

if TYPE_CHECKING:
    from markupsafe import Markup

BEFORE, AFTER = "#b3261e", "#1d9a6c"
_MAX_POSES = 200  # to step through: those with the largest residuals
_MAX_NEEDLES = 4000


def build_residual_scene(data: DiagnosisPageData) -> Spec | None:
    """Return the view for ``assets/posture.js``; None where residuals are no displacements or the arm is unknown.

    Args:
        data: The data of the page.
    """
    d = data.diagnosis
    if data.scene is None or d.channel == "torque" or d.errors.residual.shape[1] < 3 or len(data.q) != len(d.used):
        return None
    before, after = d.errors.residual[:, :3], d.errors.final[:, :3]  # m, base axes
    seen = d.used & np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1) & np.isfinite(data.q).all(axis=1)
    size = np.where(seen, np.linalg.norm(before, axis=1), -1.0)
    rows = {int(p): np.flatnonzero(seen & (data.pose == p)) for p in np.unique(data.pose[seen])}
    most = sorted(rows, key=lambda p: -float(np.mean(size[rows[p]] ** 2)))[:_MAX_POSES]
    poses = sorted(most)
    if not poses:
        return None
    worst = np.array([rows[p][int(np.argmax(size[rows[p]]))] for p in poses])
    both = has_machine_finding(d)
    longest = float(max(size.max(), np.linalg.norm(after[seen], axis=1).max())) or 1.0
    of = np.concatenate([np.full(len(rows[p]), k) for k, p in enumerate(poses)])
    which = np.concatenate([rows[p] for p in poses])
    every = max(1, -(-len(which) // _MAX_NEEDLES))
    of, which = of[::every], which[::every]
    rms = [[float(np.sqrt(np.mean(np.sum(v[rows[p]] ** 2, axis=1)))) for v in (before, after)] for p in poses]
    postures = ScenePostures(
        q=data.q[worst],
        label="Pose",
        names=tuple(f"Pose {p}" for p in poses),
        words=tuple(
            (
                ("Readings", str(len(rows[p]))),
                *_list_residual_sizes(
                    rms[k], float(size[worst[k]]), float(np.linalg.norm(after[worst[k]])), data.row[worst[k]], both
                ),
            )
            for k, p in enumerate(poses)
        ),
        vectors=(
            PostureVectors("before, the largest of this pose", BEFORE, before[worst], longest),
            PostureVectors("the same reading after", AFTER, after[worst], longest),
        )
        if both
        else (PostureVectors("the largest of this pose", BEFORE, before[worst], longest),),
        needles=(
            PostureNeedles(BEFORE, of, before[which], longest),
            *([PostureNeedles(AFTER, of, after[which], longest)] if both else []),
        ),
    )
    return build_posture_view("Residuals at the arm's poses", data.scene, postures)


def _list_residual_sizes(rms: list[float], worst: float, after: float, row: int, both: bool) -> list[tuple[str, str]]:
    """Return the text of a pose; without a finding of the machine, before and after are the same and not repeated."""
    size = f"{FINE_LENGTH.format_value(worst, unit=True)}, row {row}"
    if not both:
        return [("Residual, rms", FINE_LENGTH.format_value(rms[0], unit=True)), ("Largest", size)]
    return [
        ("Residual before, rms", FINE_LENGTH.format_value(rms[0], unit=True)),
        ("After, rms", FINE_LENGTH.format_value(rms[1], unit=True)),
        ("Largest before", size),
        ("The same after", FINE_LENGTH.format_value(after, unit=True)),
    ]


def build_residual_html(view: Spec | None) -> Markup | str:
    """Return the section with the view; empty without a view.

    Args:
        view: The 3-D view.
    """
    if view is None:
        return ""
    longest = 1.0 / view["postures"]["vectors"][0]["length"]
    both = len(view["postures"]["vectors"]) > 1
    lead = (
        f"What is measured less what is predicted, as lines from the tool of every pose{_COLOUR_NOTE if both else ''}; "
        f"each reading predicted by fits that never saw it. All to one scale, the longest {1e3 * longest:.3f} mm. "
        "Lines of one direction everywhere speak for the record or the base; those turning with an axis for that axis."
    )
    body = render_macro("report.html", "view")
    body += render_part("note", _OMITTED_NOTE) if len(view["postures"]["names"]) == _MAX_POSES else ""
    return build_section("space", "At the arm", lead, body)


_COLOUR_NOTE = ", red before and green after"
_OMITTED_NOTE = f"At most {_MAX_POSES} poses, those with the largest residuals; outliers are left out."

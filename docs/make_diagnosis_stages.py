"""Write diagnosis-stages.md beside this file: the table of stages of the model selection, with the ablation figures.

``python docs/make_diagnosis_stages.py``; a test holds that the page is current. The figures are those of
benchmarks/diagnosis_stage_ablation.json, which ``benchmarks/diagnosis_stage_ablation.py --json`` writes.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent.parent / "benchmarks"))

from diagnosis_stage_ablation import list_selection_stages

PAGE = Path(__file__).with_name("diagnosis-stages.md")
FIGURES = Path(__file__).resolve().parent.parent / "benchmarks" / "diagnosis_stage_ablation.json"
INTRODUCTION = """# Stages of a diagnosis

The model selection of `machopt diagnose` executes these tables, in this order; they are in
`measurement/diagnosis/model_selection/`. Thresholds: `python benchmarks/diagnosis_thresholds.py`. What a stage is good
for is measured by leaving it out: answers that change, of {cases} recordings of the energy simulator; names that are
wrong then, or no longer wrong (+, −); right names that are lost or won (−, +).
Command: `python benchmarks/diagnosis_stage_ablation.py {folder}`; patterns and seeds of the recordings, for
`run_energy_benchmark.py --only`, are in `benchmarks/diagnosis_stage_ablation.json`. {cases} recordings are too few to
say that a stage without an effect is unnecessary. The figures are older than the merging of thresholds (30 Nov 2026).
"""


def page() -> str:
    """Return the page."""
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    lines = [INTRODUCTION.format(cases=figures["cases"], folder="out/ablation")]
    title = ""
    for when, stage in list_selection_stages():
        if when != title:
            title = when
            lines += [
                "",
                f"## {when[0].upper()}{when[1:]}",
                "",
                "| stage | statistic | decides at | source | can reject |",
            ]
            lines[-1] += " without it: answers | wrong names | right names |"
            lines.append("|" + "---|" * 8)
        lines.append(
            f"| {stage.name} | {stage.statistic} | {', '.join(f'`{k}`' for k in stage.levels) or '–'} "
            f"| {stage.reference} | {stage.rejects} | {_format_figures(figures['stages'].get(stage.name))} |"
        )
    return "\n".join(lines) + "\n"


def _format_figures(figures: dict[str, int] | None) -> str:
    """Return three cells of the table: answers, wrong names, right names."""
    if figures is None:
        return "– | – | –"
    wrong = f"+{figures['wrong names more']} −{figures['wrong names less']}"
    right = f"−{figures['right names lost']} +{figures['right names won']}"
    return f"{figures['answers changed']} | {wrong} | {right}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

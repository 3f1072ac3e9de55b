"""Description of one stage of the model selection, as docs/diagnosis-stages.md lists it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SelectionStage:
    """One stage: what it measures, where it decides, and what it can reject."""

    name: str  # key in benchmarks/diagnosis_stage_ablation.py
    statistic: str  # what is computed
    levels: tuple[str, ...]  # keys of the thresholds that decide, as "table.name"; empty if none does
    reference: str  # publication or principle of the statistic
    rejects: str  # what the stage can reject or change

"""Origin of a threshold's value."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ThresholdOrigin:
    """Origin of a value."""

    method: str  # "measured", "statistics", "published" or "judgement"
    script: str = ""  # script that determined it
    cases: str = ""  # case set of the script
    date: str = ""
    seeds: str = ""  # seeds of the case set, if recorded

    def describe(self) -> str:
        """Describe the origin in words."""
        if not self.script:
            return self.method
        drawn = f" --seed {self.seeds}" if self.seeds else ""
        return f"{self.method}, {self.script} --set {self.cases}{drawn}, {self.date}"


DEV = ThresholdOrigin("measured", "benchmarks/diagnosis_chain_benchmark/run_chain_benchmark.py", "dev", "2026-11-21")
POSES = ThresholdOrigin(
    "measured", "benchmarks/diagnosis_energy_benchmark/run_energy_benchmark.py", "dev", "2026-11-26"
)
STATISTICS = ThresholdOrigin("statistics")  # follows from its statistical meaning
PUBLISHED = ThresholdOrigin("published")  # the meaning names the publication
JUDGEMENT = ThresholdOrigin("judgement")  # chosen by an engineer; no set of cases set it


def define_threshold(default: float, why: str, origin: ThresholdOrigin) -> Any:
    """Define a dataclass field for a threshold.

    Args:
        default: Value of the threshold.
        why: Meaning of the value.
        origin: Origin of the value.

    Returns:
        The dataclass field.
    """
    return field(default=default, metadata={"why": why, "origin": origin})

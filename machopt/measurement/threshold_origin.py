"""Where the number of a threshold comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ThresholdOrigin:
    """Where a number comes from."""

    method: str  # "measured", "statistics" or "judgement"
    script: str = ""  # that it was set by
    cases: str = ""  # set of the script
    date: str = ""
    seeds: str = ""  # draws of the set, where that was written down

    def describe(self) -> str:
        """In words."""
        if not self.script:
            return self.method
        drawn = f" --seed {self.seeds}" if self.seeds else ""
        return f"{self.method}, {self.script} --set {self.cases}{drawn}, {self.date}"


DEV = ThresholdOrigin("measured", "benchmarks/concealed/run.py", "dev", "2026-11-21")
LOAD_TESTS = ThresholdOrigin("measured", "benchmarks/stranger/run.py", "dev", "2026-11-23")
POSES = ThresholdOrigin("measured", "benchmarks/stranger/run.py", "dev", "2026-11-26")
VERDICTS = ThresholdOrigin(
    "measured", "benchmarks/stranger/run.py", "dev", "2026-11-26", "240, 249, 401, 402, 403, 405"
)
STATISTICS = ThresholdOrigin("statistics")  # follows from what it means
JUDGEMENT = ThresholdOrigin("judgement")  # chosen by an engineer; no set of cases set it


def define_threshold(default: float, why: str, origin: ThresholdOrigin) -> Any:
    return field(default=default, metadata={"why": why, "origin": origin})

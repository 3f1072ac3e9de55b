"""Where the number of a threshold comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Origin:
    """Where a number comes from."""

    how: str  # "measured", "statistics" or "judgement"
    script: str = ""  # that it was set by
    cases: str = ""  # set of the script
    date: str = ""
    seeds: str = ""  # draws of the set, where that was written down

    def told(self) -> str:
        """In words."""
        if not self.script:
            return self.how
        drawn = f" --seed {self.seeds}" if self.seeds else ""
        return f"{self.how}, {self.script} --set {self.cases}{drawn}, {self.date}"


DEV = Origin("measured", "benchmarks/concealed/run.py", "dev", "2026-11-21")
LOAD_TESTS = Origin("measured", "benchmarks/stranger/run.py", "dev", "2026-11-23")
POSES = Origin("measured", "benchmarks/stranger/run.py", "dev", "2026-11-26")
VERDICTS = Origin("measured", "benchmarks/stranger/run.py", "dev", "2026-11-26", "240, 249, 401, 402, 403, 405")
STATISTICS = Origin("statistics")  # follows from what it means
JUDGED = Origin("judgement")  # no set of cases set it; what cases say of it: machopt/estimate/room.py


def threshold(default: float, why: str, origin: Origin) -> Any:
    return field(default=default, metadata={"why": why, "origin": origin})

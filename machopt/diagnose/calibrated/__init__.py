"""The thresholds that decide what a diagnosis says, by concern, each with where its number comes from.

Numbers that only set how finely something is computed stand beside the computation, grids of shapes in the effects.
``python benchmarks/thresholds.py`` prints this table with the rates of false alarms and misses of a set of concealed
cases, and runs them again with a threshold set otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

from machopt.diagnose.calibrated.channels import Motion, Resting
from machopt.diagnose.calibrated.decisions import Detection, NoiseLevels, Proof, Recorded
from machopt.diagnose.calibrated.origin import Origin

__all__ = ["DETECTION", "MOTION", "NOISE", "PROOF", "RECORD", "RESTING", "Origin", "Threshold", "every"]

DETECTION, PROOF, NOISE, RECORD = Detection(), Proof(), NoiseLevels(), Recorded()
RESTING, MOTION = Resting(), Motion()


@dataclass(frozen=True)
class Threshold:
    """One line of the table."""

    concern: str  # name of the table
    name: str
    value: float
    why: str
    origin: Origin


def every() -> Iterator[Threshold]:
    """All thresholds as they are in force, table by table."""
    for concern in ("DETECTION", "PROOF", "NOISE", "RECORD", "RESTING", "MOTION"):
        table = globals()[concern]
        for f in fields(table):
            yield Threshold(concern, f.name, getattr(table, f.name), f.metadata["why"], f.metadata["origin"])

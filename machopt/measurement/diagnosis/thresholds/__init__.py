"""Decision thresholds of a diagnosis by topic, each with the origin of its value.

Numbers that only control the resolution of a computation are defined next to the computation, and shape grids in the
effects. ``python benchmarks/diagnosis_thresholds.py`` prints the table with false-positive and false-negative rates on
concealed cases, and the same rates with another value of a threshold.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields

from machopt.measurement.diagnosis.thresholds.decision_thresholds import (
    DetectionThresholds,
    NoiseThresholds,
    ProofThresholds,
    RecordingThresholds,
)
from machopt.measurement.diagnosis.thresholds.static_and_motion_thresholds import MotionThresholds, StaticThresholds
from machopt.measurement.estimation import thresholds as estimate
from machopt.measurement.identification import thresholds as identify
from machopt.measurement.threshold_origin import ThresholdOrigin

__all__ = [
    "DETECTION",
    "MOTION",
    "NOISE",
    "PROOF",
    "RECORD",
    "RESTING",
    "TABLES",
    "ThresholdEntry",
    "ThresholdOrigin",
    "list_thresholds",
]

DETECTION, PROOF, NOISE, RECORD = DetectionThresholds(), ProofThresholds(), NoiseThresholds(), RecordingThresholds()
RESTING, MOTION = StaticThresholds(), MotionThresholds()


@dataclass(frozen=True)
class ThresholdEntry:
    """One row of the table of thresholds."""

    concern: str  # name of the table
    name: str
    value: float
    meaning: str
    origin: ThresholdOrigin

    @property
    def key(self) -> str:
        """Name in commands and tables."""
        return f"{self.concern.lower()}.{self.name}"


TABLES = {  # topic: module that holds the table
    "DETECTION": sys.modules[__name__],
    "PROOF": sys.modules[__name__],
    "NOISE": sys.modules[__name__],
    "RECORD": sys.modules[__name__],
    "RESTING": sys.modules[__name__],
    "MOTION": sys.modules[__name__],
    "CHECKED": identify,
    "IDENTIFIED": identify,
    "ESTIMATED": estimate,
}


def list_thresholds() -> Iterator[ThresholdEntry]:
    """Iterate over all thresholds in force, including those of identification and estimation."""
    for concern, module in TABLES.items():
        table = getattr(module, concern)
        for f in fields(table):
            yield ThresholdEntry(concern, f.name, getattr(table, f.name), f.metadata["why"], f.metadata["origin"])

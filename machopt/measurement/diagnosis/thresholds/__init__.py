"""The thresholds that decide what a diagnosis says, by concern, each with the origin of its value.

Numbers that only set how finely something is computed stay in the module of the computation. Grids of shapes are in the
effects. ``python benchmarks/thresholds.py`` prints this table, the rates of false alarms and misses on concealed cases,
and the same rates with another value of a threshold.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields

from machopt.measurement.diagnosis.thresholds.channel_thresholds import MotionThresholds, StaticThresholds
from machopt.measurement.diagnosis.thresholds.decision_thresholds import (
    DetectionThresholds,
    NoiseThresholds,
    ProofThresholds,
    RecordingThresholds,
)
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
    """One line of the table."""

    concern: str  # name of the table
    name: str
    value: float
    meaning: str
    origin: ThresholdOrigin

    @property
    def key(self) -> str:
        """As commands and tables name it."""
        return f"{self.concern.lower()}.{self.name}"


TABLES = {  # concern: where the table stands
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
    """All thresholds as they are in force, table by table; those of identification and estimation, too."""
    for concern, module in TABLES.items():
        table = getattr(module, concern)
        for f in fields(table):
            yield ThresholdEntry(concern, f.name, getattr(table, f.name), f.metadata["why"], f.metadata["origin"])

"""The thresholds that decide what a diagnosis says, by concern, each with where its number comes from.

Numbers that only set how finely something is computed stand beside the computation, grids of shapes in the effects.
``python benchmarks/thresholds.py`` prints this table with the rates of false alarms and misses of a set of concealed
cases, and runs them again with a threshold set otherwise; with ``--room`` it measures how far each may move.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields

from machopt.diagnose.calibrated.channels import Motion, Resting
from machopt.diagnose.calibrated.decisions import Detection, NoiseLevels, Proof, Recorded
from machopt.estimate import calibrated as estimate
from machopt.estimate.origin import Origin
from machopt.estimate.room import Room, measured
from machopt.identify import calibrated as identify

__all__ = [
    "DETECTION",
    "MOTION",
    "NOISE",
    "PROOF",
    "RECORD",
    "RESTING",
    "TABLES",
    "Origin",
    "Room",
    "Threshold",
    "every",
    "measured",
]

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

    @property
    def key(self) -> str:
        """As commands and tables name it."""
        return f"{self.concern.lower()}.{self.name}"

    @property
    def room(self) -> Room:
        """What concealed cases say of it.

        Raises:
            KeyError: nothing was measured of it.
        """
        return measured().rooms[self.key]


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


def every() -> Iterator[Threshold]:
    """All thresholds as they are in force, table by table; those of identification and estimation, too."""
    for concern, module in TABLES.items():
        table = getattr(module, concern)
        for f in fields(table):
            yield Threshold(concern, f.name, getattr(table, f.name), f.metadata["why"], f.metadata["origin"])

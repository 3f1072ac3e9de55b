"""What is not elastic and yet moves the TCP: corrections between a joint's encoder and its true angle.

The true angle of joint j is q_j + Δ_j(q), q what the encoders say and every Δ the sum of the corrections at j. Planner
and verification make their own code of these entries; here they stand as kinematics.yaml and diagnosis.json hold them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol


class CorrectionEntry(Protocol):
    """What :class:`KinematicCorrection` and the diagnosis' findings have in common."""

    @property
    def effect(self) -> str: ...

    @property
    def location(self) -> str: ...

    @property
    def parameters(self) -> Mapping[str, Any]: ...


@dataclass(frozen=True)
class KinematicCorrection:
    """One entry. ``parameters`` are the file's own keys, which carry their units.

    * ``joint_zero_offset`` at ``joint:j``: ``offset_deg``; Δ_j = offset.
    * ``transmission_error`` at ``joint:j``: ``per_turn``, ``cos_arcsec``, ``sin_arcsec``, each a number or lists of the
      same length; Δ_j = Σ a cos(N q_j) + b sin(N q_j).
    * ``joint_coupling`` at ``joint:i-j``, i < j: ``ratio``; Δ_j = ratio q_i.
    """

    effect: str
    location: str
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Kinematics:
    """All corrections of an arm."""

    corrections: tuple[KinematicCorrection, ...] = ()
    file: Path | None = field(default=None, compare=False)  # it was read from, for messages

    def __bool__(self) -> bool:
        return bool(self.corrections)


def extended(known: Kinematics | None, found: tuple[CorrectionEntry, ...]) -> Kinematics:
    """The corrections known so far and what was found on top of them.

    Zero offsets and couplings of the same place add up; waves stand beside each other, the same order adds up.
    """
    out: dict[tuple[str, str], dict[str, Any]] = {}
    for entry in (*(known.corrections if known else ()), *found):
        name = (entry.effect, entry.location)
        if name not in out:
            out[name] = dict(entry.parameters)
        elif entry.effect == "transmission_error":
            out[name] = _waves(out[name], entry.parameters)
        else:
            out[name] = {key: out[name][key] + value for key, value in entry.parameters.items()}
    return Kinematics(tuple(KinematicCorrection(e, w, p) for (e, w), p in out.items()))


def waves(parameters: Mapping[str, Any]) -> list[tuple[float, float, float]]:
    """(per_turn, cos_arcsec, sin_arcsec) of each wave of a transmission error."""
    columns = []
    for key in ("per_turn", "cos_arcsec", "sin_arcsec"):
        value = parameters[key]
        columns.append([float(v) for v in value] if isinstance(value, list | tuple) else [float(value)])
    return list(zip(*columns, strict=True))


def _waves(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    total: dict[float, tuple[float, float]] = {}
    for order, cos, sin in (*waves(a), *waves(b)):
        c, s = total.get(order, (0.0, 0.0))
        total[order] = (c + cos, s + sin)
    rows = [(order, *total[order]) for order in sorted(total)]
    lists = dict(zip(("per_turn", "cos_arcsec", "sin_arcsec"), map(list, zip(*rows, strict=True)), strict=True))
    return {key: value[0] if len(rows) == 1 else value for key, value in lists.items()}

"""Measured frequency responses of an arm: receptance per frequency, pose and pair of directions, SI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from machopt.numerics.array_types import Array, ComplexArray, Ints, make_arrays_read_only


@dataclass(frozen=True, kw_only=True)
class FrequencyResponseRecording:
    """N rows of G responses; a response has one pose, one direction of excitation and one of response."""

    source: str  # name of the folder
    files: tuple[Path, ...]
    file: Ints  # (N,) index into ``files``
    line: Ints  # (N,) 1-based
    frequency: Array  # (N,) Hz, > 0
    receptance: ComplexArray  # (N,) m/N, displacement over force
    coherence: Array | None  # (N,) 0 … 1; None: not measured
    q: Array  # (N, 6) rad, joint positions by encoder
    excitation: Array  # (N, 3) unit, direction of the force, axes of ``frame``
    response: Array  # (N, 3) unit, direction of the displacement
    group: Ints  # (N,) number of the response, from 0
    frame: Literal["base", "tool"]
    excitation_point: Array | None  # (3,) m in flange; None: the TCP
    response_point: Array | None  # (3,) m in flange; None: the TCP
    mass_sigma: float | None  # 1 sigma of the mass and inertia of each link, relative; None: not stated
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def __len__(self) -> int:
        return len(self.line)

    @property
    def responses(self) -> int:
        """Number of responses G."""
        return int(self.group.max()) + 1

    def format_place(self, row: int) -> str:
        """Return file and line of a row: ``data.csv line 12``.

        Args:
            row: row, from 0.
        """
        return f"{self.files[self.file[row]].name} line {self.line[row]}"

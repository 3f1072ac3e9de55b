"""``machopt.identify``: stiffness from load–deflection readings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from machopt.api.asked import NOWHERE, asked, paths
from machopt.api.cell import Cell, cell_of
from machopt.api.saved import Named, Progress, effects_of, saved, silent
from machopt.arrays import Array
from machopt.domain.results.identification import IdentificationResult
from machopt.identify.asked import IdentifyRequest
from machopt.services.identified import Identified, identified
from machopt.services.identify import write


@dataclass(frozen=True)
class Identification:
    """An identified stiffness. :func:`identify` makes one."""

    cell: Cell
    _made: Identified

    @property
    def result(self) -> IdentificationResult:
        """identification.json, typed."""
        return self._made.result

    @property
    def joint_stiffness(self) -> Array:
        """(6,) constant joint stiffness, N·m/rad."""
        out = np.array(self._made.identification.stiffness.joints)
        out.setflags(write=False)
        return out

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    def save(self, out: Named, *, force: bool = False) -> Path:
        """Write what ``machopt identify`` writes; returns its stiffness.yaml, for :meth:`Cell.with_stiffness`.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        saved(self.cell, out, lambda folder: write(self._made, folder), force=force)
        return Path(out) / "stiffness.yaml"

    def __repr__(self) -> str:
        return f"<Identification of {self.cell.name!r} from {self.result.readings} readings>"


def identify(
    cell: Cell | Named, recordings: Named | Iterable[Named], *, progress: Progress = silent, **options: Any
) -> Identification:
    """Joint (and further) stiffness from load–deflection readings: ``machopt identify``.

    Args:
        cell: a cell, or the path of its folder.
        recordings: a recording folder, or several of the same robot.
        progress: told what is being done.
        options: as :class:`machopt.identify.asked.IdentifyRequest` has them, e.g. ``model="constant"``, ``seed=1``.

    Raises:
        InputError: bad cell, recording or option; a record that cannot be right.
    """
    a_cell = cell_of(cell)
    request = asked(
        IdentifyRequest,
        options,
        cell=a_cell.path,
        recordings=paths(recordings, "recordings"),
        out=NOWHERE,
        allow_external=a_cell.allow_external,
        effects=tuple(own.file for own in a_cell.effects),
    )
    with effects_of(a_cell):
        return Identification(a_cell, identified(request, progress, a_cell.description))

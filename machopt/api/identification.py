"""``machopt.measurement.identification``: stiffness from load–deflection readings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from machopt.api.cell import Cell, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import IdentifyOptions
from machopt.api.request_options import NOWHERE, build_request, convert_to_paths
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result, use_cell_effects
from machopt.commands.identify.computation import IdentifyComputation, compute_identification
from machopt.commands.identify.run import write_identification_files
from machopt.data_types.documents.identification_document import IdentificationDocument
from machopt.measurement.identification.request import IdentifyRequest
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class Identification:
    """Identified stiffness. :func:`identify` makes one."""

    cell: Cell
    _made: IdentifyComputation

    @property
    def result(self) -> IdentificationDocument:
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

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> Path:
        """Write what ``machopt identify`` writes; returns its stiffness.yaml, for :meth:`Cell.with_stiffness`.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        save_result(self.cell, out, lambda folder: write_identification_files(self._made, folder), force=force)
        return Path(out) / "stiffness.yaml"

    def __repr__(self) -> str:
        return f"<Identification of {self.cell.name!r} from {self.result.readings} readings>"


@use_argument_names()
def identify(
    cell: Cell | Named,
    recordings: Named | Iterable[Named],
    *,
    progress: Progress = ignore_progress,
    **options: Unpack[IdentifyOptions],
) -> Identification:
    """Joint (and further) stiffness from load–deflection readings: ``machopt identify``.

    Args:
        cell: a cell, or the path of its folder.
        recordings: a recording folder, or several of the same robot.
        progress: called with each stage, in words.
        options: as :class:`machopt.measurement.identification.request.IdentifyRequest` has them, e.g.
            ``model="constant"``, ``seed=1``.

    Raises:
        InputError: bad cell, recording or option; a record that cannot be right.
    """
    a_cell = load_cell_argument(cell, for_diagnosis=True)
    request = build_request(
        IdentifyRequest,
        options,
        cell=a_cell.path,
        recordings=convert_to_paths(recordings, "recordings"),
        out=NOWHERE,
        allow_external=a_cell.allow_external,
        effects=tuple(own.file for own in a_cell.effects),
    )
    with use_cell_effects(a_cell):
        return Identification(a_cell, compute_identification(request, progress, a_cell.description))

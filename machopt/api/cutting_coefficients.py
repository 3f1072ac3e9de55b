"""``machopt.measurement.cutting``: cutting coefficients from measured cuts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from machopt.api.cell import Cell, copy_read_only, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import CuttingCoefficientsOptions
from machopt.api.request_options import NOWHERE, build_request, convert_to_path
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result
from machopt.commands.process.run import ProcessComputation, compute_process, write_process_files
from machopt.data_types.documents.coefficients_document import CoefficientsDocument
from machopt.measurement.cutting.request import ProcessRequest
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class CuttingCoefficients:
    """Coefficients of one material. :func:`fit_cutting_coefficients` makes one."""

    cell: Cell
    _made: ProcessComputation

    @property
    def result(self) -> CoefficientsDocument:
        """coefficients.json, typed."""
        return self._made.result

    @property
    def values(self) -> Array:
        """(6,) Ktc, Krc, Kac in N/mm², Kte, Kre, Kae in N/mm."""
        return copy_read_only(np.array([entry.value for entry in self.result.coefficients], float))

    @property
    def covariance(self) -> Array:
        """(6, 6) of :attr:`values`."""
        return copy_read_only(np.array(self.result.covariance, float))

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> Path:
        """Write what ``machopt process`` writes; returns its process.yaml, for ``Cell.load(process=)``.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        save_result(self.cell, out, lambda folder: write_process_files(self._made, folder), force=force)
        return Path(out) / "process.yaml"

    def __repr__(self) -> str:
        return f"<CuttingCoefficients of {self.result.material!r} from {self.result.used} cuts>"


@use_argument_names()
def fit_cutting_coefficients(
    cell: Cell | Named,
    recording: Named,
    *,
    progress: Progress = ignore_progress,
    **options: Unpack[CuttingCoefficientsOptions],
) -> CuttingCoefficients:
    """Cutting coefficients of one material from mean forces or force waveforms of cuts: ``machopt process``.

    Args:
        cell: a cell, or the path of its folder.
        recording: a recording folder of kind ``cutting``.
        progress: called with the name of each stage.
        options: as :class:`machopt.measurement.cutting.request.ProcessRequest` has them, e.g. ``level_percent=95.0``.

    Raises:
        InputError: bad cell, recording or option; cuts that do not determine the coefficients.
    """
    a_cell = load_cell_argument(cell)
    request = build_request(
        ProcessRequest,
        options,
        cell=a_cell.path,
        recording=convert_to_path(recording, "recording"),
        out=NOWHERE,
        allow_external=a_cell.allow_external,
    )
    return CuttingCoefficients(a_cell, compute_process(request, progress, a_cell.description))

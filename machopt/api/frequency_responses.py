"""``machopt.identify_frequency_responses``: joint stiffness and damping from frequency responses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from machopt.api.cell import Cell, copy_read_only, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import FrequencyResponseOptions
from machopt.api.request_options import NOWHERE, build_request, convert_to_path
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result
from machopt.commands.identify.frequency_responses import (
    FrequencyResponseComputation,
    compute_frequency_response_identification,
    write_frequency_response_files,
)
from machopt.data_types.documents.frequency_response_document import FrequencyResponseDocument
from machopt.measurement.identification.frequency_response.request import FrequencyResponseRequest
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class FrequencyResponseIdentification:
    """Identified stiffness and damping. :func:`identify_frequency_responses` makes one."""

    cell: Cell
    _made: FrequencyResponseComputation

    @property
    def result(self) -> FrequencyResponseDocument:
        """frequency_response.json, typed."""
        return self._made.result

    @property
    def joint_stiffness(self) -> Array:
        """(6,) N·m/rad; of a joint that the responses do not determine the value of the prior."""
        return copy_read_only(np.array(self._made.found.stiffness.joints, float))

    @property
    def joint_damping(self) -> Array:
        """(6,) N·m·s/rad by the viscous law, loss factor by the structural one (``result.damping_law``)."""
        return copy_read_only(np.array([joint.damping for joint in self._made.found.joints], float))

    @property
    def is_identified(self) -> tuple[bool, ...]:
        """Whether the responses determine the stiffness of each joint."""
        return tuple(joint.identified for joint in self._made.found.joints)

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
        save_result(self.cell, out, lambda folder: write_frequency_response_files(self._made, folder), force=force)
        return Path(out) / "stiffness.yaml"

    def __repr__(self) -> str:
        return f"<FrequencyResponseIdentification of {self.cell.name!r}: {sum(self.is_identified)} of 6 joints>"


@use_argument_names()
def identify_frequency_responses(
    cell: Cell | Named,
    recording: Named,
    *,
    progress: Progress = ignore_progress,
    **options: Unpack[FrequencyResponseOptions],
) -> FrequencyResponseIdentification:
    """Joint stiffness and damping from frequency responses: ``machopt identify`` with a recording of kind ``frf``.

    Args:
        cell: a cell, or the path of its folder.
        recording: a recording folder of kind ``frf``.
        progress: called with the name of each stage.
        options: as :class:`machopt.measurement.identification.frequency_response.request.FrequencyResponseRequest` has
            them, e.g. ``level_percent=95.0``.

    Raises:
        InputError: bad cell, recording or option; responses that the model does not explain.
    """
    a_cell = load_cell_argument(cell)
    request = build_request(
        FrequencyResponseRequest,
        options,
        cell=a_cell.path,
        recording=convert_to_path(recording, "recording"),
        out=NOWHERE,
        allow_external=a_cell.allow_external,
    )
    return FrequencyResponseIdentification(
        a_cell, compute_frequency_response_identification(request, progress, a_cell.description)
    )

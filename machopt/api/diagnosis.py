"""``machopt.measurement.diagnosis``: where model and recording differ, and which physics is missing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

from machopt.api.cell import Cell
from machopt.api.error_message_translation import use_argument_names
from machopt.api.figure import Figure
from machopt.api.option_types import DiagnoseOptions
from machopt.api.request_options import NOWHERE, build_request, convert_to_path, convert_to_paths
from machopt.api.result_saving import Named, Progress, ignore_progress
from machopt.commands.diagnose.computation import DiagnoseComputation, write_diagnosis_files
from machopt.commands.diagnose.run import compute_diagnosis
from machopt.data_types.documents.diagnosis_document import DiagnosisDocument, FindingEntry
from machopt.effects.user_effects import UserModule, activate_user_effects, run_user_files
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.output import write_output_folder
from machopt.report.svg.machine_diagram import build_machine_picture


@dataclass(frozen=True)
class DiagnosisFigures:
    """Pictures of a diagnosis."""

    _made: DiagnoseComputation

    def machine(self) -> Figure:
        """Return the diagram of the machine from base to tool, with each finding at its place."""
        return Figure(build_machine_picture(self._made.diagnosis))


@dataclass(frozen=True)
class Diagnosis:
    """Effects of a recording that the model lacks. :func:`diagnose` makes one."""

    _made: DiagnoseComputation
    _own: tuple[UserModule, ...]

    @property
    def result(self) -> DiagnosisDocument:
        """diagnosis.json, typed."""
        return self._made.result

    @property
    def verdict(self) -> str:
        """consistent, explained, partly_explained, unexplained or insufficient."""
        return self.result.verdict

    @property
    def findings(self) -> tuple[FindingEntry, ...]:
        """Findings, the most important first: effect, location, parameters with interval, held-out errors."""
        return tuple(self.result.findings)

    @property
    def figures(self) -> DiagnosisFigures:
        return DiagnosisFigures(self._made)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> Path | None:
        """Write what ``machopt diagnose`` writes; returns its stiffness.yaml, None where nothing elastic was fitted.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written.
        """
        with activate_user_effects(self._own), write_output_folder(Path(out), force=force) as folder:
            write_diagnosis_files(self._made, folder)
        return None if self.result.model is None else Path(out) / self.result.model

    def __repr__(self) -> str:
        return f"<Diagnosis of {self._made.cell.name!r}: {self.verdict}, {len(self.findings)} findings>"


@use_argument_names(effects="terms")
def diagnose(
    cell: Cell | Named,
    recordings: Named | Iterable[Named],
    *,
    progress: Progress = ignore_progress,
    **options: Unpack[DiagnoseOptions],
) -> Diagnosis:
    """Where model and recording differ, what physics is missing, the extended model: ``machopt diagnose``.

    Args:
        cell: a cell, or the path of its folder; by path, a recorded motion may be of any chain of joints.
        recordings: a recording folder, or several of the same robot.
        progress: called with each stage, in words.
        options: as :class:`machopt.measurement.diagnosis.request.DiagnoseRequest` has them, e.g.
            ``toolpath="part.nc"``,
            ``max_findings=2``; ``terms`` names Python files with laws of your own, whose code is **run**.

    Raises:
        InputError: bad cell, recording, law or option.
    """
    loaded = cell.unchanged() if isinstance(cell, Cell) else None
    request = build_request(
        DiagnoseRequest,
        options,
        cell=convert_to_path(cell.path if isinstance(cell, Cell) else cell, "cell"),
        recordings=convert_to_paths(recordings, "recordings"),
        out=NOWHERE,
        allow_external=loaded is not None and loaded.allow_external,
    )
    own = (*(loaded.effects if loaded is not None else ()), *run_user_files(request.terms))
    with activate_user_effects(own):
        return Diagnosis(compute_diagnosis(request, own, progress, None if loaded is None else loaded.description), own)

"""``machopt.diagnose``: where model and recording differ, and which physics is missing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machopt.api.asked import NOWHERE, asked, path_of, paths
from machopt.api.cell import Cell
from machopt.api.figure import Figure
from machopt.api.saved import Named, Progress, silent
from machopt.diagnose.nouns.asked import DiagnoseRequest
from machopt.domain.results.diagnosis import DiagnosisResult, FindingTold
from machopt.effects.own import Own, in_use, run
from machopt.output import output_folder
from machopt.report.diagnosis_svg import machine_strip
from machopt.services.diagnose import diagnosed
from machopt.services.diagnosed import Diagnosed, write


@dataclass(frozen=True)
class DiagnosisFigures:
    """Pictures of a diagnosis."""

    _made: Diagnosed

    def machine(self) -> Figure:
        """The machine from base to tool, with what was found where it sits."""
        return Figure(machine_strip(self._made.diagnosis))


@dataclass(frozen=True)
class Diagnosis:
    """What a model leaves out of a recording. :func:`diagnose` makes one."""

    _made: Diagnosed
    _own: tuple[Own, ...]

    @property
    def result(self) -> DiagnosisResult:
        """diagnosis.json, typed."""
        return self._made.result

    @property
    def verdict(self) -> str:
        """consistent, explained, partly_explained, unexplained or insufficient."""
        return self.result.verdict

    @property
    def findings(self) -> tuple[FindingTold, ...]:
        """What was found, the most important first: effect, location, parameters with interval, held-out errors."""
        return tuple(self.result.findings)

    @property
    def figures(self) -> DiagnosisFigures:
        return DiagnosisFigures(self._made)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    def save(self, out: Named, *, force: bool = False) -> Path | None:
        """Write what ``machopt diagnose`` writes; returns its stiffness.yaml, None where nothing elastic was fitted.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written.
        """
        with in_use(self._own), output_folder(Path(out), force=force) as folder:
            write(self._made, folder)
        return None if self.result.model is None else Path(out) / self.result.model

    def __repr__(self) -> str:
        return f"<Diagnosis of {self._made.cell.name!r}: {self.verdict}, {len(self.findings)} findings>"


def diagnose(
    cell: Cell | Named, recordings: Named | Iterable[Named], *, progress: Progress = silent, **options: Any
) -> Diagnosis:
    """Where model and recording differ, what physics is missing, the extended model: ``machopt diagnose``.

    Args:
        cell: a cell, or the path of its folder; by path, a recorded motion may be of any chain of joints.
        recordings: a recording folder, or several of the same robot.
        progress: told what is being done.
        options: as :class:`machopt.diagnose.nouns.asked.DiagnoseRequest` has them, e.g. ``toolpath="part.nc"``,
            ``max_findings=2``; ``terms`` names Python files with laws of your own, whose code is **run**.

    Raises:
        InputError: bad cell, recording, law or option.
    """
    loaded = cell.unchanged() if isinstance(cell, Cell) else None
    request = asked(
        DiagnoseRequest,
        options,
        cell=path_of(cell.path if isinstance(cell, Cell) else cell, "cell"),
        recordings=paths(recordings, "recordings"),
        out=NOWHERE,
        allow_external=loaded is not None and loaded.allow_external,
    )
    own = (*(loaded.effects if loaded is not None else ()), *run(request.terms))
    with in_use(own):
        return Diagnosis(diagnosed(request, own, progress, None if loaded is None else loaded.description), own)

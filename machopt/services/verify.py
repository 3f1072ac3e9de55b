"""``machopt verify``: an output folder of optimize held against cell and toolpath."""

from __future__ import annotations

from dataclasses import dataclass, replace

from machopt.domain.manifest import Manifest, with_scope
from machopt.domain.results.optimize import InformationTold
from machopt.domain.results.verified import CheckMade, VerifyResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.absolute_accuracy import apply_absolute_accuracy
from machopt.formats.cell import load_cell
from machopt.formats.toolchoice import with_tools
from machopt.output.manifest import read_manifest
from machopt.recheck.age import made_otherwise
from machopt.recheck.folder import verify_folder
from machopt.recheck.inforce import VerifyRequest, in_force
from machopt.recheck.scope import NOT_RECOMPUTED, not_run, unchecked
from machopt.services.inputs import cell_inputs, distinct, single
from machopt.services.knownrobot import known_robot
from machopt.verify import Verification


@dataclass(frozen=True)
class Verified:
    """What was found."""

    verification: Verification
    exit_code: int  # 0, 3 (intact, but no feasible answer in it) or 4
    line: str  # the verdict with what it does not cover
    notes: tuple[str, ...]  # options that the user gave and the folder was not made with

    @property
    def result(self) -> VerifyResult:
        """As ``--json`` prints it."""
        found = self.verification
        return VerifyResult(
            passed=found.ok,
            verdict=self.line,
            samples=found.samples,
            duration_s=found.duration,
            notes=self.notes,
            checks=tuple(CheckMade.from_fields(c) for c in found.checks),
            information=tuple(InformationTold.from_fields(i) for i in found.information),
            not_recomputed=NOT_RECOMPUTED,
        )


def verify(request: VerifyRequest) -> Verified:
    """Check an output folder of optimize against cell and toolpath.

    Raises:
        InputError: cell, toolpath, an option or a file with effects is wrong, or ``out`` is no folder.
    """
    with in_use(with_effects(request.effects)):
        return _verified(request)


def _verified(request: VerifyRequest) -> Verified:
    if not request.out.is_dir():
        raise InputError("is not a folder; give the output folder of optimize", file=request.out)
    cell = load_cell(request.cell, allow_external=request.allow_external)
    try:
        manifest: Manifest | None = read_manifest(request.out)[0]
    except InputError:
        manifest = None  # a failed check of its own, below
    used = in_force(request, cell, known_robot(cell), manifest)
    cell = with_tools(apply_absolute_accuracy(cell, used.options), used.toolpath)
    found = verify_folder(
        cell,
        used.toolpath,
        request.out,
        options=used.options,
        inputs=distinct((*cell_inputs(cell), single(request.toolpath, "toolpath"))),
    )
    found = replace(found, checks=(*used.checks, *found.checks))
    missing = (*unchecked(cell, used.options, used.toolpath), *not_run(found.checks))
    if not found.ok:
        older = made_otherwise(request.out, manifest)
        return Verified(found, 4, with_scope("verification failed", missing), (*used.notes, *older))
    if not found.samples:
        words = "intact, but without a motion: there was no feasible answer"
        return Verified(found, 3, with_scope(words, missing), used.notes)
    return Verified(found, 0, with_scope("verification passed", missing), used.notes)

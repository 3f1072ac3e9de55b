"""``machopt validate``: all errors and warnings of a cell, with a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.cell_reader import find_cell_file
from machopt.cell_setup.validation.cell_picture import render_cell_picture
from machopt.cell_setup.validation.planning_checks import CellRemark, list_remarks
from machopt.cell_setup.validation.reader_errors import read_all
from machopt.data_types.cell import Cell
from machopt.data_types.documents.cell_documents import RemarkEntry, ValidateDocument
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import InputError
from machopt.output.single_file import refuse_overwriting, write_text_file


@dataclass(frozen=True)
class ValidateResult:
    """Result of ``machopt validate``."""

    path: Path  # as the user named the cell
    cell: Cell | None  # without what is wrong; None where too much is
    findings: tuple[CellRemark, ...]  # errors first
    picture: Path | None

    @property
    def errors(self) -> tuple[CellRemark, ...]:
        return tuple(f for f in self.findings if f.level == "error")

    @property
    def result(self) -> ValidateDocument:
        """As ``--json`` prints it."""
        errors = len(self.errors)
        return ValidateDocument(
            cell=str(self.path),
            errors=errors,
            warnings=len(self.findings) - errors,
            findings=tuple(RemarkEntry.from_fields(f) for f in self.findings),
        )

    @property
    def exit_code(self) -> int:
        """Exit code: 0 if a motion can be planned, else 2."""
        return 2 if self.errors else 0


def run_validate(
    path: Path,
    *,
    allow_external: bool = False,
    picture_file: Path | None = None,
    effects: Sequence[Path] = (),
    overwrite: bool = False,
) -> ValidateResult:
    """Look at a cell.

    Args:
        path: the cell folder, or its cell.yaml.
        allow_external: let the cell use files outside its folder.
        picture_file: where to draw it, .svg.
        effects: Python files with effects of the user's own that the cell's files hold; runs the code in them.
        overwrite: replace whatever file is where the picture goes.

    Raises:
        InputError: there is no such cell, the picture cannot be written, or a file with effects is wrong.
    """
    if picture_file is not None and picture_file.suffix.lower() != ".svg":
        raise InputError(f"pictures are SVG; {picture_file.stem}.svg would work", file=picture_file)
    find_cell_file(path)  # none there is no finding about a cell
    with activate_user_effects(load_effect_files(effects)):
        return _validate_cell(path, allow_external, picture_file, effects, overwrite=overwrite)


def _validate_cell(
    path: Path, allow_external: bool, picture_file: Path | None, effects: Sequence[Path], *, overwrite: bool
) -> ValidateResult:
    if picture_file is not None:
        refuse_overwriting(picture_file, force=overwrite, inputs=(find_cell_file(path), *effects))
    read = read_all(path, allow_external=allow_external)
    found = [CellRemark("error", "", str(p)) for p in read.problems]
    drawn = None
    if read.cell is not None:
        found += [f for f in list_remarks(read.cell) if not _is_consequence(f, read.removed_keys)]
        found += [CellRemark("warning", "", w) for w in read.cell.warnings]
        if picture_file is not None:
            drawn = _draw_cell(read.cell, picture_file, found, effects, overwrite=overwrite)
    found.sort(key=lambda f: f.level)  # stable, and errors come first by the alphabet
    return ValidateResult(path, read.cell, tuple(found), drawn)


def _is_consequence(finding: CellRemark, keys: tuple[str, ...]) -> bool:
    """Return whether a remark is only the consequence of an error that is reported already."""
    return finding.where != "" and any(k.split(".")[0] == finding.where.split(".")[0] for k in keys)


def _draw_cell(
    cell: Cell, file: Path, found: list[CellRemark], effects: Sequence[Path], *, overwrite: bool
) -> Path | None:
    try:
        text = render_cell_picture(cell)
    except InputError as problem:
        found.append(CellRemark("error", "", str(problem)))
        return None
    write_text_file(file, text + "\n", force=overwrite, inputs=(*cell.files, *effects))
    return file

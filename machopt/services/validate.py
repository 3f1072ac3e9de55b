"""``machopt validate``: everything wrong or odd about a cell, with a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.cells.picture import picture
from machopt.cells.problems import read_all
from machopt.cells.review import Remark, review
from machopt.domain.cell import Cell
from machopt.domain.results.cells import RemarkTold, ValidateResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import cell_file
from machopt.output.single_file import refuse_overwriting, write_text_file


@dataclass(frozen=True)
class Validated:
    """What was found."""

    path: Path  # as the user named the cell
    cell: Cell | None  # without what is wrong; None where too much is
    findings: tuple[Remark, ...]  # errors first
    picture: Path | None

    @property
    def errors(self) -> tuple[Remark, ...]:
        return tuple(f for f in self.findings if f.level == "error")

    @property
    def result(self) -> ValidateResult:
        """As ``--json`` prints it."""
        errors = len(self.errors)
        return ValidateResult(
            cell=str(self.path),
            errors=errors,
            warnings=len(self.findings) - errors,
            findings=tuple(RemarkTold.from_fields(f) for f in self.findings),
        )

    @property
    def exit_code(self) -> int:
        """0: a plan can be made; 2: none, or none that could be driven."""
        return 2 if self.errors else 0


def validate(
    path: Path,
    *,
    allow_external: bool = False,
    picture_file: Path | None = None,
    effects: Sequence[Path] = (),
    overwrite: bool = False,
) -> Validated:
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
    cell_file(path)  # none there is no finding about a cell
    with in_use(with_effects(effects)):
        return _validated(path, allow_external, picture_file, effects, overwrite=overwrite)


def _validated(
    path: Path, allow_external: bool, picture_file: Path | None, effects: Sequence[Path], *, overwrite: bool
) -> Validated:
    if picture_file is not None:
        refuse_overwriting(picture_file, force=overwrite, inputs=(cell_file(path), *effects))
    read = read_all(path, allow_external=allow_external)
    found = [Remark("error", "", str(p)) for p in read.problems]
    drawn = None
    if read.cell is not None:
        found += [f for f in review(read.cell) if not _put_aside(f, read.put_aside)]
        found += [Remark("warning", "", w) for w in read.cell.warnings]
        if picture_file is not None:
            drawn = _draw(read.cell, picture_file, found, effects, overwrite=overwrite)
    found.sort(key=lambda f: f.level)  # stable, and errors come first by the alphabet
    return Validated(path, read.cell, tuple(found), drawn)


def _put_aside(finding: Remark, keys: tuple[str, ...]) -> bool:
    """What is only missing because a mistake in it has been told already."""
    return finding.where != "" and any(k.split(".")[0] == finding.where.split(".")[0] for k in keys)


def _draw(cell: Cell, file: Path, found: list[Remark], effects: Sequence[Path], *, overwrite: bool) -> Path | None:
    try:
        text = picture(cell)
    except InputError as problem:
        found.append(Remark("error", "", str(problem)))
        return None
    write_text_file(file, text + "\n", force=overwrite, inputs=(*cell.files, *effects))
    return file

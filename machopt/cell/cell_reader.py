"""Reader of cell.yaml → :class:`machopt.data_types.cell.Cell`: converts mm and degrees to SI and checks everything."""

from __future__ import annotations

from os.path import exists, isdir
from pathlib import Path

from machopt.cell.cell_file_access import CellFolder
from machopt.cell.cell_schema import AnyChainKeys, CellKeys
from machopt.cell.cell_section_reader import CellSectionReader
from machopt.data_types.cell import Cell
from machopt.errors import CellError
from machopt.file_formats.strict_yaml import YamlDocument, read_yaml, validate_document


def load_cell(
    path: Path | str,
    *,
    allow_external: bool = False,
    any_chain: bool = False,
    stiffness: Path | None = None,
    process: Path | None = None,
    bodies: bool = True,
) -> Cell:
    """Read a cell folder.

    Args:
        path: the cell folder, or its cell.yaml.
        allow_external: accept files outside the cell folder.
        any_chain: accept any number of revolute and prismatic joints between base and flange, and no tool and no
            workpiece: for a recorded motion, which needs no more than the chain's dynamics.
        stiffness: a stiffness.yaml to take in place of the one that the cell names, wherever it lies.
        process: a process.yaml to take in place of the one that the cell names, wherever it lies.
        bodies: False where only the kinematics is used: a missing collision mesh of the robot is a warning then.

    Raises:
        InputError: names file, line and key, what was found and what was expected.
    """
    document = read_yaml(find_cell_file(path))
    return build_cell(
        document,
        allow_external=allow_external,
        any_chain=any_chain,
        stiffness=stiffness,
        process=process,
        bodies=bodies,
    )


def find_cell_file(path: Path | str) -> Path:
    """Find cell.yaml.

    Args:
        path: Cell folder, or the file itself.

    Returns:
        Path of the file.

    Raises:
        CellError: the folder has no cell.yaml, or the path is neither file nor folder.
    """
    file = Path(path)
    if isdir(file):
        file = file / "cell.yaml"
        if not exists(file):
            raise CellError("no cell.yaml in this folder", file=path)
    if not exists(file):
        raise CellError("there is no such file; a cell folder or its cell.yaml would work", file=path)
    return file


def build_cell(
    document: YamlDocument,
    *,
    allow_external: bool = False,
    any_chain: bool = False,
    stiffness: Path | None = None,
    process: Path | None = None,
    bodies: bool = True,
) -> Cell:
    """Build a cell from parsed cell.yaml, otherwise as :func:`load_cell`.

    Args:
        document: Parsed cell.yaml.
        allow_external: Whether files outside the cell folder are allowed.
        any_chain: Whether the arm may have other than six revolute joints.
        stiffness: Stiffness file that replaces that of the cell, None for none.
        process: Process file that replaces that of the cell, None for none.
        bodies: Whether collision bodies are needed.

    Returns:
        The cell, SI units.
    """
    keys = validate_document(AnyChainKeys if any_chain else CellKeys, document)
    return CellSectionReader(
        document=document,
        keys=keys,
        folder=CellFolder(document, Path(document.file).resolve().parent, allow_external),
        any_chain=any_chain,
        other_stiffness=stiffness,
        other_process=process,
        bodies=bodies,
    ).read_cell()

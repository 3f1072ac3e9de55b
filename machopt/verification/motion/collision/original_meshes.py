"""Original files of meshes that were converted for the planner.

``NAME.dae.stl`` is a copy that ``machopt init`` made of the COLLADA file ``NAME.dae``. The planner reads the copy.
Here coal's own importer reads the original, so an error of the conversion is detected.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Array

_HEADER_BYTES = 1 << 20  # bytes in which the unit of a COLLADA file is stated


def load_mesh(path: Path, scale: Array) -> Any:
    """Return a mesh as coal geometry.

    Args:
        path: of the mesh that the cell names.
        scale: (3,) m per unit of that file.

    Raises:
        InputError: it cannot be loaded.
    """
    import coal

    original = path.with_suffix("")
    if path.suffixes[-2:] == [".dae", ".stl"] and original.is_file():
        path, scale = original, np.asarray(scale) * _read_collada_unit(original)  # the copy is in m
    elif path.suffix.lower() == ".dae":  # named by the cell itself
        scale = np.asarray(scale) * _read_collada_unit(path)
    try:
        return coal.MeshLoader().load(str(path), np.asarray(scale, float))
    except (ValueError, RuntimeError) as problem:
        message = " ".join(str(problem).split())[:200]  # the message may hold the rest of the file
    try:  # the importer does not read comments and sections inside of numbers
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / path.name
            ElementTree.parse(path).write(plain, encoding="utf-8", xml_declaration=True)
            return coal.MeshLoader().load(str(plain), np.asarray(scale, float))
    except (ValueError, RuntimeError, ElementTree.ParseError):
        raise OutputFolderError(f"cannot be loaded: {message}", file=path) from None


def _read_collada_unit(path: Path) -> float:
    """m per unit of a COLLADA file; coal's importer leaves the unit out."""
    found: list[float] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag == "unit" and not found:
            found.append(float(attributes.get("meter", "1")))

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    with path.open("rb") as file:
        try:
            parser.Parse(file.read(_HEADER_BYTES), False)
        except (expat.ExpatError, ValueError) as problem:
            raise OutputFolderError(f"is no COLLADA: {problem}", file=path) from None
    return found[0] if found else 1.0

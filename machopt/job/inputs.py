"""Hashes of what a job was given, so that a result can say which files it belongs to."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from machopt.domain.cell import Cell


def input_hashes(cell: Cell, recordings: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of a cell's files and of everything in the recordings' folders, by name."""
    out = {}
    for file in cell.files:
        name = str(file.relative_to(cell.folder) if file.is_relative_to(cell.folder) else file.name)
        out[name] = hashlib.sha256(file.read_bytes()).hexdigest()
    for path in recordings:
        folder = path if path.is_dir() else path.parent
        for file in sorted(p for p in folder.iterdir() if p.is_file()):
            out[f"{folder.name}/{file.name}"] = hashlib.sha256(file.read_bytes()).hexdigest()
    return out

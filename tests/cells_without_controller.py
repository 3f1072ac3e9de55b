"""Shipped cells without their controller, so that a test can set another one."""

from __future__ import annotations

import re
from pathlib import Path


def without_controller(cell: Path) -> Path:
    """Remove ``controller:`` from a copied cell.yaml."""
    file = cell / "cell.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text(re.sub(r"(?m)^controller:\n(?:[ #].*\n)*", "", text), encoding="utf-8")
    return cell

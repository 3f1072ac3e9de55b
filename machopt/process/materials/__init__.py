"""Cutting coefficients of materials that the package knows by name: ``materials.toml`` and its reader."""

from machopt.process.materials.material_table import (
    find_drilling_coefficients,
    find_milling_coefficients,
    list_drilling_materials,
    list_milling_materials,
)

__all__ = [
    "find_drilling_coefficients",
    "find_milling_coefficients",
    "list_drilling_materials",
    "list_milling_materials",
]

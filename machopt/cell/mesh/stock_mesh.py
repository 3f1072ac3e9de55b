"""Triangles of a stock mesh, which must enclose a volume."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.cell.mesh.closed_surface_check import read_surface, read_triangles
from machopt.cell.mesh.file_integrity import read_whole_mesh
from machopt.cell.mesh.mesh_errors import ErrorFactory
from machopt.data_types.stock import StockBody
from machopt.numerics.mesh_construction import merge_equal_vertices


def read_stock_mesh(path: Path, scale: float, cell_size: float, fail: ErrorFactory) -> StockBody:
    """Read the mesh of a stock.

    Args:
        path: The file.
        scale: Metres per unit of the mesh.
        cell_size: m, of the stock model.
        fail: Makes the error that names where the mesh is used.

    Raises:
        InputError: the file is no mesh, or its triangles enclose no volume.
    """
    surface = read_surface(path, fail)
    if surface.open_edges:
        raise fail(
            f"mesh {path.name} is not closed ({surface.open_edges} open edges), so that it has no inside; a closed "
            "mesh would work"
        )
    if surface.inward:
        raise fail(f"mesh {path.name} has triangles that face inwards; a mesh with flipped normals would work")
    mesh = merge_equal_vertices(read_triangles(path, read_whole_mesh(path, fail), fail))
    return StockBody(
        vertices=np.ascontiguousarray(mesh.vertices * scale),
        faces=np.ascontiguousarray(mesh.faces),
        cell_size=cell_size,
        file=path,
    )

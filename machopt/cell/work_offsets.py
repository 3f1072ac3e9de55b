"""Work offsets of the cell: several setups in one job, their bodies, and paths that change the offset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from machopt.cell.cell_schema import PoseKeys, ShapeKeys, WorkOffsetKeys
from machopt.cell.parsed_value_conversion import copy_read_only
from machopt.data_types.cell import Cell, CollisionShape, Workpiece
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import CellError, suggest_nearest_word
from machopt.file_formats.source_file import normalise_offset_name
from machopt.file_formats.strict_yaml import KeyPath
from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class WorkOffsets:
    """The work offsets of a cell; all of them exist at the same time."""

    frames: Mapping[str, Array]  # name → (4, 4) in workpiece
    workpiece: Workpiece  # with the parts of all offsets
    fixtures: tuple[CollisionShape, ...]  # on the workpiece's link

    @classmethod
    def build_work_offsets(
        cls,
        keys: Mapping[str, WorkOffsetKeys],
        workpiece: Workpiece,
        pose: Callable[[KeyPath, PoseKeys], Array],
        shapes: Callable[[KeyPath, Sequence[ShapeKeys]], tuple[CollisionShape, ...]],
    ) -> WorkOffsets:
        """Build the work offsets of the cell.

        Args:
            keys: as the cell has them.
            workpiece: as the cell has it.
            pose, shapes: readers of a frame and of bodies, by where they stand in cell.yaml.
        """
        frames: dict[str, Array] = {}
        parts, fixtures = list(workpiece.geometry), []
        for name, own in keys.items():
            T = pose(("offsets", name, "pose"), own.pose)
            frames[normalise_offset_name(name)] = T
            parts += _place_bodies(shapes(("offsets", name, "geometry"), own.geometry), own.geometry, T, f"{name}_part")
            found = shapes(("offsets", name, "fixtures"), own.fixtures)
            there = _place_bodies(found, own.fixtures, workpiece.T_link_workpiece @ T, f"{name}_fixture")
            fixtures += [replace(body, link=workpiece.link) for body in there]
        return cls(frames, replace(workpiece, geometry=tuple(parts)), tuple(fixtures))


def _place_bodies(
    bodies: Sequence[CollisionShape], keys: Sequence[ShapeKeys], T: Array, name: str
) -> list[CollisionShape]:
    """Bodies of an offset in the frame that holds it, (4, 4) T; those without a name are called after the offset."""
    return [
        replace(body, T_parent_shape=copy_read_only(T @ body.T_parent_shape), name=own.name or f"{name}_{n}")
        for n, (body, own) in enumerate(zip(bodies, keys, strict=True))
    ]


def place_toolpath(toolpath: Toolpath, cell: Cell) -> Toolpath:
    """Transform a toolpath from the work offsets of the cell to ``workpiece``.

    Points without an offset are in ``workpiece`` already, which is reported where the cell has offsets.

    Args:
        toolpath: The toolpath, SI units.
        cell: The cell.

    Returns:
        The toolpath in ``workpiece``.

    Raises:
        CellError: the cell has no such offset, or the offset changes during a cut.
    """
    message = _describe_missing_offset(toolpath, cell)
    if message and message not in toolpath.warnings:
        toolpath = replace(toolpath, warnings=(*toolpath.warnings, message))
    if not toolpath.offsets:
        return toolpath
    position, axis, reference = toolpath.position.copy(), toolpath.axis.copy(), toolpath.reference.copy()
    stops = [*(point for point, _ in toolpath.offsets[1:]), len(toolpath)]
    normal = None if toolpath.surface_normal is None else toolpath.surface_normal.copy()
    for (first, name), stop in zip(toolpath.offsets, stops, strict=True):
        if name not in cell.offsets:
            known = f"; {suggest_nearest_word(name, list(cell.offsets))}" if cell.offsets else ", which has none"
            raise CellError(f"work offset {name!r} is not in the cell's offsets{known}", file=toolpath.source)
        if 0 < first < len(toolpath) and toolpath.move[first] == toolpath.move[first - 1] == MoveKind.CUT:
            raise CellError(
                f"cuts from point {first - 1} to point {first}, and the work offset changes to {name} between them; a "
                "rapid move to the first point of an offset would work",
                file=toolpath.source,
            )
        T, rows = cell.offsets[name], slice(first, stop)
        position[rows] = toolpath.position[rows] @ T[:3, :3].T + T[:3, 3]
        axis[rows], reference[rows] = toolpath.axis[rows] @ T[:3, :3].T, toolpath.reference[rows] @ T[:3, :3].T
        if normal is not None and toolpath.surface_normal is not None:
            normal[rows] = toolpath.surface_normal[rows] @ T[:3, :3].T
    used = dict.fromkeys(name for _, name in toolpath.offsets)
    meta = {**toolpath.meta, "work_offsets": ", ".join(used)}
    return replace(
        toolpath, position=position, axis=axis, reference=reference, surface_normal=normal, offsets=(), meta=meta
    )


def _describe_missing_offset(toolpath: Toolpath, cell: Cell) -> str:
    """Describe points without a work offset of the cell; empty where there are none."""
    done = not toolpath.offsets and "work_offsets" in toolpath.meta
    count = toolpath.offsets[0][0] if toolpath.offsets else len(toolpath)
    if not cell.offsets or done or not count:
        return ""
    which = f"points 0 to {count - 1} name" if toolpath.offsets else "all points name"
    return f"{which} no work offset: they count in workpiece, not in one of the cell's ({', '.join(cell.offsets)})"

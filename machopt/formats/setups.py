"""Several setups in one job: work offsets of the cell, what lies there and what holds it, paths that change them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from machopt.arrays import Array
from machopt.domain.cell import Cell, Shape, Workpiece
from machopt.domain.toolpath import Move, Toolpath
from machopt.errors import InputError, nearest
from machopt.formats.cell_schema import OffsetKeys, PoseKeys, ShapeKeys
from machopt.formats.cellparts import frozen
from machopt.formats.source import offset_key
from machopt.formats.yamlstrict import Loc


@dataclass(frozen=True)
class Setups:
    """The work offsets of a cell; all of them stand in it at once."""

    frames: Mapping[str, Array]  # name → (4, 4) in workpiece
    workpiece: Workpiece  # with the parts of all offsets
    fixtures: tuple[Shape, ...]  # on the workpiece's link

    @classmethod
    def of(
        cls,
        keys: Mapping[str, OffsetKeys],
        workpiece: Workpiece,
        pose: Callable[[Loc, PoseKeys], Array],
        shapes: Callable[[Loc, Sequence[ShapeKeys]], tuple[Shape, ...]],
    ) -> Setups:
        """Place what the cell says of its offsets.

        Args:
            keys: as the cell has them.
            workpiece: as the cell has it.
            pose, shapes: readers of a frame and of bodies, by where they stand in cell.yaml.
        """
        frames: dict[str, Array] = {}
        parts, fixtures = list(workpiece.geometry), []
        for name, own in keys.items():
            T = pose(("offsets", name, "pose"), own.pose)
            frames[offset_key(name)] = T
            parts += _placed(shapes(("offsets", name, "geometry"), own.geometry), own.geometry, T, f"{name}_part")
            found = shapes(("offsets", name, "fixtures"), own.fixtures)
            there = _placed(found, own.fixtures, workpiece.T_link_workpiece @ T, f"{name}_fixture")
            fixtures += [replace(body, link=workpiece.link) for body in there]
        return cls(frames, replace(workpiece, geometry=tuple(parts)), tuple(fixtures))


def _placed(bodies: Sequence[Shape], keys: Sequence[ShapeKeys], T: Array, name: str) -> list[Shape]:
    """Bodies of an offset in the frame that holds it, (4, 4) T; those without a name are called after the offset."""
    return [
        replace(body, T_parent_shape=frozen(T @ body.T_parent_shape), name=own.name or f"{name}_{n}")
        for n, (body, own) in enumerate(zip(bodies, keys, strict=True))
    ]


def placed(toolpath: Toolpath, cell: Cell) -> Toolpath:
    """The toolpath in ``workpiece``, whatever work offsets of the cell it counts from.

    Points under no offset count in ``workpiece`` itself, which is told where the cell has offsets.

    Raises:
        InputError: an offset that the cell does not have, or another one on the way of a cut.
    """
    told = _under_none(toolpath, cell)
    if told and told not in toolpath.warnings:
        toolpath = replace(toolpath, warnings=(*toolpath.warnings, told))
    if not toolpath.offsets:
        return toolpath
    position, axis, reference = toolpath.position.copy(), toolpath.axis.copy(), toolpath.reference.copy()
    stops = [*(point for point, _ in toolpath.offsets[1:]), len(toolpath)]
    for (first, name), stop in zip(toolpath.offsets, stops, strict=True):
        if name not in cell.offsets:
            known = f"; {nearest(name, list(cell.offsets))}" if cell.offsets else ", which has none"
            raise InputError(f"work offset {name!r} is not in the cell's offsets{known}", file=toolpath.source)
        if 0 < first < len(toolpath) and toolpath.move[first] == toolpath.move[first - 1] == Move.CUT:
            raise InputError(
                f"cuts from point {first - 1} to point {first}, and the work offset changes to {name} between them; a "
                "rapid move to the first point of an offset would work",
                file=toolpath.source,
            )
        T, rows = cell.offsets[name], slice(first, stop)
        position[rows] = toolpath.position[rows] @ T[:3, :3].T + T[:3, 3]
        axis[rows], reference[rows] = toolpath.axis[rows] @ T[:3, :3].T, toolpath.reference[rows] @ T[:3, :3].T
    used = dict.fromkeys(name for _, name in toolpath.offsets)
    meta = {**toolpath.meta, "work_offsets": ", ".join(used)}
    return replace(toolpath, position=position, axis=axis, reference=reference, offsets=(), meta=meta)


def _under_none(toolpath: Toolpath, cell: Cell) -> str:
    """What is told of points that name none of the offsets that the cell has; empty where there are none."""
    done = not toolpath.offsets and "work_offsets" in toolpath.meta
    count = toolpath.offsets[0][0] if toolpath.offsets else len(toolpath)
    if not cell.offsets or done or not count:
        return ""
    which = f"points 0 to {count - 1} name" if toolpath.offsets else "all points name"
    return f"{which} no work offset: they count in workpiece, not in one of the cell's ({', '.join(cell.offsets)})"

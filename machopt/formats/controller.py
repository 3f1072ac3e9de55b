"""The key ``controller`` of cell.yaml: how the controller counts joints, frames and moves."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.domain.program import Controller, ExternalDrive
from machopt.errors import nearest
from machopt.formats.cell_schema import ControllerKeys, PoseKeys
from machopt.formats.cellparts import frozen, joint_map_of
from machopt.formats.chain import Chain
from machopt.formats.yamlstrict import Document, Loc


def controller_of(
    document: Document,
    keys: ControllerKeys | None,
    chain: Chain,
    file: Callable[[Loc, str], Path],
    pose: Callable[[Loc, PoseKeys], Array],
) -> Controller:
    """The controller; what the cell does not say stays unknown.

    Args:
        document, keys: cell.yaml, and its key ``controller``.
        chain: the joints that move.
        file, pose: readers of a file that the cell names and of a frame, by where they stand in cell.yaml.

    Raises:
        InputError: axes, pulses or levels that no controller has.
    """
    if keys is None:
        return Controller()
    post = keys.post
    if post is not None and post.endswith(".toml"):
        post = str(file(("controller", "post"), post))
    pulses = keys.pulses_per_deg
    if pulses is not None and 0.0 in pulses:
        raise document.error(("controller", "pulses_per_deg"), f"found {pulses}; expected numbers other than 0")
    levels = keys.position_levels_mm
    if levels is not None and not (levels[0] > 0.0 and all(a < b for a, b in itertools.pairwise(levels))):
        raise document.error(
            ("controller", "position_levels_mm"), f"found {levels}; expected eight rising distances of PL=1 … 8"
        )
    return Controller(
        post=post,
        joint_map=None if keys.joint_map is None else joint_map_of(keys.joint_map),
        T_base_root=None if keys.root is None else pose(("controller", "root"), keys.root),
        T_world_root=None if keys.world is None else pose(("controller", "world"), keys.world),
        external=_drives(document, keys, chain),
        T_flange_mount=None if keys.flange is None else pose(("controller", "flange"), keys.flange),
        tool_number=keys.tool_number,
        base_number=keys.base_number,
        pulses_per_deg=None if pulses is None else frozen(np.array(pulses)),
        position_levels=None if levels is None else frozen(np.array(levels) / 1e3),
        moves_per_part=keys.moves_per_part,
        nonflip_j5=keys.nonflip_j5,
        absolute_accuracy=keys.absolute_accuracy,
        lines={name: line for name, line in keys.lines.model_dump().items() if line is not None},
    )


def _drives(document: Document, keys: ControllerKeys, chain: Chain) -> dict[str, ExternalDrive]:
    """How the controller counts external joints."""
    out: dict[str, ExternalDrive] = {}
    names = [j.name for j in chain.external]
    for name, axis in keys.external.items():
        if name not in names:
            raise document.error(
                ("controller", "external", name),
                f"{name!r} is no external joint of this cell; {nearest(name, names) if names else 'it has none'}",
            )
        if axis.pulses == 0.0:
            raise document.error(("controller", "external", name, "pulses"), "found 0; expected another number")
        out[name] = ExternalDrive(
            number=axis.number,
            sign=axis.sign,
            offset=axis.offset,
            unit=axis.unit,
            machine=axis.machine,
            pulses=axis.pulses,
        )
    numbers = [out.get(n, ExternalDrive()).number or k for k, n in enumerate(names, start=1)]
    if len(set(numbers)) != len(numbers):
        raise document.error(
            ("controller", "external"),
            f"the numbers of {', '.join(names)} are {numbers}; expected one number of its own for each axis",
        )
    return out

"""Key ``controller`` of cell.yaml: conventions of the controller for joints, frames and moves."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from machopt.cell.cell_schema import ControllerKeys, PoseKeys
from machopt.cell.joints.joint_chain import JointChain
from machopt.cell.parsed_value_conversion import build_joint_map, copy_read_only
from machopt.data_types.robot_program import ExternalAxisMap, RobotController
from machopt.errors import suggest_nearest_word
from machopt.file_formats.strict_yaml import KeyPath, YamlDocument
from machopt.numerics.array_types import Array


def build_controller(
    document: YamlDocument,
    keys: ControllerKeys | None,
    chain: JointChain,
    file: Callable[[KeyPath, str], Path],
    pose: Callable[[KeyPath, PoseKeys], Array],
) -> RobotController:
    """Build the controller; values that the cell does not give stay unknown.

    Args:
        document, keys: cell.yaml, and its key ``controller``.
        chain: the joints that move.
        file, pose: readers of a file that the cell names and of a frame, by where they stand in cell.yaml.

    Raises:
        InputError: axes, pulses or levels that no controller has.
    """
    if keys is None:
        return RobotController()
    post = keys.post
    if post is not None and post.endswith(".toml"):
        post = str(file(("controller", "post"), post))
    pulses = keys.pulses_per_deg
    if pulses is not None and 0.0 in pulses:
        raise document.build_error(("controller", "pulses_per_deg"), f"found {pulses}; expected numbers other than 0")
    levels = keys.position_levels_mm
    if levels is not None and not (levels[0] > 0.0 and all(a < b for a, b in itertools.pairwise(levels))):
        raise document.build_error(
            ("controller", "position_levels_mm"), f"found {levels}; expected eight rising distances of PL=1 … 8"
        )
    return RobotController(
        post=post,
        joint_map=None if keys.joint_map is None else build_joint_map(keys.joint_map),
        T_base_root=None if keys.root is None else pose(("controller", "root"), keys.root),
        T_world_root=None if keys.world is None else pose(("controller", "world"), keys.world),
        external=_build_external_axis_maps(document, keys, chain),
        T_flange_mount=None if keys.flange is None else pose(("controller", "flange"), keys.flange),
        tool_number=keys.tool_number,
        base_number=keys.base_number,
        pulses_per_deg=None if pulses is None else copy_read_only(np.array(pulses)),
        position_levels=None if levels is None else copy_read_only(np.array(levels) / 1e3),
        moves_per_part=keys.moves_per_part,
        nonflip_j5=keys.nonflip_j5,
        absolute_accuracy=keys.absolute_accuracy,
        lines={name: line for name, line in keys.lines.model_dump().items() if line is not None},
    )


def _build_external_axis_maps(
    document: YamlDocument, keys: ControllerKeys, chain: JointChain
) -> dict[str, ExternalAxisMap]:
    """How the controller counts external joints."""
    out: dict[str, ExternalAxisMap] = {}
    names = [j.name for j in chain.external]
    for name, axis in keys.external.items():
        if name not in names:
            raise document.build_error(
                ("controller", "external", name),
                f"{name!r} is no external joint of this cell; "
                f"{suggest_nearest_word(name, names) if names else 'it has none'}",
            )
        if axis.pulses == 0.0:
            raise document.build_error(("controller", "external", name, "pulses"), "found 0; expected another number")
        out[name] = ExternalAxisMap(
            number=axis.number,
            sign=axis.sign,
            offset=axis.offset,
            unit=axis.unit,
            machine=axis.machine,
            pulses=axis.pulses,
        )
    numbers = [out.get(n, ExternalAxisMap()).number or k for k, n in enumerate(names, start=1)]
    if len(set(numbers)) != len(numbers):
        raise document.build_error(
            ("controller", "external"),
            f"the numbers of {', '.join(names)} are {numbers}; expected one number of its own for each axis",
        )
    return out
